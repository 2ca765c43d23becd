"""What is printed of limits: shares of them, or the largest values without any."""

from types import SimpleNamespace

import numpy as np
import pytest

from consistent_id.excitation.used_limits import (
    largest_values,
    longer_duration,
    longer_words,
    used_limits,
)
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.proofs.margins import motion_margins
from consistent_id.recordings.joint_paths import FourierTrajectory

SWING, DURATION = 0.2, 10.0
SPEED = 2.0 * np.pi / DURATION * SWING  # of one period


def _design(width, velocity=SPEED, predicted=None, **limits):
    """A joint that swings once within a range, and what a design says of it."""
    still, swing = [[0.0]], [[SWING]]
    path = FourierTrajectory(("slew",), [0.1], [0.0], swing, still, DURATION)
    free = {"acceleration": np.inf, "jerk": np.inf, "effort": np.inf} | limits
    every = {name: [value] for name, value in free.items()}
    bounds = MotionLimits(("slew",), [-width / 2], [width / 2], [velocity], **every)
    return SimpleNamespace(
        trajectory=path,
        limits=bounds,
        form=SimpleNamespace(duration=DURATION),
        proof=SimpleNamespace(margins=motion_margins(path, bounds)),
        demands=SimpleNamespace(predicted=predicted, parameters=None),
        notes=(),
    )


def test_a_joint_that_its_velocity_limit_stops_is_given_more_time():
    # An eighth of the range is the amplitude of a quarter of it: 1 m, five swings.
    design = _design(width=8.0)
    assert longer_duration(design) == pytest.approx(DURATION * 1.0 / SWING)
    assert "--duration 50 gives them time" in longer_words(design)[0]
    assert longer_words(_design(width=8.1))[0].count("--duration 51 ") == 1


@pytest.mark.parametrize(
    "design",
    [_design(width=1.0), _design(width=8.0, velocity=2.0 * SPEED)],
    ids=["it moves", "another limit stops it"],
)
def test_no_longer_motion_is_advised_where_time_is_not_the_reason(design):
    assert longer_duration(design) is None and longer_words(design) == ()


def test_without_a_limit_the_largest_value_is_printed():
    w = 2.0 * np.pi / DURATION
    design = _design(width=1.0, jerk=1.0)
    found = largest_values(design)
    assert found["acceleration"] == pytest.approx([SWING * w**2], rel=1e-4)
    assert found["jerk"] == pytest.approx([SWING * w**3], rel=1e-4)
    assert found["torque"] == [None]
    table = used_limits(design)
    (row,) = table.rows
    cells = dict(zip(table.header, row, strict=True))
    assert cells["velocity"] == "100 %" and cells["jerk"] == "5 %"
    assert cells["acceleration"] == "0.079, no limit" and cells["torque"] == "-"
    assert any("without a limit in rad or m" in note for note in table.notes)


def test_torque_without_a_limit_is_the_largest_of_all_samples_and_robots():
    seen = np.array([[[1.0], [-3.0]], [[2.0], [0.5]]])  # samples, robots, joints
    kernel = SimpleNamespace(torque=lambda motion: seen)
    design = _design(width=1.0, predicted=SimpleNamespace(kernel=kernel))
    assert largest_values(design)["torque"] == [3.0]
    assert used_limits(design).rows[0][-1] == "3, no limit"


def test_the_table_of_a_robot_without_limits_fits_a_screen():
    kernel = SimpleNamespace(torque=lambda motion: np.full((1, 1, 1), 1.234e-4))
    design = _design(
        width=1.0, velocity=np.inf, jerk=9.0, predicted=SimpleNamespace(kernel=kernel)
    )
    text = used_limits(design).text().replace("slew ", "panda_finger_joint1 ")
    assert text.count("no limit") == 3 and max(map(len, text.splitlines())) <= 100
