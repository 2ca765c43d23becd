"""Simulated experiments on known robots, with imperfect sensors and controllers.

A robot follows a motion.  Encoders and a load cell write on one clock, cameras on
another.  All true values are known, so that an estimate from the logs can be compared
with them.
"""

from consistent_id.laboratory.closed_loop import controlled
from consistent_id.laboratory.control import Controller
from consistent_id.laboratory.experiment import ExperimentLog, Laboratory, perform
from consistent_id.laboratory.one_clock import OneClock, on_one_clock
from consistent_id.laboratory.robot import SimulatedRobot, with_friction
from consistent_id.laboratory.sensors import Cameras, Encoders, LoadCell

__all__ = [
    "Cameras",
    "Controller",
    "Encoders",
    "ExperimentLog",
    "Laboratory",
    "LoadCell",
    "OneClock",
    "SimulatedRobot",
    "controlled",
    "on_one_clock",
    "perform",
    "with_friction",
]
