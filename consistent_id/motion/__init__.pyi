from consistent_id.motion.bernstein import PolynomialPath
from consistent_id.motion.collisions.bodies import (
    Body,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Hull,
    Sphere,
    plane,
)
from consistent_id.motion.collisions.clearance import ClearanceReport, prove_clearance
from consistent_id.motion.collisions.confinement import (
    OrientationCone,
    Workspace,
    within_cones,
    within_workspaces,
)
from consistent_id.motion.collisions.planning_scene import planning_scene_bodies
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.collisions.scene_building import build_scene, scene_from_urdf
from consistent_id.motion.files import (
    TRAJECTORY_COLUMNS,
    read_trajectory,
    write_trajectory,
)
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.motion.moves import Move, move_along
from consistent_id.motion.proofs.margins import MotionMargins, motion_margins
from consistent_id.motion.transfers import MotionState, transfer

__all__ = [
    "TRAJECTORY_COLUMNS",
    "Body",
    "Box",
    "Capsule",
    "ClearanceReport",
    "Cylinder",
    "HalfSpace",
    "Hull",
    "MotionLimits",
    "MotionMargins",
    "MotionState",
    "Move",
    "OrientationCone",
    "PolynomialPath",
    "Scene",
    "Sphere",
    "Workspace",
    "build_scene",
    "motion_limits",
    "motion_margins",
    "move_along",
    "plane",
    "planning_scene_bodies",
    "prove_clearance",
    "read_trajectory",
    "scene_from_urdf",
    "transfer",
    "within_cones",
    "within_workspaces",
    "write_trajectory",
]
