"""Robot descriptions made physically consistent with the least change."""

from consistent_id.export.repair.consistent_inertia import (
    NearestInertia,
    nearest_inertia,
)
from consistent_id.export.repair.link_repair import LinkRepair, Repair
from consistent_id.export.repair.urdf_repair import repair_urdf

__all__ = ["LinkRepair", "NearestInertia", "Repair", "nearest_inertia", "repair_urdf"]
