"""A motion on feet, all of it: trunk, joints, forces of the ground, limits."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.standing.ground_forces import GroundForces, ground_forces
from consistent_id.excitation.standing.stance import JointMotion, Stance, joint_motion
from consistent_id.excitation.standing.standing_limits import StandingLimits, Use, uses
from consistent_id.excitation.standing.trunk_path import TrunkMotion, TrunkPath
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

_REACHED = 1e-6  # m, rad; feet that are further off are out of reach


@dataclass(frozen=True, slots=True, eq=False)
class StandingMotion:
    """A motion on feet, all of it, at some times."""

    time: Vector
    trunk: TrunkMotion
    joints: JointMotion
    ground: GroundForces
    uses: tuple[Use, ...]

    @property
    def largest(self) -> float:
        """The largest share of a limit; infinite where feet are out of reach."""
        if self.joints.off > _REACHED or self.joints.singular:
            return np.inf
        return max(use.share for use in self.uses)


def standing_motion(
    stance: Stance,
    limits: StandingLimits,
    path: TrunkPath,
    time: Vector,
) -> StandingMotion:
    """Return what a trunk's path asks of joints and ground."""
    robot = stance.robot
    trunk = path.motion(time, np.asarray(robot.gravity))
    moved = joint_motion(stance, trunk)
    bodies = TorqueModel(robot)
    ground = ground_forces(
        stance, bodies, nominal_of(robot), moved, trunk.base, limits.friction
    )
    asked = uses(stance, limits, time, moved, ground)
    return StandingMotion(time, trunk, moved, ground, asked)


def nominal_of(robot: RobotModel) -> Vector:
    """Return the inertial parameters of all links; refuse a robot that lacks some."""
    if robot.nominal is None:
        raise ProblemError(
            f"robot {robot.name!r} has links without inertial parameters, so that what "
            "a motion asks of its joints is not known; complete its file"
        )
    return robot.nominal
