"""Small robots that are to be excited, and their limits."""

from dataclasses import replace

import numpy as np

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    TorqueModel,
    from_modified_dh,
)
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.search_problem import SearchProblem, search_problem
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.regression.base import base_parameters
from consistent_id.robot.model import RobotModel


def arm(joints: int = 2) -> RobotModel:
    """An arm of up to three turning joints, all bodies of which are known."""
    rows = [DHRow(0.0, 0.0), DHRow(-np.pi / 2.0, 0.0), DHRow(0.0, 0.4)]
    body = InertialParameters.from_central(
        3.0, (0.1, 0.02, 0.03), np.diag([0.02, 0.03, 0.04])
    )
    robot = from_modified_dh("arm", rows[:joints])
    links = tuple(replace(link, nominal=body) for link in robot.links)
    return replace(robot, links=links)


def arm_limits(robot: RobotModel, **changes) -> MotionLimits:
    """Limits of position, velocity and acceleration."""
    ranges = {name: (-1.5, 1.0) for name in robot.joint_names}
    given = dict(position=ranges, velocity=2.0, acceleration=6.0) | changes
    return motion_limits(robot, **given)


def arm_problem(
    model: TorqueModel,
    limits: MotionLimits | None = None,
    *,
    form: PathForm | None = None,
    aim: Aim | None = None,
    guards=(),
) -> SearchProblem:
    """A small search."""
    limits = arm_limits(model.robot) if limits is None else limits
    form, aim = form or PathForm(5.0, 3), aim or Aim()
    problem = search_problem(model, base_parameters(model), form, aim, limits)
    return problem.guarded(guards)


FRICTION = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True)
