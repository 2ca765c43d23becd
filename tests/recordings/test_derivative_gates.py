"""Derivatives and series of motions that are known exactly, and limits of both."""

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings.signals.derivatives import (
    differentiated,
    lost_acceleration,
    savitzky_golay_differentiated,
)
from consistent_id.recordings.signals.fourier import (
    fit_trajectory,
    fourier_differentiated,
    fourier_fit,
)
from consistent_id.recordings.signals.smoother import MotionNoise, kalman_differentiated


def log(values, rate=10.0, **more):
    values = np.asarray(values, dtype=float)
    return Recording(("j",), np.arange(len(values)) / rate, values[:, None], **more)


def test_differences_are_exact_where_motion_is_a_polynomial():
    """Second differences of a cubic, first ones of a square, at the ends as well."""
    t = np.arange(9) / 10.0
    cubic = differentiated(log(t**3 - t))
    np.testing.assert_allclose(cubic.acceleration[:, 0], 6.0 * t, atol=1e-11)
    square = differentiated(log(t**2 - 3.0 * t))
    np.testing.assert_allclose(square.velocity[:, 0], 2.0 * t - 3.0, atol=1e-12)
    # A measured velocity is kept; it need not be that of the position.
    kept = differentiated(log(t, velocity=(t**2)[:, None]))
    assert kept.velocity[:, 0].tolist() == (t**2).tolist()
    np.testing.assert_allclose(kept.acceleration[:, 0], 2.0 * t, atol=1e-12)
    kept = differentiated(log(t, acceleration=(t**2)[:, None]))
    assert kept.acceleration[:, 0].tolist() == (t**2).tolist()
    assert len(differentiated(log(t[:4]))) == 4
    with pytest.raises(RecordingError, match="3 samples, expected 4"):
        differentiated(log(t[:3]))


@pytest.mark.parametrize(("window", "degree"), [(0.5, 4), (0.9, 4), (0.3, 2), (0.9, 3)])
def test_sliding_polynomials_are_exact_up_to_their_degree(window, degree):
    t = np.arange(9) / 10.0
    found = savitzky_golay_differentiated(log(t**degree), window, degree=degree)
    np.testing.assert_allclose(found.position[:, 0], t**degree, atol=1e-11)
    slope = degree * t ** (degree - 1)
    np.testing.assert_allclose(found.velocity[:, 0], slope, atol=1e-10)
    bend = degree * (degree - 1) * t ** (degree - 2)
    np.testing.assert_allclose(found.acceleration[:, 0], bend, atol=1e-9)


@pytest.mark.parametrize(
    ("window", "degree", "message"),
    [
        (0.5, 5, "holds 5 samples, expected more than the degree 5"),
        (0.5, 1, "degree is 1"),
        (0.5, 2.5, "degree is 2.5"),
        (0.0, 4, "a window of 0.0 s"),
        (0.91, 4, "at most the recording's 0.9 s"),
    ],
)
def test_sliding_polynomials_need_more_samples_than_their_degree(
    window, degree, message
):
    with pytest.raises(RecordingError, match=message):
        savitzky_golay_differentiated(log(np.arange(9.0)), window, degree=degree)


def test_a_window_has_an_odd_number_of_samples():
    """Of 5 to 6.9 samples there are 5: a cubic through 5 is not one through 7."""
    rng = np.random.default_rng(0)
    noisy = log(rng.normal(size=30))
    five = savitzky_golay_differentiated(noisy, 0.45, degree=3)
    for window, same in ((0.41, True), (0.59, True), (0.61, False), (0.39, False)):
        other = savitzky_golay_differentiated(
            noisy, window, degree=3 if window > 0.4 else 2
        )
        assert np.array_equal(other.position, five.position) is same


def test_a_velocity_lacks_as_much_acceleration_as_its_fast_part_is_damped():
    t = np.arange(4000) / 100.0
    for gain in (0.3, 0.8):
        q = np.sin(2.0 * t) + 0.1 * np.sin(20.0 * t)
        v = 2.0 * np.cos(2.0 * t) + gain * 2.0 * np.cos(20.0 * t)
        # Accelerations are 4 and 40; weights are their squares.
        expected = np.sqrt(1600.0 * (1.0 - gain) ** 2 / 1616.0)
        for unit in (1.0, 0.01):
            lost = lost_acceleration(t, q[:, None], unit * v[:, None], highest=10.0)
            assert lost[0] == pytest.approx(expected, rel=0.03)
        slow = lost_acceleration(t, q[:, None], v[:, None], highest=2.0)
        assert slow[0] == pytest.approx(0.0, abs=0.01)
    more = 2.0 * np.cos(2.0 * t) + 4.0 * np.cos(20.0 * t)
    lost = lost_acceleration(t, q[:, None], more[:, None], highest=10.0)
    assert lost[0] == pytest.approx(0.0, abs=1e-6)


