import numpy as np
import pytest

from consistent_id.regression.model_errors import joint_fit


@pytest.fixture
def rows():
    """Rows of two joints of which some columns are zero, with noise of two levels."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=6)
    A = rng.normal(size=(2, 400, 6)) * [1.0, 1e3, 0.0, 1e-3, 1.0, 0.0]
    b = A @ x + np.array([[0.1], [2.0]]) * rng.normal(size=(2, 400))
    return x, [
        np.column_stack([*own.T, right]) for own, right in zip(A, b, strict=True)
    ]


def test_columns_of_zeros_get_zero_and_the_others_their_least_squares(rows):
    _, whole = rows
    fit = joint_fit([np.linalg.qr(own, mode="r") for own in whole], [400, 400])
    stacked = np.vstack([own / s for own, s in zip(whole, fit.weights, strict=True)])
    used = [0, 1, 3, 4]
    expected = np.linalg.lstsq(stacked[:, used], stacked[:, -1], rcond=None)[0]
    np.testing.assert_allclose(fit.x[used], expected, rtol=1e-9)
    np.testing.assert_array_equal(fit.x[[2, 5]], 0.0)
    np.testing.assert_allclose(fit.noise, [0.1, 2.0], rtol=0.1)


def test_weighted_rows_times_the_steps_are_orthonormal(rows):
    _, whole = rows
    fit = joint_fit([np.linalg.qr(own, mode="r") for own in whole], [400, 400])
    stacked = np.vstack([own / s for own, s in zip(whole, fit.weights, strict=True)])
    along = stacked[:, :-1] @ fit.steps
    np.testing.assert_allclose(along.T @ along, np.eye(4), atol=1e-12)
