"""Standard errors from segments left out, against fits that leave them out."""

import numpy as np
import pytest

from consistent_id.diagnosis.linearise import jackknife


def _system(seed=0):
    """Two joints, 410 samples, six columns that depend on each other."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2, 410, 6)) @ rng.normal(size=(6, 6))
    return A, A @ rng.normal(size=6) + rng.normal(size=(2, 410))


def _left_out(A, z):
    """Return solution and errors, every segment left out by hand."""
    whole = np.linalg.lstsq(A.reshape(-1, A.shape[2]), z.ravel())[0]
    moves = []
    for cut in np.array_split(np.arange(A.shape[1]), 20):
        rest = np.setdiff1d(np.arange(A.shape[1]), cut)
        rows = A[:, rest].reshape(-1, A.shape[2])
        moves.append(np.linalg.lstsq(rows, z[:, rest].ravel())[0] - whole)
    return whole, np.sqrt(19 / 20 * np.sum(np.square(moves), axis=0))


def test_errors_are_those_of_segments_left_out():
    A, z = _system()
    solution, errors = _left_out(A, z)
    fit = jackknife(A, z).fitted(list(range(6)))
    np.testing.assert_allclose(fit.solution, solution, rtol=1e-8)
    np.testing.assert_allclose(fit.errors, errors, rtol=1e-8)
    misfit = np.linalg.norm(z - A @ solution)
    assert fit.misfit == pytest.approx(misfit, rel=1e-10)


@pytest.mark.parametrize("columns", [[1], [0, 2], [2, 1, 0]])
def test_eliminated_columns_are_fitted_all_the_same(columns):
    A, z = _system(1)
    chosen = [0, 1, 2, *(3 + c for c in columns)]
    solution, errors = _left_out(A[:, :, chosen], z)
    # One of the eliminated columns says nothing new; it must do no harm.
    twice = np.concatenate([A[:, :, :3], A[:, :, :1] - A[:, :, 1:2], A[:, :, 3:]], 2)
    fit = jackknife(twice, z).without(4).fitted(columns)
    np.testing.assert_allclose(fit.solution, solution[3:], rtol=1e-7)
    np.testing.assert_allclose(fit.errors, errors[3:], rtol=1e-7)


def test_a_column_that_the_eliminated_ones_span_is_lost():
    A, z = _system(2)
    A = np.concatenate([A, A[:, :, :1] + A[:, :, 1:2]], axis=2)
    fit = jackknife(A, z).without(3).fitted([0, 3])
    assert np.isfinite(fit.errors[0])
    assert np.isinf(fit.errors[1])


def test_two_systems_together_are_one_with_their_rows_interleaved():
    (A, z), (B, y) = _system(3), _system(4)
    both = (jackknife(A, z) + jackknife(B, y)).fitted(list(range(6)))
    # Segments of twenty: those of the first log beside those of the second.
    cuts = np.array_split(np.arange(410), 20)
    rows = [np.concatenate([A[:, c], B[:, c]], axis=1) for c in cuts]
    right = [np.concatenate([z[:, c], y[:, c]], axis=1) for c in cuts]
    whole = np.linalg.lstsq(
        np.concatenate(rows, 1).reshape(-1, 6), np.concatenate(right, 1).ravel()
    )[0]
    np.testing.assert_allclose(both.solution, whole, rtol=1e-8)
    moves = [
        np.linalg.lstsq(
            np.concatenate(rows[:g] + rows[g + 1 :], 1).reshape(-1, 6),
            np.concatenate(right[:g] + right[g + 1 :], 1).ravel(),
        )[0]
        - whole
        for g in range(20)
    ]
    errors = np.sqrt(19 / 20 * np.sum(np.square(moves), axis=0))
    np.testing.assert_allclose(both.errors, errors, rtol=1e-8)


def test_errors_that_repeat_with_a_period_are_not_halved_by_its_repetitions():
    rng = np.random.default_rng(0)
    A, z = rng.normal(size=(1, 200, 4)), rng.normal(size=(1, 200))
    once = jackknife(A, z).fitted(list(range(4)))
    phase = np.tile(np.arange(200), 4)
    A4, z4 = np.tile(A, (1, 4, 1)), np.tile(z, (1, 4))
    four = jackknife(A4, z4, phase).fitted(list(range(4)))
    np.testing.assert_allclose(four.errors, once.errors, rtol=1e-8)
    assert (jackknife(A4, z4).fitted(list(range(4))).errors < 0.8 * once.errors).any()
