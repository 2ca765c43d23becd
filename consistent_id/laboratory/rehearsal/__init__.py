"""The dry run of a design: played by a simulated robot of planted parameters.

MuJoCo moves the robot: its friction is dry, as no column of the torque model is.  A
controller with a wrong model follows the motion, sensors write a log, parameters are
identified from it, and all of it is compared with what the design predicted.
"""

from consistent_id.laboratory.rehearsal.dry_runs import DryRun, dry_run
from consistent_id.laboratory.rehearsal.planted import PlantedRobot, planted_robot
from consistent_id.laboratory.rehearsal.rehearsal import Rehearsal, rehearse

__all__ = [
    "DryRun",
    "PlantedRobot",
    "Rehearsal",
    "dry_run",
    "planted_robot",
    "rehearse",
]
