"""Identified robots for other programmes: files, models and functions."""

from consistent_id.export.c_source import to_c
from consistent_id.export.casadi_functions import casadi_file, to_casadi
from consistent_id.export.exported import Export
from consistent_id.export.mjcf import mujoco_spec, to_mjcf
from consistent_id.export.numpy_source import to_numpy
from consistent_id.export.pinocchio_model import pinocchio_file, to_pinocchio
from consistent_id.export.record import robot_record, to_json
from consistent_id.export.urdf import to_urdf

__all__ = [
    "Export",
    "casadi_file",
    "mujoco_spec",
    "pinocchio_file",
    "robot_record",
    "to_c",
    "to_casadi",
    "to_json",
    "to_mjcf",
    "to_numpy",
    "to_pinocchio",
    "to_urdf",
]
