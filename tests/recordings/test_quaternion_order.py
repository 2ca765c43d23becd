"""Which of two orders a log's quaternions have, told from motion and from gravity."""

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.recordings.signals.base_signals import (
    moved_by_stretch,
    quaternion_order,
    stretches,
)

TIME = 0.005 * np.arange(2000)


def swaying(yaw, size=0.2):
    """A base that sways about a heading: quaternions, real part last, and its unit."""
    angle = size * np.sin(3 * TIME)
    axis = np.array([0.6, 0.64, 0.48])
    s, c = np.sin(angle / 2), np.cos(angle / 2)
    x, y, z = (s[:, None] * axis).T
    h, k = np.sin(yaw / 2), np.cos(yaw / 2)
    turned = np.column_stack(
        [k * x - h * y, k * y + h * x, k * z + h * c, k * c - h * z]
    )
    gyro = 3 * size * np.cos(3 * TIME)[:, None] * axis
    R = ci.signals.rotations(turned, "xyzw")
    return turned, gyro, np.einsum("nij,i->nj", R, [0, 0, 9.81])


@pytest.mark.parametrize("yaw", [0.0, 0.7, 1.6, 3.1, -2.0])
@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("with_gyro", [False, True])
def test_an_inertial_unit_tells_the_order(yaw, first, with_gyro):
    turned, gyro, felt = swaying(yaw)
    quaternions = np.roll(turned, 1, axis=1) if first else turned
    rng = np.random.default_rng(0)
    gyro = gyro + 0.01 + 0.005 * rng.normal(size=gyro.shape)
    found = quaternion_order(TIME, quaternions, gyro if with_gyro else None, felt)
    right = "wxyz" if first else "xyzw"
    if with_gyro:
        assert found is not None and found.order == right
    else:  # a base that is level tells little of it, and then nothing is said
        assert found is None or found.order == right


@pytest.mark.parametrize("first", [False, True])
def test_a_pose_alone_tells_it_of_a_base_that_is_upright_and_has_turned(first):
    turned, _, _ = swaying(1.6)
    quaternions = np.roll(turned, 1, axis=1) if first else turned
    found = quaternion_order(TIME, quaternions)
    assert found is not None and found.order == ("wxyz" if first else "xyzw")


def test_what_cannot_be_told_is_not_said():
    """Upright and facing ahead, or upright and turned about: both would fit."""
    ahead = np.tile([0.0, 0.0, 0.0, 1.0], (len(TIME), 1))
    assert quaternion_order(TIME, ahead) is None


def tilted(angles):
    """A base that leans by angles about an axis across it, and has turned by half."""
    x = np.sin(np.asarray(angles) / 2)
    return np.column_stack([x, 0 * x, np.cos(np.asarray(angles) / 2), 0 * x])


@pytest.mark.parametrize(
    ("spread", "order"), [(0.0, "xyzw"), (0.45, "xyzw"), (0.55, None)]
)
def test_a_base_is_upright_up_to_half_a_radian(spread, order):
    """Leaning as much to either side: the mean cosine is that of the angle."""
    leaning = tilted([spread, -spread])
    found = quaternion_order(TIME[:2], leaning)
    assert (None if found is None else found.order) == order


@pytest.mark.parametrize(("share", "reason"), [(0.49, True), (0.51, False)])
def test_a_gyroscope_decides_if_one_order_leaves_less_than_half(share, reason):
    """What it measures beyond the true rate, in quadrature with that."""
    turned, gyro, _ = swaying(1.6)
    axis = np.array([0.6, 0.64, 0.48])
    wrong = share / np.sqrt(1.0 - share**2) * 0.6 * np.sin(3 * TIME)[:, None] * axis
    found = quaternion_order(TIME, turned, gyro + wrong)
    assert (found.reason == "from the gyroscope") is reason


def test_a_gyroscope_at_rest_leaves_the_decision_to_gravity():
    half = np.sqrt(0.5)
    still = np.tile([0.0, 0.0, half, half], (len(TIME), 1))
    none = np.zeros((len(TIME), 3))
    felt = none + np.array([0.0, 0.0, 9.81])
    found = quaternion_order(TIME, still, none, felt)
    assert found == ("xyzw", "from measured gravity")
    # Of half the right direction, and half the other's, neither is clear.
    R = [ci.signals.rotations(still, order)[0] for order in ("xyzw", "wxyz")]
    between = none + (R[0] + R[1]).T @ np.array([0.0, 0.0, 1.0])
    assert quaternion_order(TIME, still, none, between).reason.startswith("because")


def test_a_norm_is_one_within_a_hundredth():
    assert (
        ci.signals.rotations([[0, 0, 0, 1.0099]], "xyzw")[0].tolist()
        == np.eye(3).tolist()
    )
    for norm in (1.0101, 0.9899):
        with pytest.raises(ci.RecordingError, match="of sample 1 has norm"):
            ci.signals.rotations([[0, 0, 0, 1], [0, 0, 0, norm]], "xyzw")


def test_stretches_end_where_ten_usual_steps_are_missing():
    assert stretches(np.zeros(0)) == []
    assert stretches(np.zeros(1)) == [slice(0, 1)]
    assert stretches(np.array([0.0, 1.0, 2.0, 12.0])) == [slice(0, 4)]
    gap = np.array([0.0, 1.0, 2.0, 12.1, 13.1, 14.1])
    assert stretches(gap) == [slice(0, 3), slice(3, 6)]


def test_each_stretch_moves_by_itself_and_needs_four_samples():
    def moved(samples):
        n = samples.stop - samples.start
        return ci.recordings.BaseMotion.at_rest(n)

    time = np.arange(8.0)
    assert len(moved_by_stretch(moved, time, "log")) == 8
    time[4:] += 100.0
    assert len(moved_by_stretch(moved, time, "log")) == 8
    time[4] = 3.5
    with pytest.raises(ci.RecordingError, match="samples 5 to 7 stand between"):
        moved_by_stretch(moved, time, "log")


def test_a_few_readings_of_a_slow_gyroscope_decide_too():
    turned, gyro, _ = swaying(0.7, size=0.02)
    few = slice(0, 2000, 100)
    assert np.linalg.norm(gyro[few] - gyro[few].mean(axis=0)) < 0.3
    found = quaternion_order(TIME[few], turned[few], gyro[few])
    assert found == ("xyzw", "from the gyroscope")


@pytest.mark.parametrize(("tilt", "told"), [(0.5, True), (0.52, False)])
def test_gravity_decides_if_one_order_leaves_less_than_half(tilt, told):
    """A quarter turn about x, or about z; the unit is tilted on the base."""
    half = np.sqrt(0.5)
    turned = np.tile([half, 0.0, 0.0, half], (50, 1))
    felt = np.tile([0.0, 9.81 * np.cos(tilt), 9.81 * np.sin(tilt)], (50, 1))
    off = 2.0 * np.sin(tilt / 2.0), np.hypot(np.cos(tilt), 1.0 - np.sin(tilt))
    assert (off[0] < 0.5 * off[1]) == told
    found = quaternion_order(TIME[:50], turned, None, felt)
    assert (found == ("xyzw", "from measured gravity")) == told


def test_a_norm_that_is_not_quite_one_is_taken_out():
    turned = 1.008 * swaying(0.7)[0][:20]
    R = ci.signals.rotations(turned, "xyzw")
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), [np.eye(3)] * 20, atol=1e-12)
