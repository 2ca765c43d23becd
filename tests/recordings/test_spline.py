"""The own cubic spline gives what SciPy's gives, up to rounding."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from consistent_id.recordings.signals.clocks import cubic_spline


@pytest.mark.parametrize("samples", [2, 3, 4, 5, 6, 400])
def test_between_jittered_stamps_as_by_scipy(samples):
    rng = np.random.default_rng(0)
    time = 1e3 + np.cumsum(rng.uniform(0.2, 1.8, samples))
    values = rng.normal(size=(samples, 3))
    clock = np.append(rng.uniform(time[0], time[-1], 1000), time)
    expected = CubicSpline(time, values)(clock)
    # Steps of about 1 between stamps of 1e3 have lost three digits.
    np.testing.assert_allclose(
        cubic_spline(time, values, clock), expected, rtol=0, atol=1e-11
    )


def test_a_cubic_is_its_own_spline():
    time = np.array([0.0, 0.5, 2.0, 2.5, 4.0, 7.0])
    clock = np.linspace(0.0, 7.0, 29)
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25])
    found = cubic_spline(time, cubic(time)[:, None], clock)
    np.testing.assert_allclose(found[:, 0], cubic(clock), rtol=0, atol=1e-12)
