"""Fourier trajectories against finite differences, closed forms and CasADi."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from consistent_id import ProblemError
from consistent_id.recordings.joint_paths import FourierTrajectory, harmonics_of


def random_trajectory(seed: int = 0, joints: int = 3) -> FourierTrajectory:
    rng = np.random.default_rng(seed)
    frequencies = harmonics_of([0.1, 0.14], 4)
    shape = (len(frequencies), joints)
    return FourierTrajectory(
        tuple(f"j{i}" for i in range(joints)),
        frequencies,
        rng.normal(size=joints),
        rng.normal(size=shape),
        rng.normal(size=shape),
        duration=7.0,
        start=1.5,
    )


def test_each_derivative_is_the_difference_quotient_of_the_one_before():
    path = random_trajectory()
    time, h = np.linspace(1.5, 8.5, 23), 1e-4
    before, after = (path.evaluate(time + s, derivatives=4) for s in (-h, h))
    quotient = (after - before)[:-1] / (2.0 * h)
    exact = path.evaluate(time, derivatives=4)[1:]
    assert np.allclose(quotient, exact, rtol=1e-6, atol=1e-5)


def test_casadi_form_equals_numpy_form():
    path = random_trajectory(1)
    function = path.casadi()
    for t in (1.5, 3.3, 8.5):
        numeric = path.evaluate([t], derivatives=3)[:, 0]
        symbolic = [np.asarray(value).ravel() for value in function(t)]
        assert np.allclose(numeric, symbolic, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("order", range(5))
def test_no_derivative_exceeds_its_bound_and_one_sine_reaches_it(order):
    path = random_trajectory(3)
    values = path.evaluate(np.linspace(-50.0, 50.0, 20_001), derivatives=order)[order]
    assert (abs(values).max(axis=0) <= path.derivative_bound(order)).all()
    sine = FourierTrajectory(("a",), [0.5], [0.0], [[3.0]], [[4.0]], 2.0)
    values = sine.evaluate(np.linspace(0.0, 2.0, 20_001), derivatives=order)[order]
    assert np.isclose(abs(values).max(), sine.derivative_bound(order)[0], rtol=1e-6)


def test_one_cosine_is_the_textbook_one():
    path = FourierTrajectory(("a",), [0.25], [0.0], [[0.0]], [[2.0]], 4.0)
    w = np.pi / 2
    assert np.allclose(
        path.evaluate([0.0, 1.0], 3)[:, :, 0],
        [[2.0, 0.0], [0.0, -2 * w], [-2 * w**2, 0.0], [0.0, 2 * w**3]],
        atol=1e-12,
    )


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.01, 5.0))
def test_it_repeats_after_its_period(first, second, base):
    frequencies = np.unique([first, second]) * base
    ones = np.ones((len(frequencies), 1))
    path = FourierTrajectory(("a",), frequencies, [0.0], ones, ones, 1.0)
    period = path.period
    assert period is not None
    times = np.linspace(0.0, 1.0, 7) / base
    assert np.allclose(path.evaluate(times), path.evaluate(times + period), atol=1e-6)
    assert np.isclose(period * base * np.gcd(first, second), 1.0)


def test_frequencies_without_a_common_base_have_no_period():
    ones = np.ones((2, 1))
    path = FourierTrajectory(("a",), [1.0, np.sqrt(2.0)], [0.0], ones, ones, 1.0)
    assert path.period is None


def test_a_recording_has_both_ends_and_exact_derivatives():
    path = random_trajectory(2)
    log = path.recording(rate=99.9)
    assert np.isclose(log.time[0], 1.5) and np.isclose(log.time[-1], 8.5)
    assert log.rate <= 99.9
    q, dq, ddq = path.evaluate(log.time)
    for seen, exact in zip(
        (log.position, log.velocity, log.acceleration), (q, dq, ddq), strict=True
    ):
        assert np.array_equal(seen, exact)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"frequencies": [0.2, 0.1]}, "increasing"),
        ({"frequencies": [0.0, 0.1]}, "positive"),
        ({"duration": 0.0}, "more than 0"),
        ({"joints": ("a", "a")}, "distinct names"),
        ({"sine": [[1.0]]}, "sine"),
        ({"cosine": [[np.nan], [0.0]]}, "cosine"),
        ({"start": np.inf}, "start"),
    ],
)
def test_what_is_no_trajectory_is_refused(change, says):
    values = {
        "joints": ("a",),
        "frequencies": [0.1, 0.2],
        "offset": [0.0],
        "sine": [[1.0], [0.0]],
        "cosine": [[1.0], [0.0]],
        "duration": 3.0,
    } | change
    with pytest.raises(ProblemError, match=says):
        FourierTrajectory(**values)
