"""Columns of a floating base by the names that logs give them."""

import pytest

from consistent_id.recordings.sensor_words import (
    base_names,
    contact_names,
    matched_frame,
)


def three(stem, axes="xyz"):
    return tuple(f"{stem}{axis}" for axis in axes)


@pytest.mark.parametrize(
    ("names", "role", "order"),
    [
        (three("imu_gyro_"), "angular_velocity", None),
        (three("gyroscope."), "angular_velocity", None),
        (three("base_ang_vel_"), "angular_velocity", None),
        (three("root_ang_vel_b_", "012"), "angular_velocity", None),
        (three("imu_angular_velocity_"), "angular_velocity", None),
        (three("acc_", "XYZ"), "acceleration", None),
        (three("imu_linear_acceleration."), "acceleration", None),
        (three("accelerometer_"), "acceleration", None),
        (three("base_pos_"), "position", None),
        (three("root_position[", ("0]", "1]", "2]")), "position", None),
        (three("base_quat_", "xyzw"), "orientation", "xyzw"),
        (three("imu_orientation_", "wxyz"), "orientation", "wxyz"),
        (three("q", "wxyz"), "orientation", "wxyz"),
        (three("root_rot_", "0123"), "orientation", None),
    ],
)
def test_names_of_a_base_are_known(names, role, order):
    log = ["time", "q_hip", "q_knee", *names, "tau_hip", "tau_knee"]
    (found,) = base_names(log, {})
    assert (found.role, found.names, found.order) == (role, names, order)


@pytest.mark.parametrize(
    "names",
    [
        three("q", "1234"),  # joints
        three("foot_pos_"),
        three("wrist_acc_"),
        three("cmd_base_ang_vel_"),
        three("projected_gravity_"),
        three("mag_"),
        three("left_foot_force_"),
        ("q_hip", "q_knee", "q_toe"),
    ],
)
def test_names_of_something_else_are_left_alone(names):
    assert base_names(names, {}) == ()


def test_arrays_are_told_by_name_and_width():
    widths = {"root_states": 13, "dof_pos": 12, "base_quat": 4, "base_lin_vel": 3}
    widths |= {"base_ang_vel": 3, "dof_vel": 12}
    found = {(x.role, x.names) for x in base_names(["time", *widths], widths)}
    assert found == {
        ("position", "root_states[0:3]"),
        ("orientation", "root_states[3:7]"),
        ("orientation", "base_quat"),
        ("angular_velocity", "base_ang_vel"),
    }


def test_contacts_are_matched_to_feet_or_to_none():
    log = ["time", "contact_FL", "fr_foot_contact", "RL_touch", "contact_force_x"]
    feet = {f"{leg}_foot": [f"{leg}_calf"] for leg in ("FL", "FR", "RL", "RR")}
    found = {name: matched_frame(name, feet) for name in contact_names(log)}
    expected = {"contact_FL": "FL_foot", "fr_foot_contact": "FR_foot"}
    assert found == {**expected, "RL_touch": "RL_foot"}
    assert matched_frame("contact", feet) is None
    assert matched_frame("contact_L", feet) is None
    soles = {"left_sole": ["left_ankle_roll"], "right_sole": ["right_ankle_roll"]}
    assert matched_frame("left_contact", soles) == "left_sole"
