"""Simulated experiments on known robots, rehearsals, and a paper's reproduced study.

A robot follows a motion, such as a writing task.  Encoders and a load cell write on one
clock, cameras on another.  All true values are known, so that an estimate from the logs
can be compared with them.  `consistent_id.laboratory.rehearsal` plays a design before
the robot does, `consistent_id.laboratory.reproduction` reproduces a published study.
"""

from consistent_id.laboratory.closed_loop import (
    Controller,
    Encoders,
    SimulatedRobot,
    controlled,
    with_friction,
)
from consistent_id.laboratory.experiment import (
    Cameras,
    ExperimentLog,
    Laboratory,
    LoadCell,
    SynchronisedLog,
    perform,
    synchronised,
)
from consistent_id.laboratory.inverse_kinematics import TaskPath, follow
from consistent_id.laboratory.writing_tasks import Orientation, Writer, WritingTask

OneClock = SynchronisedLog  # the earlier names
on_one_clock = synchronised

__all__ = [
    "Cameras",
    "Controller",
    "Encoders",
    "ExperimentLog",
    "Laboratory",
    "LoadCell",
    "Orientation",
    "SimulatedRobot",
    "SynchronisedLog",
    "TaskPath",
    "Writer",
    "WritingTask",
    "controlled",
    "follow",
    "perform",
    "synchronised",
    "with_friction",
]
