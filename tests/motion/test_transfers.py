"""Transfers against closed forms, finite differences and dense sampling."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id import MotionLimits, ProblemError
from consistent_id.motion import MotionState, PolynomialPath
from consistent_id.motion.moves import approach, departure
from consistent_id.motion.transfers import transfer

REPEATABLE = settings(derandomize=True, deadline=None, max_examples=30)
NONE = np.inf


def limits(joints=1, low=-3.0, high=3.0, velocity=2.0, acceleration=8.0, jerk=100.0):
    every = [np.full(joints, x) for x in (low, high, velocity, acceleration, jerk)]
    names = tuple(f"j{k}" for k in range(joints))
    return MotionLimits(names, *every, effort=np.full(joints, NONE))


def at_rest(*position):
    names = tuple(f"j{k}" for k in range(len(position)))
    return MotionState.at_rest(names, position)


def random_states(seed, joints=3):
    """States that leave room: positions within 1, velocities within 0.4, ..."""
    rng = np.random.default_rng(seed)
    scale = np.array([1.0, 0.4, 2.0, 20.0])[:, None]
    names = tuple(f"j{k}" for k in range(joints))
    return [
        MotionState(names, scale * rng.uniform(-1, 1, (4, joints))) for _ in range(2)
    ]


def ends(path, derivatives=3):
    return path.evaluate([path.start, path.start + path.duration], derivatives)


def test_each_derivative_is_the_difference_quotient_of_the_one_before():
    control = np.random.default_rng(0).normal(size=(8, 3))
    path = PolynomialPath(("a", "b", "c"), control, duration=1.7, start=0.4)
    time, h = np.linspace(0.5, 2.0, 23), 1e-5
    before, after = (path.evaluate(time + s, derivatives=4) for s in (-h, h))
    exact = path.evaluate(time, derivatives=4)[1:]
    scale = abs(exact).max(axis=(1, 2), keepdims=True)
    quotient = (after - before)[:-1] / (2.0 * h)
    # Truncation h^2/6 times two derivatives more, of at most (7 / 1.7)^2 each.
    assert np.allclose(quotient / scale, exact / scale, rtol=0.0, atol=1e-7)


@pytest.mark.slow
@REPEATABLE
@given(st.integers(0, 1000), st.integers(1, 7))
def test_bounds_are_never_exceeded_and_near(seed, degree):
    control = np.random.default_rng(seed).normal(size=(degree + 1, 4))
    path = PolynomialPath(("a", "b", "c", "d"), control, duration=0.8, start=-1.0)
    values = path.evaluate(np.linspace(-1.0, -0.2, 3001), derivatives=degree + 1)
    for order in range(degree + 2):
        bound, most = path.derivative_bound(order), abs(values[order]).max(axis=0)
        assert (most <= bound * (1 + 1e-12) + 1e-12).all()
        assert (bound <= 1.01 * most + 1e-12).all()


@pytest.mark.parametrize(
    ("change", "seconds"),
    [
        # Of 10 u^3 - 15 u^4 + 6 u^5: 15/8, 10/sqrt(3) and 60.
        ({"velocity": 2.0, "acceleration": NONE, "jerk": NONE}, 15 / 8),
        ({"velocity": NONE, "acceleration": 5.0}, np.sqrt(20 / np.sqrt(3) / 5)),
        ({"velocity": NONE, "acceleration": NONE, "jerk": 15.0}, 2.0),
    ],
)
def test_from_rest_to_rest_the_duration_is_the_textbook_one(change, seconds):
    own = limits(**({"jerk": NONE} | change))
    path = transfer(at_rest(-1.0), at_rest(1.0), own)
    assert path.duration == pytest.approx(seconds, rel=1e-3)
    assert path.duration >= seconds


@pytest.mark.slow
@REPEATABLE
@given(st.integers(0, 1000))
def test_a_transfer_meets_both_states_within_the_limits(seed):
    begin, end = random_states(seed)
    # One polynomial for all joints is possible where there is room.
    own = limits(3, low=-30.0, high=30.0, velocity=6.0, acceleration=40.0, jerk=600.0)
    path = transfer(begin, end, own)
    for seen, state in zip(ends(path).swapaxes(0, 1), (begin, end), strict=True):
        np.testing.assert_allclose(seen[:3], state.values[:3], atol=1e-9)
    inside(path, own)
    assert len(path.control) == 6


def inside(path, own):
    time = np.linspace(path.start, path.start + path.duration, 2001)
    for k, values in enumerate(path.evaluate(time, derivatives=3)):
        middle = own.middle if k == 0 else 0.0
        assert (abs(values - middle) <= own.derivative(k)).all()


def test_no_shorter_duration_is_within_the_limits():
    own = limits(2)
    path = transfer(at_rest(0.0, -1.0), at_rest(0.2, 1.4), own)
    shorter = replace(path, duration=0.998 * path.duration)
    over = [shorter.derivative_bound(k) / own.derivative(k) for k in (1, 2, 3)]
    assert np.max(over) > 1.0


@pytest.mark.slow
@REPEATABLE
@given(st.integers(0, 1000))
def test_an_approach_comes_from_rest_and_a_departure_is_its_mirror(seed):
    state, own = random_states(seed)[0], limits(3)
    came = approach(state, own)
    went = departure(state, own)
    for path, at_state, still in ((came, 1, 0), (went, 0, 1)):
        inside(path, own)
        seen = ends(path)[:3]
        np.testing.assert_allclose(
            seen[:, at_state], state.values[:3], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(seen[1:, still], 0.0, atol=1e-9)


@pytest.mark.slow
def test_an_approach_begins_as_near_to_a_pose_as_limits_allow():
    state = MotionState(("j0", "j1"), [[0.5, 0.5], [0.2, 1.9], [0.0, 0.0], [0.0, 0.0]])
    middle, near = (approach(state, limits(2), near=x) for x in (None, [0.4, 3.0]))
    # The fast joint alone decides how long it takes, and from where it must come.
    assert near.duration == pytest.approx(middle.duration, rel=1e-5)
    assert near.control[0, 0] == pytest.approx(0.4, abs=1e-12)
    assert near.control[0, 1] == pytest.approx(middle.control[0, 1], abs=1e-3)
    inside(near, limits(2))


def test_limits_are_matched_by_name():
    two = replace(limits(2), velocity=[0.1, 2.0])
    slow, fast = (
        transfer(*(MotionState.at_rest((name,), [q]) for q in (0.0, 1.0)), two)
        for name in ("j0", "j1")
    )
    assert slow.duration > 10 * fast.duration


def moving(position, velocity):
    return MotionState(("j0",), [[position], [velocity], [0.0], [0.0]])


@pytest.mark.parametrize(
    ("begin", "end", "says"),
    [
        (at_rest(0.0), at_rest(3.1), "position of joint 'j0' is 3.1.*-3 and 3"),
        (at_rest(0.0), moving(0.0, 2.1), "velocity of joint 'j0' is 2.1.*at most 2"),
        (moving(2.9, 2.0), at_rest(0.0), "no duration.*position of joint 'j0'.*3"),
        (at_rest(0.0), MotionState.at_rest(("j1",), [0.0]), "different joints"),
        (*[MotionState.at_rest(("elbow",), [q]) for q in (0, 1)], "joint 'elbow'"),
    ],
)
def test_what_is_impossible_is_refused_with_joint_and_limit(begin, end, says):
    with pytest.raises(ProblemError, match=says):
        transfer(begin, end, limits())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"duration": 0.0}, "duration is 0"),
        ({"start": np.nan}, "start is nan"),
        ({"control": np.ones((11, 1))}, "11 coefficients"),
        ({"control": np.ones((3, 2))}, "control"),
        ({"joints": ()}, "distinct names"),
    ],
)
def test_what_is_no_polynomial_path_is_refused(change, says):
    values = {"joints": ("a",), "control": np.ones((3, 1)), "duration": 1.0} | change
    with pytest.raises(ProblemError, match=says):
        PolynomialPath(**values)


@pytest.mark.parametrize("share", [0.5, 1.0, -1.0])
def test_a_state_at_its_limit_can_be_left_and_reached(share):
    moving = MotionState(("j0",), [[0.0], [2.0 * share], [0.0], [0.0]])
    still = at_rest(1.5 * np.sign(share))
    for begin, end in ((moving, still), (at_rest(-1.5 * np.sign(share)), moving)):
        path = transfer(begin, end, limits())
        reached = ends(path)
        assert np.allclose(reached[:3, 0], begin.values[:3], atol=1e-9)
        assert np.allclose(reached[:3, 1], end.values[:3], atol=1e-9)
        time = path.start + np.linspace(0.0, path.duration, 400)
        assert abs(path.evaluate(time, 1)[1]).max() <= 2.0 * (1.0 + 2e-9)
