"""Trajectories are recovered from their samples, or told to be out of reach."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id import Recording, RecordingError
from consistent_id.recordings import FourierTrajectory
from consistent_id.recordings.joint_paths import harmonics_of
from consistent_id.recordings.signals import fit_trajectory, fourier_fit

REPEATABLE = settings(derandomize=True, deadline=None, max_examples=25)


def random_trajectory(frequencies, seed, joints=3):
    rng = np.random.default_rng(seed)
    shape = (len(frequencies), joints)
    return FourierTrajectory(
        tuple(f"j{k}" for k in range(joints)),
        frequencies,
        rng.normal(size=joints),
        rng.normal(size=shape),
        rng.normal(size=shape),
        duration=20.0,
        start=rng.uniform(-5.0, 5.0),
    )


@pytest.mark.slow
@REPEATABLE
@given(st.integers(1, 4), st.sampled_from([0.05, 0.1, 0.13]), st.integers(0, 1000))
def test_coefficients_of_several_bases_are_recovered_on_a_jittered_clock(
    harmonics, second, seed
):
    path = random_trajectory(harmonics_of([0.1, second], harmonics), seed)
    jitter = np.random.default_rng(seed).uniform(-2e-3, 2e-3, 1999)
    time = path.start + np.append(0.0, np.arange(1, 2000) / 100.0 + jitter)
    log = Recording(path.joints, time, path.evaluate(time)[0])
    fit = fit_trajectory(log, path.frequencies)
    for name in ("offset", "sine", "cosine"):
        found, truth = getattr(fit.trajectory, name), getattr(path, name)
        np.testing.assert_allclose(found, truth, rtol=0.0, atol=1e-12)
    assert fit.trajectory.start == path.start and len(fit.criterion) == 1
    assert fit.residual.max() < 1e-13


def test_a_fit_by_period_is_one_by_its_harmonics():
    path = random_trajectory(np.arange(1, 4) / 4.0, 1)
    log = path.recording(100.0)
    by_period = fourier_fit(log, 4.0, 3)
    by_frequency = fit_trajectory(log, path.frequencies)
    assert by_period.period == pytest.approx(4.0, rel=1e-15)
    for name in ("frequencies", "offset", "sine", "cosine"):
        assert np.array_equal(
            getattr(by_period.trajectory, name), getattr(by_frequency.trajectory, name)
        )
    assert by_frequency.criterion[0] == by_period.criterion[-1]


@pytest.mark.slow
def test_frequencies_are_refused_where_noise_would_be_ten_times_as_large():
    time, wave = np.arange(2000) / 100.0, np.zeros((2000, 1))
    rng = np.random.default_rng(0)
    close = np.array([1.0, 1.0 + 0.07 / 20.0])  # of 1 / 20 s, which is told with ease
    found = [
        fit_trajectory(Recording(("a",), time, noise), close).trajectory.sine[0, 0]
        for noise in rng.normal(size=(200, *wave.shape))
    ]
    # Far apart: sqrt(2 / samples).  A standard deviation of 200 is known to 5 %.
    assert 6.0 < np.std(found) / np.sqrt(2.0 / 2000.0) < 10.0
    with pytest.raises(RecordingError, match=r"1 Hz and 1.0025 Hz.*about 400 s"):
        fit_trajectory(Recording(("a",), time, wave), [1.0, 1.0025])


@pytest.mark.parametrize(
    ("frequencies", "says"),
    [
        (
            [0.005, 1.0],
            "0.005 Hz and 0 Hz are 0.005 Hz apart, too near to resolve in 4 s",
        ),
        ([0.1, 0.2, 0.3, 0.4], "too near to resolve in 4 s"),
        ([], "positive and increasing"),
        ([0.5, 0.5], "positive and increasing"),
        ([-1.0], "positive and increasing"),
        ([1.0, 46.0], "at most 45 Hz"),
        (np.arange(1, 111) / 4.0, "expected at least 442"),
    ],
)
def test_what_a_recording_cannot_resolve_is_refused(frequencies, says):
    time = np.arange(400) / 100.0
    with pytest.raises(RecordingError, match=says):
        fit_trajectory(Recording(("a",), time, np.sin(time)[:, None]), frequencies)
