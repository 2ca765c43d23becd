"""Free parameters under equalities: spans, and the complement that data determine."""

import numpy as np
import pytest
from experiments import pendulum

from consistent_id import FixedMasses
from consistent_id.constraints import ParameterBounds
from consistent_id.estimation.determination import FreeParameters


def test_directions_change_nothing_that_is_fixed_and_the_start_satisfies_it():
    model, _, _ = pendulum()
    free = FreeParameters.of([FixedMasses({"link1": 3.0})], model)
    mass = model.layout.index("link1.m")
    assert free.start[mass] == pytest.approx(3.0, rel=1e-14)
    assert abs(free.directions[mass]).max() < 1e-14
    assert free.directions.shape == (len(model.layout), len(model.layout) - 1)
    gram = free.directions.T @ free.directions
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-14)


def test_bounds_are_no_equalities():
    model, _, _ = pendulum()
    free = FreeParameters.of([ParameterBounds({"link1.m": (1.0, 2.0)})], model)
    assert free.directions.shape == (len(model.layout), len(model.layout))


def test_what_rows_determine_is_orthogonal_in_unit_columns_to_what_they_do_not():
    """``A = [a, 10 a, b]``: of the first two only one combination is determined."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 20))
    A = np.column_stack([a, 10.0 * a, b])
    found = FreeParameters(np.zeros(3), np.eye(3)).spanned(A).directions
    assert found.shape == (3, 2)
    open_step = np.array([10.0, -1.0, 0.0])
    units = np.linalg.norm(A, axis=0)
    inner = (units * open_step) @ (units[:, None] * found)
    np.testing.assert_allclose(inner, 0.0, atol=1e-10 * np.linalg.norm(units))
    assert np.linalg.matrix_rank(A @ found) == 2


def test_moves_are_the_standard_errors_of_white_noise_of_level_one():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(30, 4)) * [1.0, 10.0, 100.0, 0.1]
    directions = rng.normal(size=(6, 4))
    covariance = directions @ np.linalg.inv(A.T @ A) @ directions.T
    moves = FreeParameters(np.zeros(6), directions).moves(A)
    np.testing.assert_allclose(moves, np.sqrt(np.diag(covariance)), rtol=1e-10)
