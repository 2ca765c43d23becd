"""From an estimate to the robot in service: loads as controllers take them."""

from consistent_id.service.controller_formats import (
    CONTROLLER_FORMATS,
    ControllerFormat,
    ControllerLoad,
    controller_text,
)
from consistent_id.service.load_quantities import LoadQuantities
from consistent_id.service.weighing import WeighedLoad, weigh_load

__all__ = [
    "CONTROLLER_FORMATS",
    "ControllerFormat",
    "ControllerLoad",
    "LoadQuantities",
    "WeighedLoad",
    "controller_text",
    "weigh_load",
]
