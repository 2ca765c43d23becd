"""Moves: from rest, through a trajectory, to rest, without a jump."""

from dataclasses import replace

import numpy as np
import pytest
from some_fast import some_fast

from consistent_id import MotionLimits, ProblemError, trimmed
from consistent_id.motion import Move, move_along
from consistent_id.recordings import FourierTrajectory
from consistent_id.recordings.joint_paths import harmonics_of


def periodic(seed=0, joints=3):
    rng = np.random.default_rng(seed)
    frequencies = harmonics_of(0.2, 4)
    shape = (len(frequencies), joints)
    return FourierTrajectory(
        tuple(f"j{k}" for k in range(joints)),
        frequencies,
        rng.normal(size=joints),
        rng.normal(size=shape),
        rng.normal(size=shape),
        duration=5.0,
        start=3.0,
    )


def resting():
    """A trajectory that rests after each period: 0.4 cos wt - 0.1 cos 2wt."""
    return FourierTrajectory(
        ("a", "b"), [0.5, 1.0], [0.0, 0.5], np.zeros((2, 2)), [[0.4] * 2, [-0.1] * 2], 2
    )


def limits_of(path, share=1.2, jerk=None):
    bounds = [share * path.derivative_bound(k) for k in range(4)]
    return MotionLimits(
        path.joints,
        -bounds[0],
        bounds[0],
        bounds[1],
        bounds[2],
        bounds[3] if jerk is None else np.full(len(path.joints), jerk),
        np.full(len(path.joints), np.inf),
    )


def jumps(move, derivatives=3):
    """Return the change at every junction, (junctions, derivatives + 1, joints)."""
    sides = [
        (a.evaluate([a.start + a.duration], derivatives), b.evaluate([b.start], 3))
        for a, b in zip(move.pieces[:-1], move.pieces[1:], strict=True)
    ]
    return np.array([after[:, 0] - before[:, 0] for before, after in sides])


@pytest.mark.slow
@pytest.mark.parametrize("pose", [None, [0.1, -0.2, 0.3]])
def test_nothing_jumps_between_pieces_and_both_ends_rest(pose):
    path = periodic()
    own = limits_of(path)
    move = move_along(path, own, from_pose=pose, to_pose=pose)
    off = jumps(move)
    assert len(off) == 2 and abs(off[:, :3]).max() < 1e-8
    ends = move.evaluate([move.start, move.start + move.duration])
    np.testing.assert_allclose(ends[1:], 0.0, atol=1e-8)
    if pose is not None:
        np.testing.assert_allclose(ends[0], [pose, pose], atol=1e-12)
    time = np.linspace(0.0, move.duration, 4001)
    for k, values in enumerate(move.evaluate(time, 3)):
        assert (abs(values).max(axis=0) <= move.derivative_bound(k) + 1e-9).all()
        assert (abs(values) <= own.derivative(k)).all()


def test_a_trajectory_at_rest_gets_point_to_point_moves_or_none():
    path = resting()
    own, home = limits_of(path), path.evaluate([0.0])[0, 0]
    assert move_along(path, own).pieces[0].start == 0.0
    assert len(move_along(path, own, from_pose=home, to_pose=home).pieces) == 1
    move = move_along(path, own, from_pose={"b": 0.2, "a": 0.1})
    (way,) = move.run_in
    assert not move.run_out and np.allclose(way.control[:3], [0.1, 0.2])
    # From rest to rest a quintic has no other coefficients.
    assert np.allclose(way.control[3:], home, atol=1e-12)


@pytest.mark.slow
def test_where_no_polynomial_leads_to_a_state_two_meet_at_rest():
    # One joint has far to go, slowly; the other is fast and has no room for long.
    path = FourierTrajectory(("far", "fast"), [1.0], [0, 0], [[0, 0.3]], [[0, 0]], 5.0)
    own = MotionLimits(
        path.joints, [-9, -1], [9, 1], [1, 3], [5, 15], [50, 300], [np.inf] * 2
    )
    move = move_along(path, own, from_pose=[8.0, 0.0], to_pose=[-8.0, 0.5])
    assert (len(move.run_in), len(move.run_out)) == (2, 2)
    assert abs(jumps(move)[:, :3]).max() < 1e-8
    for junction in (move.run_in[1].start, move.run_out[1].start):
        np.testing.assert_allclose(move.evaluate([junction])[1:], 0.0, atol=1e-9)
    values = move.evaluate(np.linspace(0.0, move.duration, 8001), 3)
    assert all((abs(v) <= own.derivative(k)).all() for k, v in enumerate(values))


@pytest.mark.slow
def test_periods_repeat_and_their_rows_can_be_told():
    path = periodic()
    move = move_along(path, limits_of(path), from_pose=[0, 0, 0], periods=3)
    assert move.trajectory.duration == pytest.approx(15.0)
    log = move.recording(200.0)
    rows = move.excites(log.time)
    assert 2999 <= rows.sum() <= 3001 and not rows[0] and not rows[-1]
    assert np.array_equal(trimmed(log, *move.window).time, log.time[rows])
    same = path.evaluate(log.time[rows] - move.trajectory.start + path.start)
    np.testing.assert_allclose(log.position[rows], same[0], atol=1e-10)


