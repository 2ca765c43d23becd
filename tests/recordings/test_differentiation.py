"""Ways to velocity and acceleration: closed forms, SciPy and dense least squares."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.special import gamma
from some_fast import some_fast

from consistent_id import signals
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.derivatives import sliding_polynomials
from consistent_id.recordings.signals.smoother import (
    _first_state,
    _likeliest,
    drive_covariance,
    smoothed,
    transition,
)

REPEATABLE = settings(derandomize=True, deadline=None, max_examples=20)
WAYS = {
    "savitzky-golay": lambda log: signals.savitzky_golay_differentiated(log, 0.21),
    "smoother": lambda log: signals.kalman_differentiated(log, noise_of(log.joints)),
    "fourier": lambda log: by_series(log, 2.0, 3),
}


def by_series(log, period, harmonics):
    """A series' motion, whatever it leaves: fourier_differentiated looks at that."""
    fit = signals.fourier_fit(log, period, harmonics)
    q, dq, ddq = fit.trajectory.evaluate(log.time)
    return replace(log, position=q, velocity=dq, acceleration=ddq)


def noise_of(joints, order=4):
    n = len(joints)
    return signals.MotionNoise(joints, order, np.full(n, 1e-3), np.full(n, 1e3))


def recording(time, values, **channels):
    values = values if values.ndim == 2 else values[:, None]
    names = tuple(f"j{k}" for k in range(values.shape[1]))
    return Recording(names, time, values, name="log 7", **channels)


