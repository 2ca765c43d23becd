"""Few points, between which a controller's quintics stay near the path."""

import json

import numpy as np
import pytest
from paths import random_path
from scipy.interpolate import BPoly
from some_fast import some_fast

from consistent_id import MotionLimits, ProblemError
from consistent_id.motion import move_along, read_trajectory, write_trajectory
from consistent_id.motion.files.trajectory_file import thinned


def _quintic(points, time):
    """What joint_trajectory_controller makes of points, by SciPy: position alone."""
    states = np.stack([points.position, points.velocity, points.acceleration], axis=1)
    return BPoly.from_derivatives(points.time, states)(time)


def _move(seed=0):
    path = random_path(seed)
    bounds = [1.5 * path.derivative_bound(k) for k in range(4)]
    none = np.full(len(path.joints), np.inf)
    limits = MotionLimits(
        path.joints, -bounds[0], bounds[0], bounds[1], bounds[2], bounds[3], none
    )
    return move_along(path, limits)


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", some_fast([1e-2, 1e-4, 1e-6], 2))
@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_quintics_between_the_points_stay_within_the_tolerance(seed, tolerance):
    move = _move(seed)
    points = thinned(move, tolerance)
    time = np.linspace(move.start, move.start + move.duration, 50_001)
    (path,) = move.evaluate(time, 0)
    off = abs(_quintic(points, time) - path).max()
    assert off <= tolerance * (1.0 + 1e-6) + 1e-12
    # Not many more than needed: half as many, at equal steps, are off by more.
    begin, end = move.window
    inside = points.time[(points.time >= begin) & (points.time <= end)]
    fewer = np.linspace(begin, end, max(2, len(inside) // 3))
    coarse = type(points)(move.joints, fewer, *move.evaluate(fewer))
    within = (time >= begin) & (time <= end)
    assert abs(_quintic(coarse, time[within]) - path[within]).max() > tolerance


@pytest.mark.slow
def test_run_ins_need_their_ends_alone():
    move = _move()
    begin, _ = move.window
    assert (thinned(move, 1e-4).time < begin - 1e-9).sum() == len(move.run_in)


@pytest.mark.slow
def test_a_thinned_message_is_read_back_and_other_formats_are_refused(tmp_path):
    move = _move()
    file = write_trajectory(move, tmp_path / "move.yaml", tolerance=1e-4)
    points = json.loads(file.read_text())["points"]
    expected = thinned(move, 1e-4)
    assert len(points) == len(expected.time) < 0.2 * 100.0 * move.duration
    back = read_trajectory(file)
    np.testing.assert_allclose(back.position, expected.position, atol=1e-12)
    with pytest.raises(ProblemError, match="only ROS messages"):
        write_trajectory(move, tmp_path / "move.csv", tolerance=1e-4)
    with pytest.raises(ProblemError, match="1e-06 or more"):
        thinned(move, 1e-9)
