"""Which of two orders a log's quaternions have, told from motion and from gravity."""

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.recordings.signals.base_signals import quaternion_order

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
