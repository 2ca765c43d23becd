"""The own quintic spline gives what SciPy's gives, away from the ends."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from consistent_id.recordings.signals.uniform_spline import UniformSpline


@pytest.mark.parametrize("derivative", range(5))
def test_values_and_derivatives_as_by_scipy(derivative):
    rng = np.random.default_rng(derivative)
    time = 1e3 + np.arange(300) / 125.0
    values = rng.normal(size=(300, 2))
    # The ends are forgotten by 0.43 a sample: 60 samples leave 1e-22.
    clock = rng.uniform(time[60], time[-61], 500)
    expected = make_interp_spline(time, values, k=5)(clock, nu=derivative)
    found = UniformSpline.through(time, values).at(clock, derivative)
    # Instants near 1e3 s are known to 1e-13 s, of steps of 8e-3 s.
    atol = 1e-9 * abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def test_a_quintic_is_its_own_spline_inside():
    quintic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25, -0.1, 0.02])
    time = np.linspace(-1.0, 1.0, 201)
    clock = np.linspace(-0.3, 0.3, 77)
    spline = UniformSpline.through(time, quintic(time)[:, None])
    for order in range(3):
        exact = quintic.deriv(order)(clock) if order else quintic(clock)
        found = spline.at(clock, order)[:, 0]
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-8)


def test_the_samples_are_kept_to_the_very_ends():
    values = np.random.default_rng(0).normal(size=(9, 1))
    time = np.arange(9) * 0.1
    found = UniformSpline.through(time, values).at(time)
    np.testing.assert_allclose(found[2:-2], values[2:-2], rtol=0, atol=1e-12)