def wave(n, period, rate=10.0, harmonic=0.0, order=2):
    t = np.arange(n) / rate
    w = 2.0 * np.pi / period
    return log(np.sin(w * t) + harmonic * np.sin(order * w * t), rate)


@pytest.mark.parametrize(
    ("samples", "most"),
    [
        (42, 10),  # a quarter of the samples, less two
        (45, 10),
        (46, 11),
        (202, 18),  # 0.45 of the sampling rate
    ],
)
def test_there_are_as_many_harmonics_as_samples_tell_apart(samples, most):
    motion = wave(samples, 4.0)
    assert len(fourier_fit(motion, 4.0, most).trajectory) == most
    for wrong in (0, most + 1):
        with pytest.raises(RecordingError, match=f"expected between 1 and {most} with"):
            fourier_fit(motion, 4.0, wrong)
    assert len(fourier_fit(motion, 4.0).criterion) == most


def test_fifty_harmonics_are_tried():
    motion = wave(402, 40.0, harmonic=0.1, order=49)
    found = fourier_fit(motion, 40.0)
    assert len(found.criterion) == 50
    assert len(found.trajectory) == 49
    assert len(fourier_fit(motion, 40.0, 60).trajectory) == 60


def test_a_whole_period_may_lack_its_last_sample():
    assert fourier_fit(wave(40, 4.0), 4.0, 1).period == 4.0
    with pytest.raises(RecordingError, match="expected at least one period of 4 s"):
        fourier_fit(wave(39, 4.0), 4.0, 1)
    for period in (0.0, np.inf):
        with pytest.raises(RecordingError, match="expected a positive number"):
            fourier_fit(wave(40, 4.0), period)


def test_the_criterion_and_the_residual_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    motion = log(wave(100, 4.0).position[:, 0] + 0.1 * rng.normal(size=100))
    found = fourier_fit(motion, 4.0, 3)
    t, q = motion.time, motion.position[:, 0]
    columns = [np.ones(100)]
    for k in (1, 2, 3):
        columns += [f(2.0 * np.pi * k * t / 4.0) for f in (np.sin, np.cos)]
        A = np.column_stack(columns)
        left = q - A @ np.linalg.lstsq(A, q, rcond=None)[0]
        variance = np.mean(left**2)
        expected = 100 * np.log(variance) + (2 * k + 1) * np.log(100)
        assert found.criterion[k - 1] == pytest.approx(expected, rel=1e-12)
    assert found.residual[0] == pytest.approx(np.sqrt(variance), rel=1e-12)


def test_a_series_that_leaves_a_tenth_of_the_motion_is_refused():
    """Of a second harmonic b, one harmonic leaves b / sqrt(1 + b^2)."""
    good = fourier_differentiated(wave(80, 4.0, harmonic=0.1), 4.0, 1)
    w = 2.0 * np.pi / 4.0
    np.testing.assert_allclose(
        good.acceleration[:, 0], -(w**2) * np.sin(w * good.time), atol=1e-9
    )
    with pytest.raises(RecordingError, match="with 1 harmonics of 4 s leaves 10%"):
        fourier_differentiated(wave(80, 4.0, harmonic=0.101), 4.0, 1)


def test_given_frequencies_are_resolved_up_to_045_of_the_rate():
    motion = wave(50, 4.0)
    assert len(fit_trajectory(motion, [0.25, 4.5]).trajectory) == 2
    for wrong, message in (
        ([0.25, 4.51], "expected at most 4.5 Hz"),
        ([], "positive and increasing"),
        ([0.0, 1.0], "positive and increasing"),
        ([1.0, 1.0], "positive and increasing"),
    ):
        with pytest.raises(RecordingError, match=message):
            fit_trajectory(motion, wrong)
    assert len(fit_trajectory(wave(10, 4.0), [1.0, 2.0]).trajectory) == 2
    with pytest.raises(RecordingError, match=r"9 samples for 2 frequencies.*least 10"):
        fit_trajectory(wave(9, 4.0), [1.0, 2.0])


