from consistent_id.robot.loaders.dh import DHRow, from_classical_dh, from_modified_dh
from consistent_id.robot.loaders.mjcf import load_mjcf
from consistent_id.robot.loaders.robot_file import load_robot
from consistent_id.robot.loaders.urdf import load_urdf
from consistent_id.robot.loaders.urdf_lint import Finding, lint_urdf

__all__ = [
    "DHRow",
    "Finding",
    "from_classical_dh",
    "from_modified_dh",
    "lint_urdf",
    "load_mjcf",
    "load_robot",
    "load_urdf",
]
