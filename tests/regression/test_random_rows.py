"""Compressed rows of random motions: the same ranks, norms and torques as the rows."""

import numpy as np
import pytest
from quadrupeds import quadruped_text
from robots import random_robot

from consistent_id import DriveTerms, TorqueModel
from consistent_id.regression.row_structure import (
    random_regressor,
    random_rows,
    random_states,
)
from consistent_id.robot import load_mjcf

DRIVE = DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.05, stribeck_velocity=0.01
)


@pytest.mark.parametrize("seed", range(4))
def test_they_are_the_rows_up_to_a_rotation(seed):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 5, tree=bool(seed % 2))
    model = TorqueModel(robot, DRIVE)
    rows, W = random_rows(model, seed=seed), random_regressor(model, seed=seed)
    assert rows.samples == W.shape[2]
    for row, whole in enumerate(W):
        R = rows.dense(row)
        np.testing.assert_allclose(R.T @ R, whole @ whole.T, atol=1e-10)
    S = rows.stacked()
    squares = np.einsum("rps,rqs->pq", W, W)
    np.testing.assert_allclose(S.T @ S, squares, atol=1e-9 * squares.max())
    np.testing.assert_allclose(rows.norms**2, np.diag(squares), rtol=1e-12)
    x = rng.normal(size=len(model.layout))
    torque = np.einsum("rps,p->rs", W, x)
    np.testing.assert_allclose(
        rows.rms(x), np.sqrt(np.mean(torque**2, axis=1)), rtol=1e-12
    )


def test_there_are_three_times_as_many_states_as_parameters():
    _, robot = random_robot(np.random.default_rng(0), 2)
    model = TorqueModel(robot, DRIVE)
    assert random_rows(model).samples == 3 * len(model.layout)


def test_a_base_that_floats_is_turned_and_feels_gravity_in_all_directions(tmp_path):
    (tmp_path / "robot.xml").write_text(quadruped_text())
    model = TorqueModel(load_mjcf(tmp_path / "robot.xml", base="floating"))
    base = random_states(model, samples=400).base
    R = base.rotation
    np.testing.assert_allclose(
        R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (400, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    # What is felt beside gravity is as large as was drawn: 2 m/s^2 either way.
    felt = base.specific_force + np.einsum("nij,i->nj", R, model.robot.gravity)
    assert 1.9 < abs(felt).max() <= 2.0


def test_rows_have_the_columns_of_what_they_carry_alone():
    _, robot = random_robot(np.random.default_rng(0), 4, tree=False)
    model = TorqueModel(robot, DriveTerms(stribeck_velocity=1e-3, coulomb="sign"))
    last = random_rows(model).columns[-1]
    inertial, per_joint = model.layout.inertial_size, len(model.terms[0].names)
    assert not set(last) & set(range(inertial - 10))
    # Friction that fades within a thousandth of the usual speed shows all the same.
    assert set(last) >= set(range(len(model.layout) - per_joint, len(model.layout)))


def test_every_other_sample_is_slow_where_friction_fades_and_nowhere_else():
    _, robot = random_robot(np.random.default_rng(3), 2)
    plain = TorqueModel(robot, DriveTerms(viscous=True))
    fading = TorqueModel(robot, DRIVE)
    fast, slow = (random_states(m, seed=1, samples=400).dq for m in (plain, fading))
    np.testing.assert_allclose(slow[1::2], fast[1::2])
    np.testing.assert_allclose(slow[::2], DRIVE.stribeck_velocity * fast[::2])
    # Velocities are up to two, of samples with an even number, too.
    assert 1.9 < abs(fast[::2]).max() <= 2.0
