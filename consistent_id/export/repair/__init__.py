"""Robot descriptions made physically consistent with the least change."""

from consistent_id.export.repair.account import LinkRepair, Repair
from consistent_id.export.repair.nearest import NearestInertia, nearest_inertia
from consistent_id.export.repair.urdf import repair_urdf

__all__ = ["LinkRepair", "NearestInertia", "Repair", "nearest_inertia", "repair_urdf"]
