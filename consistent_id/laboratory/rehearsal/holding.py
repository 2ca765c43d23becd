"""Whether an identified model holds a planted robot still against gravity."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.laboratory.rehearsal.mujoco_robot import MujocoRobot, mujoco_robot
from consistent_id.laboratory.rehearsal.planted import PlantedRobot
from consistent_id.motion.limits import MotionLimits

HELD = float(np.radians(0.2))
"""Angle [rad], or way [m], within which a pose is held."""
_POSES = 50
_TIME = 1.0  # s
_STEP = 2e-3  # s
_LOOKS = 50  # at how far joints have moved


@dataclass(frozen=True, slots=True)
class Holding:
    """How many poses are held.

    Parameters
    ----------
    largest : float, [rad or m]
        Way that the joint went that moved most.
    """

    poses: int
    held: int
    largest: float


def held_poses(
    robot: PlantedRobot,
    estimate: Estimate,
    limits: MotionLimits,
    rng: np.random.Generator,
) -> Holding:
    """Let go of the robot at random poses, with the identified gravity torque alone.

    The torque is that of the pose.  No controller helps, only dry friction does: a pose
    is held if within a second no joint goes further than `HELD`.
    """
    rigid, x = robot.controlled, robot.without_friction(estimate.parameters)
    simulated = mujoco_robot(robot, _STEP)
    poses = rng.uniform(limits.lower, limits.upper, (_POSES, len(limits.joints)))
    still = np.zeros_like(poses)
    torques = rigid.predict(x, poses, still, still)
    moved = np.array(
        [_moved(simulated, *case) for case in zip(poses, torques, strict=True)]
    )
    return Holding(_POSES, int((moved <= HELD).sum()), float(moved.max()))


def _moved(simulated: MujocoRobot, pose: Vector, torque: Vector) -> float:
    """Return the way of the joint that moved most."""
    data = simulated.at(pose, np.zeros_like(pose))
    largest = 0.0
    for _ in range(_LOOKS):
        simulated.advance(data, torque, round(_TIME / _STEP / _LOOKS))
        moved = abs(data.qpos[simulated.positions] - pose).max()
        largest = max(largest, float(moved))
    return largest
