"""Simulated experiments on known robots, with imperfect sensors and controllers.

A robot follows a motion.  Encoders and a load cell write on one clock, cameras on
another.  All true values are known, so that an estimate from the logs can be compared
with them.
"""

from consistent_id.laboratory.closed_loop import controlled
from consistent_id.laboratory.control import Controller
from consistent_id.laboratory.experiment import ExperimentLog, Laboratory, perform
from consistent_id.laboratory.sensors import Cameras, Encoders, LoadCell
from consistent_id.laboratory.simulated_robot import SimulatedRobot, with_friction
from consistent_id.laboratory.synchronisation import SynchronisedLog, synchronised

OneClock = SynchronisedLog  # the earlier names
on_one_clock = synchronised

__all__ = [
    "Cameras",
    "Controller",
    "Encoders",
    "ExperimentLog",
    "Laboratory",
    "LoadCell",
    "SimulatedRobot",
    "SynchronisedLog",
    "controlled",
    "perform",
    "synchronised",
    "with_friction",
]
