"""The dry run of a design: played by a simulated robot with known parameters.

MuJoCo simulates the robot: its friction is dry, a form that the torque model does not
have. A controller with a wrong model follows the motion, sensors write a log,
parameters are identified from it, and the results are compared with the design's
predictions.
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
