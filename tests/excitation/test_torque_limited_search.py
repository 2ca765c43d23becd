"""A search under torque limits that are active is better than random paths."""

import numpy as np
import pytest
from published_robots import FOLDER

from consistent_id import TorqueModel, motion_limits
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.path_search import (
    FoundPath,
    random_candidate,
    searched_path,
)
from consistent_id.excitation.search_problem import search_problem
from consistent_id.excitation.verification import demands
from consistent_id.regression.base import base_parameters
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.robot import load_urdf

PANDA = FOLDER / "panda_description" / "urdf" / "panda.urdf"


@pytest.mark.slow
@pytest.mark.skipif(not PANDA.exists(), reason="example-robot-data is missing")
@pytest.mark.parametrize("harmonics", [5, 11])
def test_little_work_under_torque_limits_beats_the_best_of_200_random_paths(harmonics):
    """At 0.9 of all limits, 30 % of the torque left for friction (D, 2.2 units)."""
    robot = load_urdf(PANDA, tip="panda_link8")
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
    model = TorqueModel(robot, drive)
    required = demands(model, motion_limits(robot).within(0.9))
    effort = required.limits.effort
    problem = search_problem(
        model,
        base_parameters(model),
        PathForm(10.0, harmonics),
        Aim(noise=(0.005 * effort / 0.63).tolist()),
        required.limits,
    ).guarded(required.guards)
    random = min(random_candidate(problem, k).score for k in range(200))
    found = searched_path(problem, FoundPath(0), work=2.2)
    assert found.variables is not None
    assert np.exp(random - found.score) > 1.5  # D of the best random path over its own
    (torque,) = problem.measures(found.variables)
    assert -0.15 < torque.max() <= 1e-7  # the limit is active, and kept