def series(time, period=2.0, harmonics=3, joints=2, seed=0):
    """Position, velocity and acceleration of random Fourier series."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi / period * np.arange(1, harmonics + 1)[:, None]
    size, phase = rng.normal(size=(2, harmonics, joints))
    size /= np.arange(1, harmonics + 1)[:, None]
    angle = w * time[:, None, None] + phase
    return np.array(
        [
            (size * np.sin(angle)).sum(axis=1),
            (size * w * np.cos(angle)).sum(axis=1),
            (-size * w**2 * np.sin(angle)).sum(axis=1),
        ]
    )


def motion(log):
    return np.array([log.position, log.velocity, log.acceleration])


@pytest.mark.parametrize("way", WAYS)
def test_every_way_is_linear_and_does_not_care_when_it_was(way):
    time = np.arange(400) / 100.0
    a, b = np.random.default_rng(0).normal(size=(2, 400, 2))
    one, other = (WAYS[way](recording(time, x)) for x in (a, b))
    both = WAYS[way](recording(time + 5.0, 2 * a - 3 * b))
    # A stamp near 9 s rounds to 2e-15 s, and accelerations of noise reach 1e4; the
    # smoother's start is known to 1e-6 of the noise.
    expected = 2 * motion(one) - 3 * motion(other)
    scale = abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(motion(both) / scale, expected / scale, atol=1e-9)
    assert (both.time == time + 5.0).all()


@pytest.mark.parametrize("way", ["savitzky-golay", "smoother"])
def test_polynomials_up_to_the_third_degree_are_exact_up_to_the_ends(way):
    t = np.arange(400) / 100.0
    q = np.column_stack([1 - t + t**2 / 2 - t**3 / 5, 3 + t**2])
    found = motion(WAYS[way](recording(t, q)))
    truth = [
        q,
        np.column_stack([-1 + t - 3 * t**2 / 5, 2 * t]),
        np.column_stack([1 - 6 * t / 5, np.full(400, 2.0)]),
    ]
    # Windows of 21 samples lose 1e-11 in the second derivative at 100 Hz.
    np.testing.assert_allclose(found, truth, atol=1e-8)


def test_savitzky_golay_is_the_convolution_that_scipy_computes():
    q = np.random.default_rng(1).normal(size=300)
    found = signals.savitzky_golay_differentiated(
        recording(np.arange(300) / 50.0, q), 0.42, degree=3
    )
    weights = savgol_coeffs(21, 3, deriv=2, delta=0.02)
    np.testing.assert_allclose(
        found.acceleration[10:-10, 0], np.convolve(q, weights, "valid"), atol=1e-8
    )


@pytest.mark.parametrize("window, degree", [(3, 2), (11, 3), (51, 4), (299, 5)])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_sliding_polynomials_are_those_of_scipy_up_to_both_ends(
    window, degree, derivative
):
    walk = np.cumsum(np.random.default_rng(1).normal(size=(300, 2)), axis=0)
    found = sliding_polynomials(walk, window, degree, derivative=derivative)
    expected = savgol_filter(walk, window, degree, deriv=derivative, axis=0)
    atol = 1e-5 * abs(expected).max()  # SciPy's powers of 149 samples lose digits
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)
    if derivative == 0:
        np.testing.assert_array_equal(sliding_polynomials(walk, window, degree), found)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_the_smoother_begins_with_a_polynomial_through_four_samples_per_unknown(order):
    t = np.arange(30.0)
    z = np.column_stack([t ** (order - 1) - 2.0 * t, 5.0 + t])
    z[4 * order :] = np.nan
    first = np.zeros((order, 2))
    first[:2] += [[0.0, 5.0], [-2.0, 1.0]]
    first[order - 1, 0] += gamma(order)
    np.testing.assert_allclose(_first_state(z, order), first, atol=1e-7)
    few = _first_state(z[: order + 1], order)
    np.testing.assert_allclose(few, first, atol=1e-7)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6])
def test_the_drive_is_white_noise_of_unit_spectrum_integrated_over_a_step(order):
    """The covariance of ``int (1 - t)^k / k! dw``; the transition, a Taylor series."""
    t, weights = np.polynomial.legendre.leggauss(order)
    t, weights = 0.5 * (t + 1.0), 0.5 * weights  # of 0 to 1
    top = np.arange(order)[::-1]
    tails = t ** top[:, None] / gamma(top + 1.0)[:, None]
    expected = tails * weights @ tails.T
    np.testing.assert_allclose(drive_covariance(order), expected, rtol=1e-12)
    shift = expm(np.eye(order, k=1))
    np.testing.assert_allclose(transition(order), shift, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("order", [3, 4, 5, 6])
@pytest.mark.parametrize("ratio", [1e-1, 1e-4])
def test_the_smoother_solves_the_least_squares_that_defines_it(order, ratio):
    n, N = order, 50
    z = np.cumsum(np.cumsum(np.random.default_rng(0).normal(size=(N, 2)), 0), 0)
    whiten = np.linalg.inv(np.linalg.cholesky(ratio * drive_covariance(order)))
    A = np.zeros((N + (N - 1) * n, N * n))
    A[np.arange(N), np.arange(N) * n] = 1.0
    for k in range(N - 1):
        rows = slice(N + k * n, N + (k + 1) * n)
        A[rows, k * n : (k + 1) * n] = -whiten @ transition(order)
        A[rows, (k + 1) * n : (k + 2) * n] = whiten
    b = np.vstack([z, np.zeros(((N - 1) * n, 2))])
    x = np.linalg.lstsq(A, b, rcond=None)[0].reshape(N, n, 2)
    found = smoothed(z, np.full(2, ratio), order)
    # What is known of the start beforehand weighs 1e-6 of a reading.
    np.testing.assert_allclose(found[:, :3], x[:, :3], atol=1e-6 * abs(z).max())


def test_the_smoothed_motion_does_not_depend_on_the_unit_of_time():
    time, rng = np.arange(400) / 100.0, np.random.default_rng(1)
    readings = series(time)[0] + 0.01 * rng.normal(size=(400, 2))
    fast = signals.kalman_differentiated(
        recording(time, readings), noise_of(("j0", "j1"))
    )
    order, slow = 4, 10.0
    noise = noise_of(("j0", "j1"), order)
    noise = replace(noise, drive=noise.drive / slow ** (2 * order - 1))
    late = signals.kalman_differentiated(recording(slow * time, readings), noise)
    assert abs(fast.position - readings).max() > 1e-3
    np.testing.assert_allclose(late.position, fast.position, atol=1e-9)
    np.testing.assert_allclose(slow * late.velocity, fast.velocity, atol=1e-7)
    np.testing.assert_allclose(slow**2 * late.acceleration, fast.acceleration, 1e-6)


def drawn(order, samples, joints, noise, drive, step=0.01):
    """Return readings of the smoother's own model, integrated step by step."""
    rng = np.random.default_rng(2)
    root = np.sqrt(drive * step ** (2 * order - 1)) * np.linalg.cholesky(
        drive_covariance(order)
    )
    x, z = np.zeros((order, joints)), np.empty((samples, joints))
    for k in range(samples):
        z[k] = x[0] + noise * rng.normal(size=joints)
        x = transition(order) @ x + root @ rng.normal(size=(order, joints))
    return recording(np.arange(samples) * step, z)


