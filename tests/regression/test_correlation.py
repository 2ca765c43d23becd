"""Effective samples: AR(1) in closed form, and what a fit takes from residuals."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from scipy import signal

from consistent_id import build_regression
from consistent_id.regression.correlation import correlation_lengths
from consistent_id.regression.segments import merged, segment_regressions


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


def test_what_a_fit_took_is_given_back():
    # Slow sines fitted to slow noise: the residual looks whiter than the noise is.
    rng = np.random.default_rng(2)
    n, p = 2000, 20
    noise = ar1(rng, 0.9, n, 40)
    slow = np.pi * np.outer(np.arange(n) + 0.5, np.arange(p)) / n
    basis = np.linalg.qr(np.cos(slow))[0]
    rest = noise - basis @ (basis.T @ noise)
    naive = correlation_lengths([rest]).mean()
    corrected = correlation_lengths([rest], spent=p).mean()
    # A fifth of all effective samples is spent, and all of it on what is slowest: most
    # of what was lost comes back.
    assert naive < 0.65 * 19.0
    assert 0.75 * 19.0 < corrected < 19.0


def test_a_regression_counts_effective_samples_of_each_joint():
    model, _, log = experiment(0, joints=2, samples=3000)
    rng = np.random.default_rng(3)
    size = 0.05 * log.torque.std(axis=0)
    noise = np.column_stack([ar1(rng, a, 3000)[:, 0] for a in (0.0, 0.9)])
    log = replace(log, torque=log.torque + size * noise)
    regression = build_regression(model, log)
    assert regression.correlation == pytest.approx([1.0, 19.0], rel=0.35)
    assert regression.effective @ regression.correlation == pytest.approx(6000.0)
    # Cut into segments and put together again, it is the same noise.
    again = merged(segment_regressions(model, log, count=8))
    assert again.effective == pytest.approx(regression.effective, rel=1e-6)


def test_decimated_rows_have_as_much_less_correlation():
    model, _, log = experiment(0, joints=2, samples=4000)
    rng = np.random.default_rng(4)
    size = 0.05 * log.torque.std(axis=0)
    log = replace(log, torque=log.torque + size * ar1(rng, 0.95, 4000, 2))
    plain, coarse = (build_regression(model, log, decimate=k) for k in (1, 10))
    # 39 samples are about four rows of ten: what is left to know is the same.
    assert coarse.correlation == pytest.approx(plain.correlation / 10, rel=0.4)
    assert coarse.effective == pytest.approx(plain.effective, rel=0.4)


def test_rounding_is_not_taken_for_correlated_noise():
    model, _, log = experiment(1, joints=3, samples=500)
    assert build_regression(model, log).correlation == pytest.approx(1.0)


def test_the_sum_of_what_is_known_and_what_is_not_is_not_known():
    model, _, log = experiment(1, joints=2, noise=1.0, samples=300)
    regression = build_regression(model, log)
    assert (regression + replace(regression, effective=None)).effective is None
    doubled = regression + regression
    assert doubled.effective == pytest.approx(2 * regression.effective)