@pytest.mark.slow
def test_outside_its_time_a_move_rests():
    move = move_along(periodic(), limits_of(periodic()))
    values = move.evaluate([-1.0, 1e9], derivatives=3)
    assert not values[1:].any()
    ends = move.evaluate([move.start, move.start + move.duration], derivatives=0)
    assert np.array_equal(values[0], ends[0])


def test_without_limits_of_acceleration_the_ways_are_as_gentle_as_the_trajectory():
    path = periodic()
    own = replace(limits_of(path), acceleration=[np.inf] * 3, jerk=[np.inf] * 3)
    move = move_along(path, own, from_pose=[0.0, 0.0, 0.0])
    for way in (*move.run_in, *move.run_out):
        for order in (2, 3):
            assert (way.derivative_bound(order) <= path.derivative_bound(order)).all()


def _pieces():
    path = periodic()
    return move_along(path, limits_of(path))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda m: Move((), m.trajectory, m.run_out), "velocity of joint.*its start"),
        (lambda m: Move(m.run_in, m.trajectory, ()), "velocity of joint.*its end"),
        (lambda m: Move(m.run_in, replace(m.trajectory, start=9.0), ()), "same time"),
        (
            lambda m: Move(
                m.run_in, replace(m.trajectory, offset=m.trajectory.offset + 0.1), ()
            ),
            "position of joint .* jumps.*junction",
        ),
        (
            lambda m: Move(
                (replace(m.run_in[0], joints=("a", "b", "c")),), m.trajectory, ()
            ),
            "piece 1 moves joints",
        ),
    ],
)
def test_pieces_that_do_not_fit_are_refused(change, says):
    with pytest.raises(ProblemError, match=says):
        change(_pieces())


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"from_pose": [0.0, 0.0]}, "from_pose.*shape"),
        ({"to_pose": {"j0": 1.0}}, "to_pose does not name joint 'j1'"),
        ({"to_pose": dict.fromkeys(("j0", "j1", "j2", "j3"), 0)}, "names joint 'j3'"),
        ({"from_pose": [99.0, 0.0, 0.0]}, "position of joint 'j0' is 99"),
        ({"periods": 0}, "at least one"),
    ],
)
def test_what_makes_no_move_is_refused(given, says):
    path = periodic()
    with pytest.raises(ProblemError, match=says):
        move_along(path, limits_of(path), **given)


def test_a_trajectory_beyond_the_limits_is_refused():
    path = periodic()
    state = abs(path.evaluate([path.start])[1, 0]) / path.derivative_bound(1)
    with pytest.raises(ProblemError, match="velocity of joint"):
        move_along(path, limits_of(path, share=0.9 * state.max()))


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast([1, 8, 12]))
def test_a_jerk_that_nobody_limits_is_in_nobodys_way(seed):
    # Limits just above the path's own peaks, none of jerk: within the path's own bound
    # of jerk there is no run-in.
    rng = np.random.default_rng(seed)
    sine, cosine = 0.25 * rng.normal(size=(2, 3, 2))
    names, rates = ("a", "b"), np.arange(1, 4) / 5.0
    path = FourierTrajectory(names, rates, np.zeros(2), sine, cosine, 5.0)
    time = np.linspace(0.0, 5.0, 2001)
    q, dq, ddq = 1.02 * abs(path.evaluate(time)).max(axis=1)
    limits = MotionLimits(names, -q, q, dq, ddq, np.full(2, np.inf), np.full(2, np.inf))
    move = move_along(path, limits)
    motion = move.evaluate(np.linspace(0.0, move.duration, 4001))
    assert (abs(motion) <= np.array([q, dq, ddq])[:, None] * (1 + 1e-9)).all()


def test_smooth_ways_between_poses_have_no_jerk_at_their_ends():
    path = resting()
    own = limits_of(path, share=2.0)
    home = [0.1, -0.2]
    plain = move_along(path, own, from_pose=home, to_pose=home)
    assert abs(plain.run_in[0].evaluate([0.0], 3)[3]).max() > 1e-3
    # The path's own jerk at its ends counts with it; the way meets it.
    smooth = move_along(
        path, own, from_pose=home, to_pose=home, from_via=[[0.0, 0.0]], smooth=True
    )
    first, second = smooth.run_in
    for piece, time in ((first, first.start), (first, second.start)):
        np.testing.assert_allclose(piece.evaluate([time], 3)[1:], 0.0, atol=1e-6)
    assert abs(jumps(smooth)).max() < 1e-6
    time = np.linspace(0.0, smooth.duration, 4001)
    for k, values in enumerate(smooth.evaluate(time, 3)):
        assert (abs(values) <= own.derivative(k) * (1.0 + 1e-9)).all()
