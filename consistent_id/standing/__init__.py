"""Exciting motion of a robot that stands: its trunk moves, its feet stay."""

from consistent_id.standing.forces_and_limits import (
    GroundForces,
    StandingLimits,
    StandingMotion,
    ground_forces,
    standing_motion,
)
from consistent_id.standing.stance import (
    Stance,
    StandingFoot,
    standing_feet,
    standing_pose,
)
from consistent_id.standing.standing_design import (
    StandingDesign,
    design_standing,
    trunk_errors,
)
from consistent_id.standing.standing_files import write_standing
from consistent_id.standing.trunk_path import TrunkPath

__all__ = [
    "GroundForces",
    "Stance",
    "StandingDesign",
    "StandingFoot",
    "StandingLimits",
    "StandingMotion",
    "TrunkPath",
    "design_standing",
    "ground_forces",
    "standing_feet",
    "standing_motion",
    "standing_pose",
    "trunk_errors",
    "write_standing",
]
