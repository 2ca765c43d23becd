"""Recordings there are already: those of files count, and motions show the rest."""

from dataclasses import replace

import numpy as np
import pytest
from estimates import estimate_of
from excited import arm, arm_problem

from consistent_id import (
    InertialParameters,
    ProblemError,
    build_regression,
    simulate_torque,
)
from consistent_id.cli import main
from consistent_id.excitation.accuracy import path_regressor
from consistent_id.excitation.playable import playable_design
from consistent_id.excitation.sources import earlier_recordings, problem_to_excite
from consistent_id.regression import save_regression

PROBLEM = """
name = "arm"
[model]
modified_dh = [
    { alpha_deg = 0.0, a = 0.0, lower = -3.0, upper = 3.0 },
    { alpha_deg = -90.0, a = 0.0, lower = -1.5, upper = 1.5 },
]
[drive]
viscous = true
[constraints]
masses = "free"
[excitation]
duration = 5.0
harmonics = 3
[excitation.limits]
velocity = 2.0
acceleration = 5.0
"""


def _problem(folder, text=PROBLEM):
    (folder / "problem.toml").write_text(text)
    return problem_to_excite(folder / "problem.toml", {})


def _recorded(model, sigma, number):
    """The regression of a random path with noise of that size."""
    search = arm_problem(model)
    path = search.basis.trajectory(search.random(number))
    x = np.concatenate([np.ravel(arm(2).nominal), [2.0, 1.0]])
    motion = path.recording(100.0)
    rng = np.random.default_rng(number)
    return build_regression(
        model, simulate_torque(model, x, motion, noise=sigma, rng=rng)
    )


@pytest.mark.slow
def test_files_of_recordings_count_with_their_noise(tmp_path):
    problem = _problem(tmp_path)
    model = problem.model
    # The first two were weighted already, each in its own way.
    made = [_recorded(model, 0.3, k).weighted([0.5 + k, 2.0]) for k in range(2)]
    files = [save_regression(r, tmp_path / f"{k}.json") for k, r in enumerate(made)]
    earlier = earlier_recordings(problem, files)
    found = playable_design(
        problem, earlier=earlier, starts=1, workers=1, time_limit=20.0
    ).design
    sigma = found.aim.noise_of(model.torque_joints)
    # About 500 samples each: sizes are known to a few percent.
    np.testing.assert_allclose(sigma, 0.3, rtol=0.1)
    columns = list(found.base.independent)
    W = path_regressor(model, found.base, found.trajectory, 100.0)
    M = np.einsum("jnb,jnc,j->bc", W, W, sigma**-2.0)
    for regression in made:
        plain = regression.weighted(np.ones(2))
        for F, s in zip(plain.factors, sigma, strict=True):
            M += (F[:, columns] / s).T @ (F[:, columns] / s)
    errors = np.sqrt(np.diag(np.linalg.inv(M)) * found.accuracy.correlation)
    np.testing.assert_allclose(found.accuracy.standard_errors(), errors, rtol=1e-6)


def test_what_is_no_recording_of_the_robot_is_refused(tmp_path, capsys):
    problem = _problem(tmp_path)
    body = InertialParameters.from_central(1.0, np.zeros(3), np.eye(3))
    estimate = estimate_of(problem.model, [body] * 2, 0.1)
    delivered = estimate.save(tmp_path / "delivered.json")
    with pytest.raises(ProblemError, match=r"delivered\.json.*compress PROBLEM"):
        earlier_recordings(problem, [delivered])
    other = replace(problem.model, robot=arm(2))
    file = save_regression(_recorded(other, 0.3, 0), tmp_path / "other.json")
    near = _problem(tmp_path, PROBLEM.replace("-90.0", "-80.0"))
    with pytest.raises(ProblemError, match=r"other\.json.*another torque model"):
        earlier_recordings(near, [file])
    call = ["excite", str(tmp_path), "--dry-run", "--earlier", str(delivered)]
    assert main(call) == 2
    assert "compress PROBLEM" in capsys.readouterr().err
