"""The own zero-phase filter gives what SciPy's gives, up to rounding."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from consistent_id.recordings.signals.filters import settling, zero_phase

EPS = np.finfo(np.float64).eps


@pytest.mark.parametrize("order", [1, 2, 3, 4, 7, 8])
@pytest.mark.parametrize("cutoff", [1.0, 20.0])
def test_a_start_is_forgotten_once_the_slowest_pole_has_faded_to_a_part_in_1e22(
    order, cutoff
):
    poles = butter(order, cutoff, fs=100.0, output="zpk")[1]
    samples = np.log(1e-22) / np.log(abs(poles).max())
    found = settling(cutoff=cutoff, rate=100.0, order=order)
    assert found == pytest.approx(samples + 1.5, abs=0.5 + 1e-6 * samples)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 7, 8])
@pytest.mark.parametrize("cutoff", [1e-4, 0.01, 0.2, 0.49])
@pytest.mark.parametrize("pad", [0, 15, 2999])
def test_filtered_as_by_scipy(order, cutoff, pad):
    walk = np.cumsum(np.random.default_rng(0).normal(size=(3000, 3)), axis=0) + 50.0
    expected = sosfiltfilt(
        butter(order, cutoff, fs=1.0, output="sos"), walk, axis=0, padlen=pad
    )
    smooth = zero_phase(walk, cutoff=cutoff, rate=1.0, order=order, pad=pad)
    # Poles 2 pi f from the unit circle magnify the rounding of their coefficients by
    # 1 / (2 pi f)^2; next to Nyquist zeros and poles meet likewise.
    f = min(cutoff, 0.5 - cutoff)
    tolerance = 100 * EPS * (1.0 + (2 * np.pi * f) ** -2) * abs(walk).max()
    np.testing.assert_allclose(smooth, expected, rtol=0, atol=tolerance)
