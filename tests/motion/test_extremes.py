"""Proven extremes of paths: closed forms, dense samples, margins from limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import RestToRest, one_sine, random_path

from consistent_id import ProblemError
from consistent_id.excitation.basis import between_samples
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.moves import move_along
from consistent_id.motion.proofs.extremes import extremes, path_interval
from consistent_id.motion.proofs.margins import motion_margins
from consistent_id.recordings.joint_paths import FourierTrajectory

INF = (np.inf,)


@pytest.mark.parametrize("order", range(4))
def test_extremes_of_a_sine_are_its_amplitude(order):
    found = extremes(one_sine(), order)
    size = (2.0 * np.pi) ** order
    assert size <= found.highest[0] <= size * (1.0 + 2e-6)
    assert -size * (1.0 + 2e-6) <= found.lowest[0] <= -size
    angle = 2.0 * np.pi * found.most_time[0] + order * np.pi / 2.0
    assert np.isclose(np.sin(angle), 1.0, atol=1e-5)


def test_extremes_of_two_cosines_are_where_calculus_puts_them():
    # cos x + cos(2 x) / 2 is 3/2 at 0, and -3/4 where cos x = -1/2
    path = FourierTrajectory(("a",), [0.5, 1.0], [1.0], [[0], [0]], [[1], [0.5]], 2.0)
    found = extremes(path, 0)
    assert np.isclose(found.highest[0], 2.5, rtol=2e-6) and found.highest[0] >= 2.5
    assert np.isclose(found.lowest[0], 0.25, atol=5e-6) and found.lowest[0] <= 0.25
    assert np.isclose(abs(found.least_time[0] - 1.0), 1.0 / 3.0, atol=2e-3)


def test_an_extreme_at_an_end_is_found_there():
    found = extremes(one_sine(duration=0.2, start=3.0), 0)
    assert found.most_time[0] == 3.2 and found.least_time[0] == 3.0
    assert np.isclose(found.highest[0], np.sin(0.4 * np.pi), atol=2e-6)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(1, 12),
    st.integers(0, 3),
    st.floats(0.3, 30.0),
    st.floats(-100.0, 100.0),
)
def test_no_sample_exceeds_the_extremes_and_some_sample_nearly_reaches_them(
    seed, harmonics, order, duration, start
):
    path = random_path(seed, harmonics=harmonics, duration=duration, start=start)
    found = extremes(path, order)
    time = np.linspace(start, start + duration, 20_001)
    values = path.evaluate(time, order)[order]
    assert (values.max(axis=0) <= found.highest).all()
    assert (values.min(axis=0) >= found.lowest).all()
    assert (found.most <= found.highest).all() and (found.least >= found.lowest).all()
    scale = np.maximum(np.ptp(values, axis=0), 1e-3 * path.derivative_bound(order))
    # as far as samples may be from an extreme themselves
    doubt = path.derivative_bound(order + 2) * (duration / 20_000) ** 2 / 8.0
    assert (found.highest - values.max(axis=0) <= 2e-6 * scale + doubt).all()
    assert (values.min(axis=0) - found.lowest <= 2e-6 * scale + doubt).all()


@pytest.mark.parametrize("generous", [1.0, 50.0])
def test_other_paths_are_bounded_however_generous_their_own_bounds(generous):
    found = extremes(RestToRest(("a",), 1.0, 2.0, generous), 1)
    assert np.isclose(found.highest[0], 1.875 / 2.0, rtol=1e-5)
    assert np.isclose(found.most_time[0], 2.0, atol=1e-2)
    assert found.highest[0] >= 1.875 / 2.0


def test_a_joint_at_rest_has_no_range():
    path = FourierTrajectory(("a",), [1.0], [0.5], [[0.0]], [[0.0]], 1.0)
    assert np.isclose(extremes(path, 0).highest, 0.5, rtol=1e-12)
    assert extremes(path, 2).size[0] <= 1e-12


def test_intervals_of_a_path_hold_all_that_it_does_in_them():
    path, middle, radius = random_path(2), np.array([1.0, 4.0, 7.7]), 0.05
    for order, over in enumerate(path_interval(path, middle, radius, 4)):
        for s in np.linspace(-radius, radius, 41):
            value = path.evaluate(middle + s, order)[order]
            assert (over.low <= value).all() and (value <= over.high).all()


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 60), st.floats(0, 1))
def test_a_trigonometric_polynomial_exceeds_its_samples_by_no_more_than_the_factor(
    seed, degree, more, shift
):
    samples = 2 * degree + more
    path = random_path(seed, base=1.0, harmonics=degree, duration=1.0)
    at = path.evaluate((np.arange(samples) + shift) / samples, 0)[0]
    between = path.evaluate(np.linspace(0.0, 1.0, 4001), 0)[0]
    factor = between_samples(degree, samples)
    most = factor * abs(at).max(axis=0) * (1.0 + 1e-12)
    assert (abs(between).max(axis=0) <= most).all()


@pytest.mark.parametrize(("degree", "times"), [(1, 2), (3, 2), (5, 12), (4, 7)])
def test_a_cosine_between_its_samples_reaches_the_factor(degree, times):
    samples = 2 * degree * times
    half_a_step = np.pi / samples
    angles = 2.0 * np.pi * np.arange(samples) / samples + half_a_step
    seen = abs(np.cos(degree * angles)).max()
    assert np.isclose(seen * between_samples(degree, samples), 1.0, rtol=1e-12)


def test_two_samples_per_cycle_bound_nothing():
    with pytest.raises(ProblemError, match="expected more than 10"):
        between_samples(5, 10)


def limits(**changes):
    values = dict(
        joints=("a",), lower=(-2.0,), upper=(2.0,), velocity=(10.0,),
        acceleration=INF, jerk=INF, effort=INF,
    )  # fmt: skip
    return MotionLimits(**{**values, **changes})


def test_margins_say_how_far_from_which_limit():
    margins = motion_margins(one_sine(), limits(jerk=(300.0,)))
    by_name = {m.quantity: m for m in margins.margins}
    assert list(by_name) == ["lower position", "upper position", "velocity", "jerk"]
    assert margins.holds
    assert np.isclose(by_name["lower position"].margin, 1.0, atol=1e-5)
    assert np.isclose(by_name["upper position"].relative, 0.25, atol=1e-5)
    assert np.isclose(by_name["velocity"].margin, 10.0 - 2.0 * np.pi, atol=1e-4)
    assert margins.least.quantity == "jerk"
    assert "jerk" in margins.table().text() and "not only" in margins.table().text()
    margins.require()


def test_what_samples_do_not_show_is_found_between_them():
    # four samples of a period, of 0.707 each in size; the limit is at 0.9
    shifted = FourierTrajectory(
        ("a",), [1.0], [0.0], [[np.sqrt(0.5)]], [[np.sqrt(0.5)]], 1.0
    )
    assert abs(shifted.evaluate(np.arange(4) / 4.0, 0)[0]).max() < 0.71
    narrow = limits(lower=(-2.0,), upper=(0.9,))
    margins = motion_margins(shifted, narrow)
    assert not margins.holds and margins.least.violated
    with pytest.raises(ProblemError, match=r"'a': upper position.*0\.9.*0\.125"):
        margins.require()


def test_a_limit_that_is_just_reached_is_not_called_proven():
    margins = motion_margins(one_sine(), limits(upper=(1.0 + 1e-10,)))
    assert not margins.holds and not margins.least.violated
    with pytest.raises(ProblemError, match=r"not proven.*leave more margin"):
        margins.require()


def test_limits_of_other_joints_are_refused():
    with pytest.raises(ProblemError, match="expected the same, in order"):
        motion_margins(one_sine(("b",)), limits())
    with pytest.raises(ProblemError, match="both model and parameters"):
        motion_margins(one_sine(), limits(), parameters=[1.0])


def move_with_junctions(joints=("a", "b")):
    """A move whose jerk jumps between pieces: it runs in and out from another pose."""
    path = random_path(4, joints, base=0.2, harmonics=2, amplitude=0.3, duration=5.0)
    bounds = [path.derivative_bound(k) for k in range(4)]
    wide = np.full(len(joints), 8.0)
    limits = MotionLimits(
        joints,
        -wide,
        wide,
        *(3.0 * b for b in bounds[1:]),
        np.full(len(joints), np.inf),
    )
    return move_along(path, limits, from_pose=wide / 4.0, to_pose=-wide / 4.0)


def every_piece(move, order, samples=2001):
    """Values of a derivative on both sides of every junction, (samples, joints)."""
    return np.concatenate(
        [
            piece.evaluate(
                piece.start + piece.duration * np.linspace(0.0, 1.0, samples), order
            )[order]
            for piece in move.pieces
        ]
    )


@pytest.mark.parametrize("order", range(5))
def test_bounds_of_a_move_hold_on_both_sides_of_its_junctions(order):
    move = move_with_junctions()
    found, seen = extremes(move, order), every_piece(move, order)
    slack = 1e-12 * abs(seen).max(axis=0)
    assert (seen.max(axis=0) <= found.highest + slack).all()
    assert (seen.min(axis=0) >= found.lowest - slack).all()
    assert np.allclose(found.most, seen.max(axis=0), rtol=1e-3, atol=1e-3)
    assert np.allclose(found.least, seen.min(axis=0), rtol=1e-3, atol=1e-3)


def test_a_jerk_beyond_its_limit_at_a_junction_is_no_proof():
    move = move_with_junctions()
    reached = abs(every_piece(move, 3)).max(axis=0)
    wide = np.full(2, 1e3)
    limits = MotionLimits(
        move.joints, -wide, wide, wide, wide, 0.999 * reached, np.full(2, np.inf)
    )
    of_jerk = [m for m in motion_margins(move, limits).margins if m.quantity == "jerk"]
    assert [margin.violated for margin in of_jerk] == [True, True]
