"""Rows filtered like the torque: an explicit matrix, and a truth that stays exact."""

from dataclasses import replace

import numpy as np
import pytest
from filter_matrix import filter_matrix
from robots import random_robot

from consistent_id import (
    DriveTerms,
    Recording,
    TorqueModel,
    build_regression,
    low_passed,
    simulate_torque,
    trimmed,
)
from consistent_id.recordings.signals.filtered_rows import RowFilter
from consistent_id.regression.motion_arrays import FilteredRows
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.row_structure import row_structure
from consistent_id.regression.segments import merged, segment_regressions
from consistent_id.regression.torque_along import measured_torque, predicted_torque
from consistent_id.signals import (
    blocked_folds,
    decimated,
    faster,
    trim_standstill,
    without,
    without_rests,
)

RATE, CUTOFF = 500.0, 20.0
STEP = 5  # five rows in a period of 20 Hz


def _run(samples=6000):
    """A robot with dry friction, its parameters and a run without noise."""
    rng = np.random.default_rng(3)
    _, robot = random_robot(rng, 3)
    terms = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True)
    model = TorqueModel(robot, terms)
    t = np.arange(samples) / RATE
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


def _stacked(model, log):
    """Rows before the filter, torque last, shape (samples, columns) for each joint."""
    Y = model.regressor(log.position, log.velocity, log.acceleration)
    return [np.column_stack([Y[j].T, log.torque[:, j]]) for j in range(len(Y))]


def _assert_squared(factor, rows):
    gram = rows.T @ rows
    assert np.allclose(factor.T @ factor, gram, rtol=0, atol=1e-12 * abs(gram).max())