def test_the_level_of_the_drive_is_recovered_from_few_readings():
    noise, drive = 1e-3, 4.0
    found = signals.motion_noise(drawn(3, 300, 4, noise, drive), order=3)
    np.testing.assert_allclose(found.position, noise, rtol=0.2)
    # A ratio raised to the power of 1.5 would be wrong by a factor of some thousands.
    assert abs(np.log(np.median(found.drive) / drive)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("order", some_fast([3, 5]))
def test_noise_levels_of_the_model_itself_are_recovered(order):
    noise, drive = 1e-3, 4.0
    found = signals.motion_noise(drawn(order, 1500, 4, noise, drive))
    assert found.order == order
    # 1500 readings tell the noise to 2 %; the drive to its grid, a third.
    np.testing.assert_allclose(found.position, noise, rtol=0.08)
    assert abs(np.log(found.drive / drive)).max() < 1.5
    assert abs(np.log(np.median(found.drive) / drive)) < 0.7


@pytest.mark.slow
def test_the_smoother_believes_in_no_noise_below_the_encoders_step():
    time = np.arange(1000) / 100.0
    step = 1e-3
    q = np.round(series(time)[0] / step) * step
    found = signals.motion_noise(recording(time, q))
    assert (found.position >= step / np.sqrt(12) * 0.999).all()
    assert (found.position < 1.2 * step / np.sqrt(12)).all()


@pytest.mark.slow
def test_smoothed_acceleration_is_near_that_of_the_best_filter_without_being_told():
    time = np.arange(1200) / 100.0
    truth = series(time, period=7.3, joints=1)
    q = np.round(truth[0] / 1e-4) * 1e-4
    log = recording(time, q)

    def error(found):
        inside = slice(50, -50)
        return np.linalg.norm((found.acceleration - truth[2])[inside])

    filtered = [
        error(signals.differentiated(signals.low_passed(log, motion_cutoff=f)))
        for f in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
    ]
    ours = error(signals.kalman_differentiated(log))
    assert ours < 3.0 * min(filtered) and ours < 0.2 * filtered[-1]


@pytest.mark.slow
@REPEATABLE
@given(st.integers(1, 8), st.floats(1.5, 6.0), st.integers(0, 1000))
def test_a_series_is_recovered_with_its_harmonics_on_a_jittered_clock(h, period, seed):
    rng = np.random.default_rng(seed)
    time = np.arange(700) / 50.0 + rng.uniform(-4e-3, 4e-3, 700)
    truth = series(time, period, h, seed=seed)
    exact = signals.fourier_differentiated(recording(time, truth[0]), period, h)
    # Columns are nearly orthogonal; the second derivative multiplies by (w h)^2 < 1200.
    np.testing.assert_allclose(motion(exact), truth, atol=1e-9)
    noisy = truth[0] + 1e-5 * rng.normal(size=truth[0].shape)
    fit = signals.fourier_fit(recording(time, noisy), period)
    found = fit.trajectory
    top = abs(np.hstack([found.sine, found.cosine])[-1]).max()
    # Bayes' criterion adds a harmonic of pure noise once in some hundred fits.
    assert len(found) == h or (len(found) in (h + 1, h + 2) and top < 1e-5)
    np.testing.assert_allclose(fit.residual, 1e-5, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_period_is_estimated_and_two_periods_are_not_mistaken_for_one(seed):
    rng = np.random.default_rng(seed)
    period, time = rng.uniform(2.0, 5.0), np.arange(2500) / 100.0
    q = series(time, period, 4, seed=seed)[0] + 1e-4 * rng.normal(size=(2500, 2))
    found = signals.estimated_period(recording(time, q))
    # Amplitude 1 and noise 1e-4 over 25 s tell the period to some 1e-6 s.
    assert found == pytest.approx(period, abs=1e-5)


def test_motion_that_does_not_repeat_has_no_period():
    time = np.arange(1000) / 100.0
    with pytest.raises(RecordingError, match="does not repeat itself"):
        signals.estimated_period(recording(time, time**2))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r: signals.savitzky_golay_differentiated(r, 0.03), "holds 3 samples"),
        (lambda r: signals.savitzky_golay_differentiated(r, 99.0), "at most the"),
        (lambda r: signals.savitzky_golay_differentiated(r, 0.2, degree=1), "degree"),
        (lambda r: signals.motion_noise(r, order=2), "order is 2"),
        (lambda r: signals.motion_noise(signals.trimmed(r, 0, 0.3)), "48 or more"),
        (lambda r: signals.motion_noise(r.samples(slice(47))), "47 samples.*48 or mo"),
        (lambda r: signals.kalman_differentiated(r, noise_of(("x",))), "noise is that"),
        (lambda r: signals.fourier_fit(r, 5.0), "at least one period"),
        (lambda r: signals.fourier_fit(r, -1.0), "a positive number"),
        (lambda r: signals.fourier_fit(r, 1.0, 46), "between 1 and 45"),
    ],
)
def test_what_cannot_be_had_is_refused(call, message):
    time = np.arange(400) / 100.0
    with pytest.raises(RecordingError, match=message):
        call(recording(time, series(time)[0]))


