"""Which columns are a wrench sensor's, by the names that logs really have."""

import pytest

from consistent_id.recordings.sensor_words import wrench_names


def axes(force, moment):
    return [word.format(a) for word in (force, moment) for a in "xyz"]


@pytest.mark.parametrize(
    "names",
    [
        axes("f{}", "t{}"),
        axes("F{}", "M{}"),
        axes("wrist_f{}_N", "wrist_t{}_Nm"),
        axes("ft.f{} [N]", "ft.t{} [N m]"),
        axes("wrench.force.{}", "wrench.torque.{}"),
        axes("/ft_sensor/wrench/force/{}", "/ft_sensor/wrench/torque/{}"),
        axes("field.wrench.force.{}", "field.wrench.torque.{}"),
        axes("wrench_force_{}", "wrench_torque_{}"),
        axes("tool0_force_{}", "tool0_moment_{}"),
        [f"actual_TCP_force_{k}" for k in range(6)],
        [f"wrench[{k}]" for k in range(6)],
        [f"ft_{k}" for k in range(1, 7)],
    ],
    ids=lambda names: names[0],
)
def test_six_columns_are_found_force_first_whatever_their_order(names):
    log = ["time", "q1", "tau1", "tau_x", *names[::-1], "note"]
    (found,) = wrench_names(log)
    assert found.names == tuple(names)


@pytest.mark.parametrize(
    ("names", "widths", "wrench"),
    [
        (["wrench"], {"wrench": 6}, ("wrench",)),
        (["q", "ft_data"], {"q": 6, "ft_data": 6}, ("ft_data",)),
        (
            ["ft/torque", "ft/force"],
            {"ft/torque": 3, "ft/force": 3},
            ("ft/force", "ft/torque"),
        ),
    ],
)
def test_arrays_are_found_whole_or_in_halves(names, widths, wrench):
    (found,) = wrench_names(names, widths)
    assert found.names == wrench


@pytest.mark.parametrize(
    "names",
    [
        [f"tau{k}" for k in range(1, 7)],
        [f"joint_torque_{k}" for k in range(6)],
        axes("foot_contact_force_{}", "foot_contact_torque_{}"),
        axes("f{}_cmd", "t{}_cmd"),
        ["fx", "fy", "fz"],
        axes("pos_{}", "vel_{}"),
    ],
    ids=lambda names: names[0],
)
def test_what_is_no_wrench_is_none(names):
    assert wrench_names(names) == ()
