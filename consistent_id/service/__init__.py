"""From an estimate to the robot in service: loads, torques for controllers."""

from consistent_id.service.contact import ContactDetector
from consistent_id.service.control_model import ControlModel, control_model
from consistent_id.service.controller_formats import (
    CONTROLLER_FORMATS,
    ControllerFormat,
    ControllerLoad,
    controller_text,
)
from consistent_id.service.external_torque import MomentumObserver
from consistent_id.service.gain_check import GainCheck, check_gains
from consistent_id.service.load_quantities import LoadQuantities
from consistent_id.service.load_watch import LoadWatch
from consistent_id.service.online_estimate import OnlineEstimate
from consistent_id.service.online_state import LoadChange, OnlineState
from consistent_id.service.weighing import WeighedLoad, weigh_load

__all__ = [
    "CONTROLLER_FORMATS",
    "ContactDetector",
    "ControlModel",
    "ControllerFormat",
    "ControllerLoad",
    "GainCheck",
    "LoadChange",
    "LoadQuantities",
    "LoadWatch",
    "MomentumObserver",
    "OnlineEstimate",
    "OnlineState",
    "WeighedLoad",
    "check_gains",
    "control_model",
    "controller_text",
    "weigh_load",
]
