from consistent_id.export.actuator_config import to_isaac_lab, to_mjlab
from consistent_id.export.casadi_functions import to_c, to_casadi
from consistent_id.export.export_formats import Export
from consistent_id.export.json_record import robot_record, to_json
from consistent_id.export.mjcf_export import mujoco_spec, to_mjcf
from consistent_id.export.numpy_source import to_numpy
from consistent_id.export.pinocchio_model import to_pinocchio
from consistent_id.export.urdf_export import to_urdf

__all__ = [
    "Export",
    "mujoco_spec",
    "robot_record",
    "to_c",
    "to_casadi",
    "to_isaac_lab",
    "to_json",
    "to_mjcf",
    "to_mjlab",
    "to_numpy",
    "to_pinocchio",
    "to_urdf",
]