@pytest.mark.parametrize("samples", [3, 4])
def test_of_a_recording_shorter_than_a_step_the_middle_row_is_kept(samples):
    model, _, log = _run(samples + 40)
    left = low_passed(log, torque_cutoff=CUTOFF).samples(slice(6, 6 + samples))
    found = motion_of(model, left, None)
    np.testing.assert_array_equal(found.q, log.position[[6 + samples // 2]])


# Shorter than the kernel's reach, about as long, and several times as long.
@pytest.mark.parametrize("samples", [60, 200, 1300])
def test_rows_are_those_of_a_filter_on_the_stacked_regressor(samples):
    model, _, log = _run(samples)
    found = build_regression(model, low_passed(log, torque_cutoff=CUTOFF))
    reach = RowFilter(CUTOFF / RATE).reach
    assert 60 < reach < 200
    F = filter_matrix(samples, CUTOFF / RATE, 4, reach)
    for j, rows in enumerate(_stacked(model, log)):
        _assert_squared(found.factors[j], F[::STEP] @ rows)
        assert found.counts[j] == samples / STEP


def test_rows_without_weight_are_zero_before_the_filter():
    model, _, log = _run(1300)
    torque, weights = log.torque.copy(), np.ones((1300, 3))
    torque[800:900, 1], weights[800:900, 1] = 1e6, 0.0
    smooth = low_passed(replace(log, torque=torque), torque_cutoff=CUTOFF)
    found = build_regression(model, smooth, row_weights=[weights])
    reach = RowFilter(CUTOFF / RATE).reach
    F = filter_matrix(1300, CUTOFF / RATE, 4, reach)
    powers = filter_matrix(1300, CUTOFF / RATE, 4, reach, squared=True)[::STEP]
    for j, rows in enumerate(_stacked(model, log)):
        _assert_squared(found.factors[j], F[::STEP] @ (weights[:, j, None] * rows))
        # Rows count by the power of the noise that is left in them, from 5 % on.
        left = powers @ weights[:, j]
        assert found.counts[j] == np.rint(left[left > 0.05].sum())
    assert found.counts[0] == 260 and 235 < found.counts[1] < 245


def test_weights_that_are_not_zero_scale_rows_after_the_filter():
    model, _, log = _run(1300)
    weights = np.random.default_rng(0).uniform(0.5, 2.0, (1300, 3))
    smooth = low_passed(log, torque_cutoff=CUTOFF)
    found = build_regression(model, smooth, row_weights=[weights])
    F = filter_matrix(1300, CUTOFF / RATE, 4, RowFilter(CUTOFF / RATE).reach)
    for j, rows in enumerate(_stacked(model, log)):
        _assert_squared(found.factors[j], weights[::STEP, j, None] * (F[::STEP] @ rows))


def _paused(log):
    """The log with a rest in its middle, in which friction may hold anything."""
    still = np.arange(len(log)) // 500 == 6
    velocity = np.where(still[:, None], 0.0, log.velocity)
    torque = np.where(still[:, None], 7.0, log.torque)
    return replace(log, velocity=velocity, torque=torque)


WAYS = {
    "low-passed": lambda log: low_passed(log, torque_cutoff=CUTOFF),
    "low-passed below 1 Hz": lambda log: low_passed(log, torque_cutoff=0.6),
    "decimated": lambda log: decimated(log, 5),
    "low-passed, then decimated": lambda log: decimated(
        low_passed(log, torque_cutoff=CUTOFF), 3
    ),
    "low-passed twice": lambda log: low_passed(
        low_passed(log, torque_cutoff=40.0), torque_cutoff=CUTOFF
    ),
    "trimmed": lambda log: trimmed(low_passed(log, torque_cutoff=CUTOFF), 1.23, 9.87),
    "thinned": lambda log: low_passed(log, torque_cutoff=CUTOFF).samples(
        slice(1, None, 3)
    ),
    "of fast samples": lambda log: faster(low_passed(log, torque_cutoff=CUTOFF), 0.3),
    "without rests": lambda log: without_rests(
        low_passed(_paused(log), torque_cutoff=CUTOFF), 0.01
    ),
    "without samples": lambda log: without(
        low_passed(_paused(log), torque_cutoff=CUTOFF), _paused(log).velocity == 0.0
    ),
    "without standstill": lambda log: trim_standstill(
        low_passed(_paused(log), torque_cutoff=CUTOFF), 0.01
    ).samples(slice(0, 2500)),
    "folded": lambda log: (
        blocked_folds(low_passed(log, torque_cutoff=CUTOFF), 4)[1].training
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_the_truth_stays_exact_where_friction_jumps(way):
    model, truth, log = _run()
    found = build_regression(model, WAYS[way](log))
    assert (found.residual_rms(truth) < 1e-12 * found.torque_rms).all()


@pytest.mark.slow
def test_segments_and_their_sum_hold_the_truth():
    model, truth, log = _run()
    smooth = low_passed(log, torque_cutoff=CUTOFF)
    parts = segment_regressions(model, smooth, count=7)
    for part in (*parts, merged(parts)):
        assert (part.residual_rms(truth) < 1e-12 * part.torque_rms).all()
    whole = build_regression(model, smooth)
    assert merged(parts).counts == whole.counts


def test_rows_of_filtered_samples_would_blur_friction():
    model, truth, log = _run()
    smooth = low_passed(log, torque_cutoff=CUTOFF)
    found = build_regression(model, replace(smooth, torque_filter=None))
    assert (found.residual_rms(truth) > 1e-4 * found.torque_rms).all()


def test_predicted_and_measured_torque_pass_the_same_filter():
    model, truth, log = _run(1300)
    smooth = trimmed(low_passed(log, torque_cutoff=CUTOFF), 0.4, 2.0)
    predicted = predicted_torque(model, truth, smooth)
    size = abs(smooth.torque).max()
    np.testing.assert_allclose(predicted, smooth.torque, rtol=0, atol=1e-12 * size)
    measured = measured_torque(model, smooth)
    np.testing.assert_allclose(measured, smooth.torque, rtol=0, atol=1e-12 * size)
    motion = motion_of(model, smooth, None)
    found = motion.predicted(model, truth)
    np.testing.assert_allclose(found, motion.torque, rtol=0, atol=1e-12 * size)
    kept = smooth.torque[motion.places]
    np.testing.assert_allclose(motion.torque, kept, rtol=0, atol=1e-12 * size)


def test_runs_of_rows_and_pieces_are_those_of_the_whole():
    model, _, log = _run(3000)
    smooth = decimated(log, 2)
    motion = motion_of(model, smooth, None)
    whole = motion.regressor(model)
    assert whole.shape[2] == len(motion.q) == 1500
    part = motion.samples(100, 900).samples(50, 300)
    np.testing.assert_allclose(
        part.regressor(model),
        whole[:, :, 150:400],
        rtol=0,
        atol=1e-12 * abs(whole).max(),
    )
    assert sum(len(piece.q) for piece in motion.pieces()) == len(motion.q)


def test_a_filtered_log_with_one_joint_masked_and_wrong_holds_the_truth():
    model, truth, log = _run()
    saturated = abs(log.torque) > np.quantile(abs(log.torque), 0.85, axis=0)
    torque = np.where(saturated, 0.0, log.torque)
    smooth = low_passed(replace(log, torque=torque), torque_cutoff=CUTOFF)
    weights = np.where(saturated, 0.0, 1.0)
    found = build_regression(model, smooth, row_weights=[weights])
    assert (found.residual_rms(truth) < 1e-12 * found.torque_rms).all()
    assert (np.array(found.counts) < 0.9 * len(log) / STEP).all()


@pytest.mark.slow
def test_workers_that_want_the_same_rows_at_once_compute_them_once(monkeypatch):
    model, _, log = _run(60_000)
    smooth = low_passed(log, torque_cutoff=CUTOFF)
    assert len(list(motion_of(model, smooth, None).pieces())) > 2
    done = []

    def filtered(rows, model, kept, samples, span):
        done.append(samples)
        return one_run(rows, model, kept, samples, span)

    one_run = FilteredRows._filtered
    monkeypatch.setattr(FilteredRows, "_filtered", filtered)
    build_regression(model, smooth)
    every = np.sort(np.concatenate(done))
    assert np.array_equal(every, motion_of(model, smooth, None).filtered.kept)


@pytest.mark.slow
def test_rows_that_are_kept_are_those_that_are_computed_piece_by_piece():
    model, _, log = _run(20_000)
    motion = motion_of(model, low_passed(log, torque_cutoff=CUTOFF), None)
    columns = [kept for kept, _ in row_structure(model)]
    runs = list(motion.filtered.computed(model, columns, slice(None)))
    assert len(runs) > 1
    for j, rows in enumerate(motion.filtered.filled(model, columns)):
        pieces = np.concatenate([blocks[j] for _, blocks in runs])
        assert np.array_equal(rows[:, :-1], pieces[:, :-1])


def test_rows_of_equal_motion_are_made_once_whatever_the_torque(monkeypatch):
    model, _, log = _run(2000)
    made = []
    filled = FilteredRows.filled

    def counted(self, *args):
        made.append(self)
        return filled(self, *args)

    monkeypatch.setattr(FilteredRows, "filled", counted)
    other = replace(log, torque=2.0 * log.torque)
    faster_log = replace(log, velocity=1.1 * log.velocity)
    one, two, three = (
        build_regression(model, low_passed(each, torque_cutoff=CUTOFF), noise=False)
        for each in (log, other, faster_log)
    )
    assert len(made) == 2  # not again for the other torque, but for another motion
    for first, second in zip(one.factors, two.factors, strict=True):
        np.testing.assert_allclose(abs(second[:, -1]), 2.0 * abs(first[:, -1]))
        np.testing.assert_allclose(abs(second[:, :-1]), abs(first[:, :-1]), atol=1e-9)
    assert not np.allclose(abs(three.factors[0]), abs(one.factors[0]))
