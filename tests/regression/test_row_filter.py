"""Decimation of rows: torque and regressor pass one filter; the truth stays true."""

from dataclasses import replace

import numpy as np
import pytest
from robots import random_robot

from consistent_id import (
    DriveTerms,
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
    build_regression,
    simulate_torque,
)
from consistent_id.regression.motion_arrays import RowFilter
from consistent_id.signals import decimated

FACTOR = 5


def _run(samples=6000, rate=500.0):
    """A robot with dry friction, its parameters and a run without noise."""
    rng = np.random.default_rng(3)
    _, robot = random_robot(rng, 3)
    terms = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True)
    model = TorqueModel(robot, terms)
    t = np.arange(samples) / rate
    w = rng.uniform(1.0, 6.0, (3, 4))
    angle = t[:, None, None] * w + rng.uniform(0, 6, w.shape)
    motion = Recording(
        robot.joint_names,
        t,
        np.sin(angle).sum(axis=2),
        (w * np.cos(angle)).sum(axis=2),
        (-(w**2) * np.sin(angle)).sum(axis=2),
    )
    truth = np.concatenate([robot.nominal, rng.uniform(0.5, 5.0, 9)])
    return model, truth, simulate_torque(model, truth, motion)


def test_rows_are_those_of_a_filter_on_the_stacked_regressor():
    model, _, log = _run(700)
    found = build_regression(model, log, decimate=FACTOR)
    h = RowFilter(FACTOR).kernel
    Y = model.regressor(log.position, log.velocity, log.acceleration)
    for j, factor in enumerate(found.factors):
        rows = np.column_stack([Y[j].T, log.torque[:, j]])
        mixed = np.column_stack([np.convolve(r, h, "valid") for r in rows.T])[::FACTOR]
        gram, size = mixed.T @ mixed, abs(mixed.T @ mixed).max()
        assert np.allclose(factor.T @ factor, gram, rtol=0, atol=1e-12 * size)
        assert found.counts[j] == len(mixed)


def test_the_truth_stays_exact_where_a_filter_on_motion_and_torque_blurs_friction():
    model, truth, log = _run()
    mixed = build_regression(model, log, decimate=FACTOR)
    blurred = build_regression(model, decimated(log, FACTOR))
    assert (mixed.residual_rms(truth) < 1e-12 * mixed.torque_rms).all()
    assert (blurred.residual_rms(truth) > 1e-5 * blurred.torque_rms).all()
    assert mixed.counts[0] == len(RowFilter(FACTOR).centres(6000, "log"))


def test_rows_without_weight_are_mixed_into_nothing():
    model, truth, log = _run(2000)
    torque, weights = log.torque.copy(), np.ones((2000, 3))
    torque[800:900, 1], weights[800:900, 1] = 1e6, 0.0
    spoilt = replace(log, torque=torque)
    found = build_regression(model, spoilt, row_weights=[weights], decimate=FACTOR)
    assert (found.residual_rms(truth) < 1e-12 * log.torque.std(axis=0)).all()
    assert found.counts[0] - found.counts[1] == 100 / FACTOR


def test_what_cannot_be_decimated_is_refused():
    model, _, log = _run(100)
    with pytest.raises(ProblemError, match="decimation factor is 0"):
        build_regression(model, log, decimate=0)
    with pytest.raises(RecordingError, match=r"100 samples.* takes 129 for one row"):
        build_regression(model, log, decimate=8)
    time = log.time + 1e-4 * np.sin(np.arange(100))
    with pytest.raises(RecordingError, match="clock is not uniform"):
        build_regression(model, replace(log, time=time), decimate=2)
