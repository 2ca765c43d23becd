"""The motion of a base from an IMU and from poses, against rotations in closed form."""

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings import BaseMotion, ContactFlags, Wrench
from consistent_id.signals import base_from_imu, base_from_pose, rotations

STEP = 1e-3
TIME = STEP * np.arange(2001)
INSIDE = slice(50, -50)  # differences are of lower order at the ends


def about_z(angle):
    c, s, one, zero = np.cos(angle), np.sin(angle), 1 + 0 * angle, 0 * angle
    rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    return np.moveaxis(np.array(rows), 2, 0)


@pytest.fixture
def swing():
    """A base that swings about a tilted axis while it moves: pose and true motion."""
    tilt = np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    angle, rate = 0.8 * np.sin(3 * TIME), 2.4 * np.cos(3 * TIME)
    push = -7.2 * np.sin(3 * TIME)
    R = tilt @ about_z(angle)
    axis = tilt[:, 2]
    x = np.stack([0.1 * np.sin(5 * TIME), 0.2 * np.cos(2 * TIME), TIME**2], axis=1)
    a = np.stack(
        [-2.5 * np.sin(5 * TIME), -0.8 * np.cos(2 * TIME), 2 + 0 * TIME], axis=1
    )
    truth = BaseMotion.from_world(R, rate[:, None] * axis, push[:, None] * axis, a)
    half = angle / 2
    about = np.array([0.0, 0.0, 1.0])
    spin = np.column_stack([np.cos(half), np.sin(half)[:, None] * about])
    # tilt is a turn about x with cosine 0.6
    w, i = np.sqrt(0.8), np.sqrt(0.2)
    p, q, r, s = spin.T
    product = np.stack(
        [w * p - i * q, w * q + i * p, w * r - i * s, w * s + i * r], axis=1
    )
    return x, product, R, truth


def same(found, truth, tolerance):
    assert np.allclose(found.stacked[INSIDE], truth.stacked[INSIDE], atol=tolerance)


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_a_pose_tells_what_the_base_feels(swing, order):
    x, quaternion, R, truth = swing
    ordered = np.roll(quaternion, -1, axis=1) if order == "xyzw" else quaternion
    assert np.allclose(rotations(ordered, order), R, atol=1e-12)
    found = base_from_pose(TIME, x, ordered, order=order, cutoff=None)
    same(found, truth, 1e-3)


def test_a_pose_that_turns_evenly_has_the_same_rate_at_both_ends():
    half = 0.5 * 3.0 * TIME
    spin = np.column_stack([0 * half, 0 * half, np.sin(half), np.cos(half)])
    still = np.zeros((len(TIME), 3))
    found = base_from_pose(TIME, still, spin, order="xyzw", cutoff=None)
    expected = np.tile([0.0, 0.0, 3.0], (len(TIME), 1))
    np.testing.assert_allclose(found.angular_velocity, expected, atol=1e-9)


def test_an_imu_beside_the_origin_tells_what_the_origin_feels(swing):
    *_, truth = swing
    r, mounting = np.array([0.1, -0.2, 0.3]), about_z(np.array([0.7]))[0]
    w, dw = truth.angular_velocity, truth.angular_acceleration
    there = truth.specific_force + np.cross(dw, r) + np.cross(w, np.cross(w, r))
    found = base_from_imu(
        TIME, w @ mounting, there @ mounting, cutoff=None, position=r, mounting=mounting
    )
    same(found, truth, 1e-3)


def test_at_rest_an_accelerometer_shows_gravity_upwards():
    turned = about_z(np.array([0.3, 0.4]))
    still = np.zeros((2, 3))
    found = BaseMotion.from_world(turned, still, still, still)
    assert np.allclose(found.specific_force, BaseMotion.at_rest(2).specific_force)


def test_quaternions_must_be_named_and_of_unit_length():
    with pytest.raises(RecordingError, match="norm 2"):
        rotations([[0.0, 0.0, 0.0, 2.0]], "xyzw")
    with pytest.raises(RecordingError, match="order is 'zyx'"):
        rotations([[0.0, 0.0, 0.0, 1.0]], "zyx")


def test_what_is_beside_the_joints_keeps_their_clock():
    base = BaseMotion.at_rest(4)
    wrench = Wrench("foot", np.arange(24.0).reshape(4, 6))
    flags = ContactFlags("foot", [True, False, True, True])
    log = Recording(
        ("a",),
        np.arange(4.0),
        np.zeros((4, 1)),
        base=base,
        wrenches=[wrench],
        contacts=[flags],
    )
    part = log.samples(slice(1, 3))
    assert len(part.base) == len(part.wrenches[0]) == len(part.contacts[0]) == 2
    assert part.contacts[0].closed.tolist() == [False, True]
    assert part.wrenches[0].values[0, 0] == 6.0
    with pytest.raises(RecordingError, match="base motion has 4 samples, expected 3"):
        Recording(("a",), np.arange(3.0), np.zeros((3, 1)), base=base)


def test_contacts_are_read_from_forces_and_doubted_around_their_changes():
    force = np.zeros((8, 6))
    force[3:6, 2] = 50.0
    flags = ContactFlags.from_wrench(Wrench("foot", force), threshold=10.0, guard=1)
    assert np.flatnonzero(flags.closed).tolist() == [3, 4, 5]
    assert np.flatnonzero(~flags.certain).tolist() == [2, 3, 5, 6]


@pytest.mark.slow
def test_filtered_motion_of_a_base_is_the_true_one_below_the_cut_off(swing):
    """Motion of 0.8 Hz; a filter of 20 Hz leaves (0.04)^8 less of it."""
    x, quaternion, R, truth = swing
    found = base_from_pose(TIME, x, quaternion, order="wxyz", cutoff=20.0)
    inside = slice(300, -300)
    np.testing.assert_allclose(found.stacked[inside], truth.stacked[inside], atol=2e-3)
    noisy = truth.specific_force + np.sin(400 * np.pi * TIME)[:, None]  # 200 Hz
    w = truth.angular_velocity
    found = base_from_imu(TIME, w, noisy, cutoff=20.0, rotation=R)
    np.testing.assert_allclose(found.stacked[inside], truth.stacked[inside], atol=2e-3)
    assert found.rotation.tolist() == R.tolist()


def test_an_imu_is_at_the_origin_if_nothing_else_is_said():
    turning = np.tile([0.0, 3.0, 0.0], (len(TIME), 1))
    felt = np.tile([1.0, 2.0, 9.81], (len(TIME), 1))
    base = base_from_imu(TIME, turning, felt, cutoff=None)
    np.testing.assert_allclose(base.specific_force, felt, atol=1e-9)
