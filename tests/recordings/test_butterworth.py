"""The own zero-phase filter gives what SciPy's gives; ends keep their bend."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from consistent_id import Recording, RecordingError, differentiated, low_passed
from consistent_id.recordings.signals import filters
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


def filtered(positions, *, cutoff):
    """Return positions as `low_passed` leaves them, sampled at 100 Hz."""
    time = np.arange(len(positions)) / 100.0
    joints = tuple(f"joint{k}" for k in range(positions.shape[1]))
    log = Recording(joints, time, positions)
    return low_passed(log, motion_cutoff=cutoff).position


@pytest.mark.parametrize("cutoff", [3.0, 8.0, 30.0])
def test_a_cubic_passes_unchanged_up_to_both_ends(cutoff):
    """A Butterworth filter of order 4 is flat up to the seventh power of frequency."""
    time = np.arange(600) / 100.0
    cubic = np.column_stack([time**2, 5.0 - 2.0 * time + time**3 / 4.0])
    passed = filtered(cubic, cutoff=cutoff)
    np.testing.assert_allclose(passed, cubic, rtol=0, atol=1e-6 * abs(cubic).max())


@pytest.mark.parametrize("phase", [0.0, 1.0, np.pi / 2])
def test_acceleration_holds_at_both_ends(phase):
    time, rate = np.arange(500) / 100.0, 2.0 * np.pi * 0.9
    log = Recording(("elbow",), time, np.sin(rate * time + phase)[:, None])
    ready = differentiated(low_passed(log, motion_cutoff=10.0))
    true = -(rate**2) * np.sin(rate * time + phase)
    error = abs(ready.acceleration[:, 0] - true) / rate**2
    # Continued oddly, it would vanish at the ends: an error of up to 1.
    assert error.max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [3.0, 8.0, 30.0])
def test_a_bend_that_is_noise_moves_no_end(cutoff):
    noise = np.random.default_rng(0).normal(size=(300, 2000))
    pad = int(12 * 100.0 / cutoff)
    odd = zero_phase(noise, cutoff=cutoff, rate=100.0, order=4, pad=min(pad, 299))
    bent = filtered(noise, cutoff=cutoff)
    for end in (0, -1):
        assert bent[end].std() < 1.05 * odd[end].std()


def test_a_log_that_is_too_short_to_show_a_bend_is_continued_oddly():
    few = np.random.default_rng(0).normal(size=(15, 3))
    odd = zero_phase(few, cutoff=20.0, rate=100.0, order=4, pad=14)
    np.testing.assert_array_equal(filtered(few, cutoff=20.0), odd)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.3])
def test_the_bend_at_an_end_is_that_of_a_cubic_less_what_is_noise(noise):
    """Half of the second difference: the square's coefficient, per sample."""
    places = np.linspace(0.0, 1.0, 30)
    values = 2.0 + places - 0.7 * places**2 + 0.4 * places**3
    values = values + noise * np.random.default_rng(0).normal(size=30)
    powers = np.vander(places, 4, increasing=True)
    fitted = np.linalg.lstsq(powers, values, rcond=None)[0]
    left = np.sum((values - powers @ fitted) ** 2) / (30 - 4)
    variance = left * np.linalg.inv(powers.T @ powers)[2, 2]
    sure = fitted[2] ** 2 / (fitted[2] ** 2 + filters._SURE**2 * variance)
    found = filters._bend(values[:, None])
    np.testing.assert_allclose(found, [sure * fitted[2] / 29.0**2], rtol=1e-6)


@pytest.mark.parametrize(("samples", "bent"), [(42, True), (41, False)])
def test_an_end_is_bent_where_there_are_two_periods_of_the_cut_off(samples, bent):
    square = (np.arange(samples)[:, None] / 10.0) ** 2
    pad = samples - 1
    odd = zero_phase(square, cutoff=5.0, rate=100.0, order=4, pad=pad)
    assert np.array_equal(filtered(square, cutoff=5.0), odd) is not bent


@pytest.mark.parametrize(("cutoff", "refused"), [(0.0201, False), (0.0199, True)])
def test_a_cut_off_is_at_least_a_hundred_thousandth_of_the_rate(cutoff, refused):
    log = Recording(("elbow",), np.arange(20) / 2000.0, np.zeros((20, 1)))
    if refused:
        with pytest.raises(RecordingError, match=r"expected between 0\.02 Hz"):
            low_passed(log, motion_cutoff=cutoff)
    else:
        assert not low_passed(log, motion_cutoff=cutoff).position.any()


def test_the_lowest_cut_off_itself_is_allowed():
    log = Recording(("elbow",), np.arange(20) / 1024.0, np.zeros((20, 1)))
    low_passed(log, motion_cutoff=filters._LOWEST * 1024.0)
