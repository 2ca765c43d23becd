"""Singular values and least squares where NumPy's method does not converge."""

import numpy as np
import pytest

from consistent_id._support.singular import lstsq, pinv, singular_values, svd

RNG = np.random.default_rng(0)
TALL = RNG.normal(size=(9, 5)) @ np.diag([1.0, 1.0, 1e-3, 1.0, 0.0])
each_matrix = pytest.mark.parametrize("A", [TALL, TALL.T, TALL[:5]])


@pytest.fixture
def never(monkeypatch):
    """NumPy's methods, none of which converges."""

    def fails(*given, **named):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fails)
    monkeypatch.setattr(np.linalg, "lstsq", fails)
    monkeypatch.setattr(np.linalg, "pinv", fails)


@each_matrix
@pytest.mark.parametrize("full", [True, False])
def test_the_other_method_decomposes_as_well(A, full, never):
    U, s, Vt = svd(A, full_matrices=full)
    assert len(U) == len(A) and Vt.shape[1] == A.shape[1]
    assert (U.shape[1], len(Vt)) == (A.shape if full else (len(s), len(s)))
    np.testing.assert_allclose(U[:, : len(s)] * s @ Vt[: len(s)], A, atol=1e-13)
    np.testing.assert_allclose(U.T @ U, np.eye(U.shape[1]), atol=1e-13)
    np.testing.assert_array_equal(singular_values(A), svd(A, full_matrices=False).s)


@each_matrix
@pytest.mark.parametrize("rcond", [None, 1e-2])
@pytest.mark.parametrize("columns", [(), (2,)])
def test_solutions_are_the_smallest(A, rcond, columns, request):
    b = RNG.normal(size=(len(A), *columns))
    expected = np.linalg.lstsq(A, b, rcond=rcond)[0]
    np.testing.assert_array_equal(lstsq(A, b, rcond), expected)
    request.getfixturevalue("never")
    np.testing.assert_allclose(lstsq(A, b, rcond), expected, rtol=1e-9, atol=1e-12)


@each_matrix
@pytest.mark.parametrize("rcond", [1e-15, 1e-2])
def test_pseudo_inverses_are_as_numpys(A, rcond, request):
    expected = np.linalg.pinv(A, rcond=rcond)
    np.testing.assert_array_equal(pinv(A, rcond), expected)
    request.getfixturevalue("never")
    np.testing.assert_allclose(pinv(A, rcond), expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(("last", "rank"), [(1e-14, 2), (1e-17, 1)])
def test_the_tolerance_is_numpys_unless_it_is_given(last, rank, never):
    A, b = np.diag([1.0, last]), np.ones(2)
    assert np.count_nonzero(lstsq(A, b)) == rank
    assert np.count_nonzero(lstsq(A, b, 0.1 * last)) == 2
    assert np.count_nonzero(lstsq(A, b, 2.0 * last)) == 1


def test_values_that_are_not_finite_are_refused(never):
    with pytest.raises(np.linalg.LinAlgError):
        svd(np.array([[1.0, np.nan]]))
