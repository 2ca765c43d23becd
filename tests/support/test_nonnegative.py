"""The active-set method ends where SciPy's non-negative least squares does."""

import numpy as np
import pytest
from scipy.optimize import nnls

from consistent_id._support.nonnegative import nonnegative_least_squares


@pytest.mark.parametrize("seed", range(40))
def test_no_worse_than_scipy_with_free_and_doubled_and_empty_columns(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    A, b = rng.normal(size=(n + 3, n)), rng.normal(size=n + 3)
    if seed % 3 == 0:
        A[:, -1] = A[:, 0]
    if seed % 4 == 0:
        A[:, n // 2] = 0.0
    free = rng.uniform(size=n) < 0.3
    guess = rng.uniform(size=n) < 0.5 if seed % 2 else None
    # A free unknown is the difference of two that are not negative.
    _, least = nnls(np.column_stack([A, -A[:, free]]), b)
    x = nonnegative_least_squares(A, b, ~free, guess=guess)
    assert (x[~free] >= 0.0).all()
    assert np.linalg.norm(A @ x - b) <= least + 1e-10


def test_without_columns_there_is_nothing_to_find():
    none = np.zeros(0, dtype=bool)
    assert nonnegative_least_squares(np.zeros((3, 0)), np.ones(3), none).shape == (0,)
