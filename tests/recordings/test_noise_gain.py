"""What preparations make of white noise: frequency responses, drawn noise."""

import numpy as np
import pytest

from consistent_id import Recording, RecordingError, differentiated, low_passed
from consistent_id.recordings.signals.derivatives import noise_gain
from consistent_id.signals import (
    MotionNoise,
    decimated,
    kalman_differentiated,
    savitzky_golay_differentiated,
)

RATE, SAMPLES = 200.0, 2000


def _log(values=0.0):
    position = np.broadcast_to(np.asarray(values, dtype=float), (SAMPLES, 2))
    return Recording(("a", "b"), np.arange(SAMPLES) / RATE, position)


def _filtered(cutoff):
    return lambda log: differentiated(low_passed(log, motion_cutoff=cutoff))


@pytest.mark.parametrize("cutoff", [5.0, 20.0, 70.0])
def test_a_filter_and_differences_are_their_frequency_responses(cutoff):
    # Butterworth, order 4, forwards and backwards, by the bilinear transform; then
    # i sin(w) / h and -(2 - 2 cos w) / h^2.
    w = (np.arange(200_000) + 0.5) / 200_000 * np.pi
    ratio = np.tan(w / 2.0) / np.tan(np.pi * cutoff / RATE)
    H = 1.0 / (1.0 + ratio**8)
    dq, ddq = RATE * np.sin(w), -(RATE**2) * (2.0 - 2.0 * np.cos(w))
    expected = np.array(
        [
            [(H**2).mean(), 0.0, (H**2 * ddq).mean()],
            [0.0, (H**2 * dq**2).mean(), 0.0],
            [(H**2 * ddq).mean(), 0.0, (H**2 * ddq**2).mean()],
        ]
    )
    found = noise_gain(_log(), _filtered(cutoff))
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    for gain in found:
        assert (abs(gain - expected) <= 1e-6 * size).all()


NOISE = MotionNoise(("a", "b"), 3, [1e-4, 1e-4], [1.0, 100.0])
PREPARATIONS = {
    "filter": _filtered(10.0),
    "polynomials": lambda log: savitzky_golay_differentiated(log, 0.15),
    "smoother": lambda log: kalman_differentiated(log, NOISE),
    "decimated": lambda log: decimated(differentiated(log), 4),
}


_QUICK = ("filter", "polynomials", "decimated")


@pytest.mark.parametrize(
    "name",
    [*_QUICK, pytest.param("smoother", marks=pytest.mark.slow)],
)
def test_drawn_noise_comes_out_as_large(name):
    prepare, rng = PREPARATIONS[name], np.random.default_rng(0)
    found = noise_gain(_log(), prepare)
    powers = []
    for _ in range(20):
        out = prepare(_log(rng.normal(size=(SAMPLES, 2))))
        states = np.stack([out.position, out.velocity, out.acceleration])
        inner = states[:, len(out) // 5 : -len(out) // 5]
        powers.append((inner**2).mean(axis=1))
    expected = np.mean(powers, axis=0).T
    # 24 000 samples, correlated over some ten: 2 % of the variance each.
    assert np.allclose(np.diagonal(found, axis1=1, axis2=2), expected, rtol=0.1)


def test_samples_that_are_cut_off_at_an_end_change_nothing():
    def trimmed(log):
        log = differentiated(log)
        still = not log.position.any()
        return log.samples(slice(None, None if still else -5))

    whole = noise_gain(_log(), differentiated)
    assert np.allclose(noise_gain(_log(), trimmed), whole, rtol=1e-9)


def test_a_preparation_without_derivatives_is_refused():
    with pytest.raises(RecordingError, match="no velocity or no acceleration after"):
        noise_gain(_log(), lambda log: log)
