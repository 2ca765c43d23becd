"""Which joints a log may have that has fewer than the robot."""

import re

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.problems.nominal_gains import joint_rows
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import Statement
from consistent_id.recordings.column_names import columns_of_pattern, name_patterns
from consistent_id.robot import load_urdf

_LINK = (
    '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
    'ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
_JOINT = (
    '<joint name="{1}_joint" type="revolute"><parent link="{0}"/><child link="{1}"/>'
    '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
)


def _robot(folder, *pairs):
    """Return the robot that links, each with its parent, make."""
    names = dict.fromkeys(name for pair in pairs for name in pair)
    parts = [_LINK.format(name) for name in names]
    parts += [_JOINT.format(*pair) for pair in pairs]
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="robot">{"".join(parts)}</robot>')
    return load_urdf(file)


def test_rows_of_joints_follow_one_another_from_the_base_on(tmp_path):
    robot = _robot(
        tmp_path,
        ("base", "wheel"),
        ("base", "torso"),
        ("torso", "arm"),
        ("torso", "head"),
        ("arm", "hand"),
    )
    torso, arm, hand, head = (f"{n}_joint" for n in ("torso", "arm", "hand", "head"))
    assert joint_rows(robot, 3) == ((torso, arm, hand),)
    assert set(joint_rows(robot, 2)) == {(torso, arm), (torso, head), (arm, hand)}
    assert joint_rows(robot, 2)[-1] == (arm, hand)
    assert joint_rows(robot, 4) == ()


_TURNED = """<robot name="r"><link name="base"/>{links}
<joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
<joint name="a" type="revolute"><parent link="cart"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
<joint name="b" type="revolute"><origin xyz="0.4 0 0"/><parent link="upper"/>
<child link="fore"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/></joint></robot>"""
_BODY = (
    '<link name="{}"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def _arm_on_a_rail(folder, header, table):
    links = "".join(map(_BODY.format, ("cart", "upper", "fore")))
    (folder / "robot.urdf").write_text(_TURNED.format(links=links))
    np.savetxt(folder / "log.csv", table, delimiter=",", header=header, comments="")
    return folder / "robot.urdf", folder / "log.csv"


def _torque_of_the_arm():
    """Gravity's torque on both joints of the arm on the rail, in closed form."""
    t = np.arange(0.0, 20.0, 0.02)
    q = np.column_stack([np.sin(0.5 * t), np.cos(0.8 * t)])
    upper, both = np.cos(q[:, 0]), np.cos(q.sum(axis=1))
    fore = -9.81 * 2 * 0.2 * both
    torque = np.column_stack([-9.81 * 2 * (0.2 + 0.4) * upper + fore, fore])
    return t, q, torque


@pytest.mark.slow
def test_the_row_of_joints_whose_torque_the_log_has_is_proposed(tmp_path):
    t, q, torque = _torque_of_the_arm()
    files = _arm_on_a_rail(
        tmp_path, "time,q1,q2,tau1,tau2", np.column_stack([t, q, torque])
    )
    with pytest.raises(RecordingError, match="from a to b, lock") as refused:
        robot_logs(*files)
    assert refused.value.options == "--lock rail"


def test_arrays_and_tables_without_names_propose_the_same(tmp_path):
    t, q, torque = _torque_of_the_arm()
    files = _arm_on_a_rail(tmp_path, "time,q1,q2,tau1,tau2", np.column_stack([t, q]))
    np.savez(tmp_path / "log.npz", time=t, q=q, tau=torque)
    with pytest.raises(RecordingError, match="shape") as refused:
        robot_logs(files[0], tmp_path / "log.npz")
    assert refused.value.options == "--lock rail"


def _named(folder, names, *, rail=0.0):
    """Return the robot and a log of its arm, with columns beside those of the arm."""
    t, q, torque = _torque_of_the_arm()
    own = {"q_rail": rail * np.sin(t), "tau_rail": np.cos(t)}
    table = np.column_stack([t, q, torque, *(own[name] for name in names)])
    header = ",".join(["time", "q_a", "q_b", "tau_a", "tau_b", *names])
    return _arm_on_a_rail(folder, header, table)


def test_a_joint_with_torque_and_without_position_is_refused(tmp_path):
    files = _named(tmp_path, ["tau_rail"])
    said = r"torque of rail \(tau_rail\), but no position of it; .* q_a, q_b"
    with pytest.raises(RecordingError, match=said) as refused:
        robot_logs(*files)
    assert "--lock rail" in str(refused.value)
    assert not refused.value.options  # only the user knows that it stood still


def test_a_joint_that_is_stated_to_stand_still_needs_no_position(tmp_path):
    files = _named(tmp_path, ["tau_rail"])
    found = robot_logs(*files, Statement(locked={"rail": 0.2}))
    assert (found.robot.joint_names, found.locked) == (("a", "b"), {"rail": 0.2})


def test_a_joint_without_any_column_is_locked(tmp_path):
    assert robot_logs(*_named(tmp_path, [])).locked == {"rail": 0.0}


def test_a_locked_joint_that_moves_in_the_log_is_refused(tmp_path):
    files = _named(tmp_path, ["q_rail", "tau_rail"], rail=0.3)
    said = (
        r"rail moves by 0\.6 rad or m .*q_rail\), and 100% of the robot's mass with it"
    )
    with pytest.raises(RecordingError, match=said):
        robot_logs(*files, Statement(locked={"rail": 0.0}))


@pytest.mark.parametrize(
    ("masses", "refused"),
    [
        ([0.05], ""),
        ([1.0], "joint0 moves .* and 14% of the robot's mass with it; "),
        ([0.4, 0.4], "joint1 moves .* and 12% of .* with it and joint0, which move, "),
    ],
)
def test_light_joints_may_be_locked_though_they_move(tmp_path, masses, refused):
    t, q, torque = _torque_of_the_arm()
    swings = [0.3 * np.sin(t)] * len(masses)
    names = [f"joint{k}" for k in range(len(masses))]
    header = ",".join(["time,q_a,q_b,tau_a,tau_b", *(f"q_{name}" for name in names)])
    table = np.column_stack([t, q, torque, *swings])
    robot, log = _arm_on_a_rail(tmp_path, header, table)
    last = re.findall(r'<child link="(\w+)"', robot.read_text())[-1]
    fingers = "".join(
        f'<link name="of_{name}"><inertial><mass value="{mass}"/><inertia ixx="1e-4" '
        'iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="{name}" type="revolute"><parent link="{last}"/>'
        f'<child link="of_{name}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for name, mass in zip(names, masses, strict=True)
    )
    robot.write_text(robot.read_text().replace("</robot>", f"{fingers}</robot>"))
    stated = Statement(locked=dict.fromkeys(["rail", *names], 0.0))
    if refused:
        with pytest.raises(RecordingError, match=refused):
            robot_logs(robot, log, stated)
    else:
        notes = robot_logs(robot, log, stated).notes
        assert any("joint0 is locked at 0 rad or m" in note for note in notes)


def test_a_locked_joint_that_stands_elsewhere_is_noted(tmp_path):
    robot, log = _named(tmp_path, ["q_rail"], rail=0.01)
    near = robot_logs(robot, log, Statement(locked={"rail": 0.0}))
    assert not any("is locked" in note for note in near.notes)
    far = robot_logs(robot, log, Statement(locked={"rail": 0.4}))
    assert any("rail is locked at 0.4" in note for note in far.notes)


def test_one_unit_of_length_for_joints_of_which_some_turn_is_refused(tmp_path):
    files = _named(tmp_path, [])
    with pytest.raises(RecordingError, match="positions are stated to be in mm, but a"):
        robot_logs(*files, Statement(units={"position": "mm"}))


def test_numbers_in_names_of_joints_do_not_count_the_unlocked():
    every = ("joint1", "joint2", "joint3", "gripper")
    names = ["q_joint1", "q_joint2", "q_joint3"]
    (found,) = name_patterns("position", names, ("joint1", "joint3", "gripper"), every)
    assert columns_of_pattern(found) == ["q_joint1", "q_joint3"]
