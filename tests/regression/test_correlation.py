"""Effective samples: AR(1) in closed form, and what a fit takes from residuals."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from scipy import signal

from consistent_id import (
    DriveTerms,
    Recording,
    TorqueModel,
    build_regression,
    least_squares,
    simulate_torque,
)
from consistent_id.regression import correlated_noise
from consistent_id.regression import correlation_lengths as lengths_module
from consistent_id.regression.correlated_noise import (
    CorrelatedNoise,
    joined_noise,
    spectral_errors,
    spectral_noise,
)
from consistent_id.regression.correlation_lengths import (
    correlation_length,
    correlation_lengths,
)
from consistent_id.regression.model_errors import (
    joint_fit,
    lacking_ratio,
    lacking_terms,
)
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.row_structure import joint_rows
from consistent_id.regression.segments import merged, segment_regressions
from consistent_id.signals import decimated


def ar1(rng, a, samples, joints=1):
    """Noise of unit variance with ``rho_k = a^k``."""
    white = rng.normal(size=(samples + 1000, joints))
    return signal.lfilter([np.sqrt(1 - a**2)], [1.0, -a], white, axis=0)[1000:]


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_of_ar1_it_is_one_plus_a_over_one_less_a(a):
    rng = np.random.default_rng(0)
    residuals = np.column_stack([ar1(rng, a, 4000)[:, 0] for _ in range(30)])
    found = correlation_lengths([residuals])
    # The sum's relative error is about sqrt(4 reach / samples), 15 % at a = 0.9; 30
    # columns make it 3 %, and its end at the first negative lag is good to as much.
    assert found.mean() == pytest.approx((1 + a) / (1 - a), rel=0.12)


def test_recordings_add_and_do_not_lie_against_each_other():
    rng = np.random.default_rng(1)
    long = ar1(rng, 0.8, 6000, 10)
    whole = correlation_lengths([long]).mean()
    parts = correlation_lengths(np.array_split(long, 10)).mean()
    assert parts == pytest.approx(whole, rel=0.1)


@pytest.mark.slow
def test_what_a_fit_took_is_given_back():
    # Slow sines fitted to slow noise, up to 1.5 Hz at 100 Hz: two thirds of what is so
    # slow are gone from the residual.  The scores' variance is still that of the noise
    # itself, which has a closed form.
    rng = np.random.default_rng(2)
    n, p = 2000, 20
    slow = np.pi * np.outer(np.arange(n) + 0.5, 3 * np.arange(p)) / n
    basis = np.linalg.qr(np.cos(slow))[0]
    rho = 0.9 ** np.arange(n)
    lags = abs(np.subtract.outer(np.arange(n), np.arange(n)))
    exact = np.trace(basis.T @ rho[lags] @ basis)
    stated, naive = [], []
    for _ in range(40):
        noise = ar1(rng, 0.9, n)[:, 0]
        rest = noise - basis @ (basis.T @ noise)
        stated.append(np.sum(spectral_noise(basis, rest, np.eye(p)).scores ** 2))
        naive.append(np.sum(spectral_noise(basis, rest, np.zeros((p, 1))).scores ** 2))
    assert np.mean(stated) == pytest.approx(exact, rel=0.15)
    assert np.mean(naive) < 0.85 * np.mean(stated)


def test_of_white_noise_the_scores_have_the_covariance_of_white_noise():
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(20000, 3)) @ rng.normal(size=(3, 3))
    steps = np.linalg.inv(np.linalg.qr(rows)[1])
    residual = 2.0 * rng.normal(size=20000)
    found = spectral_noise(rows, residual, steps)
    expected = 4.0 * rows.T @ rows
    scale = np.sqrt(np.outer(*[np.diag(expected)] * 2))
    assert abs(found.scores.T @ found.scores - expected).max() < 0.03 * scale.max()
    assert found.length == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_noise_slower_than_the_motion_does_little_harm():
    # A sine at 5 Hz beside AR(1) noise at 100 Hz: P(f) of the closed form, not P(0).
    rng = np.random.default_rng(6)
    n, a, f = 20000, 0.9, 0.05
    row = np.sqrt(2 / n) * np.sin(2 * np.pi * f * np.arange(n))[:, None]
    lengths = [
        spectral_noise(row, ar1(rng, a, n)[:, 0], np.eye(1)).length for _ in range(60)
    ]
    expected = (1 - a**2) / abs(1 - a * np.exp(-2j * np.pi * f)) ** 2
    assert expected < 2.0 < (1 + a) / (1 - a)
    # 14 frequencies scatter by 27 %, the mean of 60 by 4 %.
    assert np.mean(lengths) == pytest.approx(expected, rel=0.12)


def slow_log(seed, samples):
    """A recording of slow sines, whose torque has no noise."""
    model, truth, log = experiment(seed, joints=2, samples=10)
    time = np.arange(samples) / 100
    rates = np.array([[0.7, 1.1], [1.3, 1.9]])
    q, dq, ddq = (
        sum(w**k * np.sin(np.outer(time, w) + k * np.pi / 2) for w in rates)
        for k in range(3)
    )
    motion = Recording(log.joints, time, q, dq, ddq)
    return model, simulate_torque(model, truth, motion)


@pytest.mark.slow
def test_a_regression_counts_effective_samples_of_each_joint():
    model, clean = slow_log(0, 6000)
    rng = np.random.default_rng(3)
    size = 0.05 * clean.torque.std(axis=0)
    lengths = []
    for _ in range(10):
        noise = np.column_stack([ar1(rng, a, 6000)[:, 0] for a in (0.0, 0.9)])
        log = replace(clean, torque=clean.torque + size * noise)
        regression = build_regression(model, log)
        lengths.append(regression.correlation)
        assert regression.effective @ lengths[-1] == pytest.approx(12000.0)
    white, slow = np.mean(lengths, axis=0)
    assert white == pytest.approx(1.0, abs=0.15)
    # 19 samples at rest; friction's jumps are faster than the noise.
    assert 10.0 < slow < 19.0
    # Cut into segments and put together again, it is the same noise.
    again = merged(segment_regressions(model, log, count=8))
    assert again.effective == pytest.approx(regression.effective, rel=1e-6)


@pytest.mark.slow
def test_decimated_rows_have_as_much_less_correlation():
    model, log = slow_log(0, 8000)
    rng = np.random.default_rng(4)
    size = 0.05 * log.torque.std(axis=0)
    log = replace(log, torque=log.torque + size * ar1(rng, 0.95, 8000, 2))
    plain, coarse = (build_regression(model, decimated(log, k)) for k in (1, 10))
    errors = [least_squares(model, r).standard_errors for r in (plain, coarse)]
    # What is left to know is the same, though rows are a tenth: 39 samples are four.
    assert coarse.correlation == pytest.approx(plain.correlation / 10, rel=0.5)
    assert np.median(errors[1] / errors[0]) == pytest.approx(1.0, abs=0.2)


def test_rounding_is_not_taken_for_correlated_noise():
    model, _, log = experiment(1, joints=3, samples=500)
    assert build_regression(model, log).correlation == pytest.approx(1.0)


def test_the_sum_of_what_is_known_and_what_is_not_is_not_known():
    model, _, log = experiment(1, joints=2, noise=1.0, samples=300)
    regression = build_regression(model, log)
    assert (regression + replace(regression, noise=None)).noise is None
    doubled = regression + regression
    assert doubled.effective == pytest.approx(2 * regression.effective)


@pytest.mark.parametrize("samples", [64, 65])
def test_of_an_impulse_all_frequencies_have_the_same_power_to_the_last(samples):
    # Its spectrum is flat, which no smoothing changes: scores have the rows' products
    # over the samples, by Parseval, also at the highest frequency.  Rows have nothing
    # at the lowest frequencies, where the shape of a spectrum is uncertain.
    spectra = np.fft.rfft(np.random.default_rng(3).normal(size=(samples, 3)), axis=0)
    spectra[:27] = 0.0
    rows = np.fft.irfft(spectra, samples, axis=0)
    impulse = np.zeros(samples)
    impulse[7] = 2.0
    found = spectral_noise(rows, impulse, np.zeros((3, 1)))
    np.testing.assert_allclose(
        found.scores.T @ found.scores, 4.0 * rows.T @ rows / samples, atol=1e-12
    )
    assert found.length == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("a", [0.0, 0.9])
def test_the_degrees_of_freedom_are_those_by_which_the_variance_scatters(a):
    rng = np.random.default_rng(4)
    n, columns = 1000, 7
    time = np.arange(n) / 100
    # Slow columns, as a robot's motion: few frequencies have all the leverage.
    rows = np.column_stack([np.cos(k * time) for k in range(columns)])
    basis = np.linalg.qr(rows)[0]
    variances, freedoms = [], []
    for _ in range(400):
        noise = ar1(rng, a, n)[:, 0]
        residual = noise - basis @ (basis.T @ noise)
        found = spectral_noise(basis, residual, np.eye(columns))
        variances.append(np.sum(found.scores**2))
        freedoms.append(found.freedom)
    expected = 2.0 * np.mean(variances) ** 2 / np.var(variances)
    # 400 variances know their own variance to 7 % and more; noise is only nearly white
    # within the band of a running mean.
    assert np.mean(freedoms) == pytest.approx(expected, rel=0.25)
    assert 3.0 < expected < 40.0


def test_what_few_samples_leave_has_few_degrees_of_freedom():
    """Three samples less two parameters: one; at few frequencies, less than two."""
    rng = np.random.default_rng(0)
    for n, low, high in ((3, 1.0, 1.0), (100, 1.5, 1.95)):
        basis = np.linalg.qr(np.cos(np.outer(np.arange(n) + 0.5, [0.0, np.pi / n])))[0]
        noise = np.cumsum(rng.normal(size=n))
        residual = noise - basis @ (basis.T @ noise)
        assert low <= spectral_noise(basis, residual, np.eye(2)).freedom <= high


def test_errors_of_a_column_are_in_its_own_unit():
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.normal(size=(800, 3)), ar1(rng, 0.5, 800)])
    units = np.array([1e-14, 1.0, 1e5])
    scaled = rows * np.append(units, 1.0)
    np.testing.assert_allclose(
        spectral_errors([scaled]) * units, spectral_errors([rows]), rtol=1e-9
    )


@pytest.mark.parametrize(("first", "beyond"), [(4.0, 2.2), (0.1, 1.0)])
def test_noise_of_recordings_adds_and_errors_beyond_it_are_the_mean(first, beyond):
    rng = np.random.default_rng(0)
    parts = [
        CorrelatedNoise(
            np.array(effective),
            tuple(rng.normal(size=(rows, 3)) for rows in (5, 2)),
            np.array(freedom),
            ratio,
        )
        for effective, freedom, ratio in (
            ([10.0, 20.0], [3.0, 5.0], first),
            ([15.0, 30.0], [2.0, 8.0], 1.0),
        )
    ]
    scores = [part.scores for part in parts]
    squares = [sum(N.T @ N for N in own) for own in zip(*scores, strict=True)]
    joined = joined_noise(parts)
    assert joined.effective.tolist() == [25.0, 50.0]
    assert joined.freedom.tolist() == [5.0, 13.0]
    for N, expected in zip(joined.scores, squares, strict=True):
        np.testing.assert_allclose(N.T @ N, expected)
    # The first has 30 of 75 effective samples; less than noise alone is chance.
    assert joined.beyond == pytest.approx(beyond)
    part = joined.share(0.25)
    assert part.effective.tolist() == [6.25, 12.5] and part.beyond == joined.beyond
    for N, whole in zip(part.scores, squares, strict=True):
        np.testing.assert_allclose(N.T @ N, 0.25 * whole)


@pytest.mark.parametrize(("total", "first"), [(100, 30), (101, 30), (40, 0)])
def test_of_a_long_recording_the_middle_shows_the_noise_of_all(
    monkeypatch, total, first
):
    monkeypatch.setattr(correlated_noise, "SHOWN", 40)
    model, _, log = experiment(2, joints=2, noise=0.5, samples=total)
    regression = build_regression(model, log, noise=False)
    motion = motion_of(model, log, None)
    middle = motion.samples(first, first + 40)
    whole, shown = (
        correlated_noise.recorded_noise(
            model, regression.factors, regression.counts, [rows], [total]
        )
        for rows in (motion, middle)
    )
    np.testing.assert_array_equal(whole.effective, shown.effective)
    np.testing.assert_array_equal(whole.freedom, shown.freedom)
    # The same for scores along instruments, or any other rows.
    columns = np.array([1, 2, 3])
    steps = [np.eye(3)] * 2
    residual = log.torque
    found, expected = (
        correlated_noise.scores_along(model, [rows], [left], columns, steps)
        for rows, left in ((motion, residual), (middle, residual[first : first + 40]))
    )
    for one, other in zip(found, expected, strict=True):
        squares = total / 40 * other.T @ other
        np.testing.assert_allclose(one.T @ one, squares, atol=1e-9 * abs(squares).max())


def reflected(values, width):
    """Means over `width` values, by mirrored places."""
    n, before = len(values), (width - 1) // 2
    places = [range(k - before, k - before + width) for k in range(n)]
    mirror = [[min(abs(i + 0.5), 2 * n - abs(i + 0.5)) for i in own] for own in places]
    return np.array([np.mean([values[int(i)] for i in own]) for own in mirror])


@pytest.mark.parametrize("n", [40, 41])
def test_noise_that_a_fit_left_is_that_of_dense_matrices_over_time(n):
    """Spectra of shapes are found by frequency, all that follows by circulants."""
    rng = np.random.default_rng(n)
    rows = ar1(rng, 0.8, n, 3) * [1e-3, 1.0, 50.0]
    steps = np.linalg.inv(np.linalg.qr(rows)[1])[:, :2]
    A = rows @ steps
    noise = 0.3 * ar1(rng, 0.7, n)[:, 0]
    residual = noise - A @ (A.T @ noise)
    found = spectral_noise(rows, residual, steps)

    squares = abs(np.fft.rfft(residual)) ** 2 / n
    leverage = np.sum(abs(np.fft.rfft(A, axis=0)) ** 2, axis=1) / n
    width, last = 2, 16  # half the cube root of 40, and one; eight bands
    places = np.maximum(np.arange(len(squares)), 0.5)
    powers, scores, inverses = [], [], []
    for a in (0.0, 0.5, 1.0):
        shape = np.minimum(places, last - 1) ** -a
        left = np.maximum(
            reflected(shape * (1 - leverage), width),
            correlated_noise.LEFT * reflected(shape, width),
        )
        inverses.append(shape / left)
        powers.append(reflected(squares, width) * shape / left)
        spare = (1 - leverage)[1:last]
        own = shape[1:last] * np.maximum(spare, correlated_noise.LEFT)
        level = np.average(squares[1:last] / own, weights=spare)
        scores.append(-spare @ np.log(level * own))
    chances = np.exp(np.array(scores) - max(scores))
    chances /= chances.sum()
    power = chances @ powers

    def circulant(values):
        kernel = np.fft.irfft(values, n)
        return kernel[np.subtract.outer(np.arange(n), np.arange(n)) % n]

    expected = rows.T @ circulant(power) @ rows
    size = np.sqrt(np.outer(*[np.diag(expected)] * 2))
    squared = found.scores.T @ found.scores
    np.testing.assert_allclose(squared / size, expected / size, atol=1e-12)
    white = np.trace(circulant(power)) / n * np.trace(A.T @ A)
    felt = np.trace(A.T @ circulant(power) @ A)
    assert found.length == pytest.approx(felt / white)
    # The variance is a sum of |r|^2 with weights: those of means over bands.
    two = np.full(len(power), 2.0)
    two[0], two[-1] = 1.0, 2.0 - (n % 2 == 0)
    means = np.array([reflected(unit, width) for unit in np.eye(len(power))])
    weights = means @ (two * leverage * (chances @ inverses)) / two
    M = circulant(weights * power) @ (np.eye(n) - A @ A.T)
    by_shape = [np.sum(two * leverage * P) / felt for P in powers]
    uncertain = 2 * np.trace(M @ M) / np.trace(M) ** 2
    uncertain += chances @ (np.array(by_shape) - 1) ** 2
    assert found.freedom == pytest.approx(2 / uncertain)


def test_of_residuals_in_a_row_each_window_counts_on_its_own(monkeypatch):
    monkeypatch.setattr(lengths_module, "_AUTOCOVARIANCE_WINDOW", 8)
    rng = np.random.default_rng(9)
    logs = [1e-3 * ar1(rng, 0.8, n, 2) for n in (20, 13)]
    sums = np.zeros((8, 2))
    for residual in logs:
        for first in range(0, len(residual), 8):
            piece = residual[first : first + 8]
            for lag in range(len(piece)):
                sums[lag] += np.sum(piece[lag:] * piece[: len(piece) - lag], axis=0)
    rho = sums / sums[0]
    stops = [next((k for k in range(8) if own[k] < 0), 8) for own in rho.T]
    expected = [1 + 2 * own[1:k].sum() for own, k in zip(rho.T, stops, strict=True)]
    found = correlation_lengths(logs)
    np.testing.assert_allclose(found, np.maximum(expected, 1.0))
    assert found.max() > 1.5
    # Of joints together, the mean by what they add to the misfit.
    sigma = np.array([2e-3, 5e-4])
    joined = correlation_length([logs[0][:, 0], logs[0][:, 1]], sigma)
    weights = np.sum(logs[0] ** 2, axis=0) / sigma**2
    alone = correlation_lengths(logs[:1])
    assert joined == pytest.approx(np.average(alone, weights=weights))


def test_four_equal_residuals_go_on_and_zeros_have_no_correlation():
    # Of a square sum of one: 1 + 2 (3 + 2 + 1) / 4.
    assert correlation_lengths([np.full((4, 1), 0.5)]).tolist() == [4.0]
    assert correlation_lengths([np.zeros((4, 1))]).tolist() == [1.0]
    assert correlation_length([np.zeros(4)], np.ones(1)) == 1.0


def test_what_a_prior_says_is_in_the_errors_of_least_squares():
    """White residuals of variance v: ``H^-1 (v Y^T Y + P^T P) H^-1``."""
    rng = np.random.default_rng(10)
    parts = [rng.normal(size=(n, 2)) * [1.0, 1e-3] for n in (4000, 6000)]
    x, prior = np.array([2.0, 300.0]), np.array([[0.0, 0.05, 10.0], [30.0, 0.0, 75.0]])
    rows = [np.column_stack([Y, Y @ x + 3 * rng.normal(size=len(Y))]) for Y in parts]
    gram = sum(Y.T @ Y for Y in parts)
    P = prior[:, :2]
    inverse = np.linalg.inv(gram + P.T @ P)
    expected = np.sqrt(np.diag(inverse @ (9 * gram + P.T @ P) @ inverse))
    # Spectra of 10,000 samples scatter by a few per cent.
    np.testing.assert_allclose(spectral_errors(rows, prior), expected, rtol=0.05)


def test_terms_that_both_joints_lack_count_beside_noise_of_their_own_rows(monkeypatch):
    """The first joint has noise like samples, the second more; both lack friction."""
    whole, _, log = experiment(4, joints=2, samples=600)
    rng = np.random.default_rng(0)
    noise = np.column_stack([ar1(rng, a, 600)[:, 0] for a in (0.0, 0.8)])
    log = replace(log, torque=log.torque + 0.02 * log.torque.std(axis=0) * noise)
    model = TorqueModel(whole.robot, DriveTerms(viscous=True))
    plain = build_regression(model, log, noise=False)
    motion = motion_of(model, log, None)
    given = model, plain.factors, plain.counts, [motion]
    found = correlated_noise.recorded_noise(*given)
    fit = joint_fit(plain.factors, plain.counts)
    level = fit.noise * np.sqrt(np.maximum(np.array(plain.counts) / found.effective, 1))
    lacking = lacking_terms(model, [motion])
    sizes = [len(each.terms.names) for each in lacking]
    assert sorted({each.row for each in lacking}) == [0, 1]
    parts = []
    for j, (rows, expand) in enumerate(joint_rows(model, motion)):
        columns = [motion.drive_columns(*each) * (each.row == j) for each in lacking]
        beside = np.column_stack([rows[:, :-1] @ expand @ fit.steps, *columns])
        parts.append(np.column_stack([beside, rows[:, -1]]) / level[j])
    assert sum(sizes) == parts[0].shape[1] - fit.steps.shape[1] - 1
    expected = lacking_ratio(fit, np.vstack(parts))
    monkeypatch.setattr(correlated_noise, "lacking_terms", lambda *_: ())
    assert expected > 1.5 * correlated_noise.recorded_noise(*given).beyond
    assert found.beyond == pytest.approx(expected)


def test_zeros_are_not_longer_than_white_noise():
    rows = np.random.default_rng(0).normal(size=(50, 2))
    found = spectral_noise(rows, np.zeros(50), np.eye(2) / 7.0)
    assert (found.length, found.freedom) == (1.0, 50.0)


@pytest.mark.parametrize(("apart", "kept"), [(1.5, False), (2.5, True)])
def test_columns_as_near_as_rounding_are_one(apart, kept):
    """Two columns of unit length: their smallest over their largest singular value."""
    c, d = np.eye(100)[:2] - 0.01
    size = apart * correlated_noise.DATA_RANK_TOLERANCE
    rows = np.column_stack([c, c + size * d, np.random.default_rng(0).normal(size=100)])
    errors = spectral_errors([rows])
    assert (errors.max() > 1e6) == kept


@pytest.mark.parametrize("width", [1, 4, 5, 99])
def test_weights_of_running_means_are_spread_over_what_these_are_made_of(width):
    weights, spectrum = np.random.default_rng(width).normal(size=(2, 9))
    means = correlated_noise._smoothed(spectrum, width)
    whole = correlated_noise._spread(weights, width)
    assert whole @ spectrum == pytest.approx(weights @ means)
    assert correlated_noise._smoothed(np.full(9, 3.0), width) == pytest.approx(3.0)