def test_a_period_is_found_whatever_the_number_of_harmonics():
    time = np.arange(2000) / 100
    terms = [(3, 1.0), (7, 0.5), (14, 0.3)]  # the last beyond the first guess's ten
    q = sum(a * np.sin(2 * np.pi * k * time / 10.0 + k) for k, a in terms)
    # Two periods; a series without the last term would err by 3 ms.
    assert signals.estimated_period(recording(time, q)) == pytest.approx(10.0, abs=1e-6)


def test_a_series_of_another_period_is_refused():
    time = np.arange(2000) / 100
    log = recording(time, np.sin(2 * np.pi * time / 10.0))
    with pytest.raises(RecordingError, match=r"of 3.1 s leaves \d+% of the motion"):
        signals.fourier_differentiated(log, 3.1)
    assert signals.fourier_differentiated(log, 10.0).velocity is not None


def test_a_motion_is_compared_with_itself_as_by_definition():
    from consistent_id.recordings.signals.repetitions import _changes

    q = 5.0 + np.random.default_rng(0).normal(size=(301, 3)).cumsum(axis=0)
    lags = np.arange(1, 299)
    expected = [((q[lag:] - q[:-lag]) ** 2).mean(axis=0) for lag in lags]
    np.testing.assert_allclose(_changes(q, lags), expected, rtol=1e-9)


@pytest.mark.parametrize("order", [3, 4])
def test_noise_levels_are_those_of_the_largest_likelihood(order):
    """Innovations of a plain filter, joint by joint, in units that differ."""
    rng = np.random.default_rng(order)
    time = np.arange(80)[:, None] / 10.0
    z = np.sin(time * [1.0, 2.0, 3.0]) + rng.normal(size=(80, 3)) * [0.3, 0.03, 1e-3]
    z = (z - z[0]) * [1.0, 1e-3, 50.0]
    found = _likeliest(z, order, np.full(3, 1e-12))
    F, M, one = transition(order), drive_covariance(order), np.eye(order)

    def cost(j, near):
        P, x, terms = 1e7 * one, _first_state(z[:, [j]], order)[:, 0], []
        for reading in z[:, j]:
            S, e = P[0, 0] + 1.0, reading - x[0]
            K = P[:, 0] / S
            terms.append((S, e))
            x = F @ (x + K * e)
            P = F @ (P - np.outer(K, P[0])) @ F.T + 10.0 ** (2 * order * near) * M
        S, e = np.array(terms[6:]).T
        variance = np.mean(e**2 / S)
        return len(S) * (np.log(variance) + 1.0) + np.log(S).sum(), variance

    near = np.log10(found.ratio) / (2 * order)
    best = [cost(j, near[j]) for j in range(3)]
    assert found.cost == pytest.approx(sum(c for c, _ in best), rel=1e-4)
    np.testing.assert_allclose(found.variance, [v for _, v in best], rtol=1e-2)
    for j in range(3):
        beside = (near[j] - 0.0625, near[j] + 0.0625)
        others = [cost(j, at)[0] for at in beside if -3.51 < at < 0.76]
        assert min(others) > best[j][0]


def test_of_joints_at_rest_the_noise_is_the_rounding_of_their_angles():
    log = Recording(("a", "b", "c"), np.arange(60) / 10, np.full((60, 3), [40, 0.5, 0]))
    found = signals.motion_noise(log, order=3, least=np.zeros(3))
    eps = np.finfo(float).eps
    np.testing.assert_allclose(found.position, 4 * eps * np.array([40, 0.5, 1e-3]))
