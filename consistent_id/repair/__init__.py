"""Robot descriptions looked through for mistakes, repaired with the least change."""

from consistent_id.repair.causes import NearestInertia, nearest_inertia
from consistent_id.repair.link_repair import LinkRepair, Repair
from consistent_id.repair.lint_rules import LintFinding
from consistent_id.repair.linting import lint_robot
from consistent_id.repair.urdf_repair import repair_urdf

__all__ = [
    "LinkRepair",
    "LintFinding",
    "NearestInertia",
    "Repair",
    "lint_robot",
    "nearest_inertia",
    "repair_urdf",
]