def test_frequencies_whose_noise_is_ten_times_as_large_are_too_near():
    """The noise is that of least squares: the roots of the inverse normal matrix."""
    motion = wave(200, 4.0)  # 20 s
    for apart in np.linspace(0.004, 0.03, 14):
        pair = [1.0, 1.0 + apart]
        angles = 2.0 * np.pi * np.outer(motion.time, pair)
        A = np.column_stack([np.ones(200), np.sin(angles), np.cos(angles)])
        noise = np.sqrt(np.diag(np.linalg.inv(A.T @ A))[1:].max() * 200 / 2.0)
        if noise <= 10.0:
            fit_trajectory(motion, pair)
        else:
            with pytest.raises(RecordingError, match=r"1 Hz .*too near to resolve"):
                fit_trajectory(motion, pair)


def test_a_smoother_needs_48_samples_and_positive_noise():
    noise = MotionNoise(("j",), 3, [1e-3], [1.0])
    assert len(kalman_differentiated(wave(48, 4.0), noise)) == 48
    with pytest.raises(RecordingError, match="47 samples, expected 48"):
        kalman_differentiated(wave(47, 4.0), noise)
    other = Recording(("k",), np.arange(60.0), np.zeros((60, 1)))
    with pytest.raises(RecordingError, match="noise is that of joints"):
        kalman_differentiated(other, noise)
    for wrong in ({"position": [0.0]}, {"drive": [0.0]}, {"order": 2}, {"order": 7}):
        with pytest.raises(RecordingError):
            MotionNoise(
                **{"joints": ("j",), "order": 3, "position": [1.0], "drive": [1.0]}
                | wrong
            )


def test_a_window_as_long_as_an_even_log_is_the_next_shorter_odd_one():
    values = np.random.default_rng(0).normal(size=10)
    whole = savitzky_golay_differentiated(log(values), 1.0, degree=2)
    nine = savitzky_golay_differentiated(log(values), 0.9, degree=2)
    np.testing.assert_array_equal(whole.position, nine.position)
    fits = [np.polyfit(range(9), values[k : k + 9], 2) for k in range(2)]
    expected = [*np.polyval(fits[0], range(5)), *np.polyval(fits[1], range(4, 9))]
    np.testing.assert_allclose(whole.position[:, 0], expected)


def test_lost_acceleration_is_that_of_twelve_bands_written_out():
    rng = np.random.default_rng(2)
    step, n = 0.02, 101
    t = 3.0 + step * np.arange(n)
    w, phase = rng.uniform(1.0, 60.0, (40, 1, 1)), rng.uniform(0, 6, (40, 1, 2))
    size = [2e-3, 30.0] * rng.normal(size=(40, 1, 2)) / w
    q = np.sum(size * np.sin(w * t[:, None] + phase), axis=0)
    v = np.sum(size * w / (1 + w / 30) * np.cos(w * t[:, None] + phase), axis=0) + 0.1
    found = lost_acceleration(t, q, v, highest=9.0)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n - 2) / (n - 3))
    slope = (q[2:] - q[:-2]) / (2 * step)
    # Half of the rate is 25 Hz; a fifth of it is more than the highest.
    f = np.arange(1, n) / ((n - 2) * step)
    f = f[f <= 9.0]
    wave = np.exp(-2j * np.pi * np.outer(f * step, np.arange(n - 2)))
    for j in range(2):
        D, V = (wave @ (window * (x - x.mean())) for x in (slope[:, j], v[1:-1, j]))
        D = D * 2 * np.pi * f * step / np.sin(2 * np.pi * f * step)
        energy, fast = abs(D) ** 2, f**2 * abs(D) ** 2
        share = np.cumsum(energy / energy.sum() + fast / fast.sum()) / 2
        bands = [
            (share >= k / 12) & ((share < (k + 1) / 12) | (k == 11)) for k in range(12)
        ]
        bands = [band for band in bands if band.any()]
        gains = [abs(np.vdot(D[b], V[b])) / energy[b].sum() for b in bands]
        weights = np.array([fast[b].sum() for b in bands])
        lost = np.maximum(1 - np.array(gains) / gains[0], 0)
        assert found[j] == pytest.approx(np.sqrt(np.average(lost**2, weights=weights)))
    assert 0.2 < found.min() and found.max() < 0.8
    # Above a fifth of the rate nothing counts, whatever is asked for.
    most = [lost_acceleration(t, q, v, highest=at) for at in (10.0, 20.0)]
    np.testing.assert_array_equal(*most)


def test_polynomials_are_of_the_fourth_degree_if_nothing_else_is_said():
    noise = log(np.random.default_rng(1).normal(size=30))
    usual, fourth = (
        savitzky_golay_differentiated(noise, 1.1, **more)
        for more in ({}, {"degree": 4})
    )
    np.testing.assert_array_equal(usual.position, fourth.position)
