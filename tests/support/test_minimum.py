"""Brent's method between bounds ends where SciPy's does."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from consistent_id._support.minimum import bounded_minimum


@pytest.mark.parametrize("seed", range(20))
def test_the_minimum_is_scipys_with_no_more_calls(seed):
    a, b, c = np.random.default_rng(seed).normal(size=3)
    calls = []

    def f(x):
        calls.append(x)
        wave = abs(np.sin(a * x + b)) ** (1.0 + abs(c))
        return float(wave + 0.1 * c * x + 0.01 * np.cos(7.0 * x))

    found = bounded_minimum(f, -1.0, 2.0, tolerance=1e-6)
    assert all(-1.0 <= x <= 2.0 for x in calls)
    theirs = minimize_scalar(
        f, bounds=(-1.0, 2.0), method="bounded", options={"xatol": 1e-6}
    )
    assert found == pytest.approx(theirs.x, abs=3e-6)
    assert len(calls) - theirs.nfev <= theirs.nfev + 1


def test_a_function_that_falls_is_least_at_the_bound():
    found = bounded_minimum(lambda x: -x, 0.0, 1.0, tolerance=1e-6)
    assert found == pytest.approx(1.0, abs=2e-6)
