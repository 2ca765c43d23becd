"""Joints that follow others: rules, locks, kinematics by finite differences."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from robots import URDF, random_robot, with_followers

from consistent_id import ModelError
from consistent_id.robot import JointLimits, Mimic, chain, load_urdf
from consistent_id.robot.chains import held
from consistent_id.robot.kinematics import carrying_joints, frame_motion
from consistent_id.robot.model import limits_with_followers

RULES = {"j2": Mimic("j0", -0.5, 0.3), "j4": Mimic("j1", 2.0)}


def _robot(seed=0):
    """A chain of five joints; j2 follows j0, and j4 follows j1."""
    _, robot = random_robot(np.random.default_rng(seed), 5)
    return with_followers(robot, RULES)


def _written(tmp_path, mimic):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.replace('<axis xyz="0 1 0"/>', mimic))
    return path


def test_only_joints_that_move_by_themselves_are_coordinates():
    robot = _robot()
    assert len(robot) == 3
    assert robot.joint_names == ("j0", "j1", "j3")
    assert [joint.name for joint in robot.joints] == [f"j{k}" for k in range(5)]
    q = robot.joint_positions(np.array([[0.1, 0.2, 0.4]]))
    assert np.allclose(q, [[0.1, 0.2, -0.05 + 0.3, 0.4, 0.4]], atol=1e-15)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"j2": Mimic("j9")}, "'j2' has to follow one that moves by itself, not 'j9'"),
        ({"j2": Mimic("j3"), "j3": Mimic("j1")}, "itself, not 'j3'; known"),
        ({"j2": Mimic("j2")}, "itself, not 'j2'; known"),
    ],
)
def test_leaders_move_by_themselves(rules, message):
    _, robot = random_robot(np.random.default_rng(0), 4)
    with pytest.raises(ModelError, match=message):
        with_followers(robot, rules)


@pytest.mark.parametrize("numbers", [(0.0,), (np.inf,), (1.0, np.nan)])
def test_rules_that_make_no_sense_are_refused(numbers):
    with pytest.raises(ModelError, match="a joint follows 'a'"):
        Mimic("a", *numbers)


def test_a_joint_follows_as_it_is_by_default_as_in_urdf():
    """http://wiki.ros.org/urdf/XML/joint: multiplier defaults to 1, offset to 0."""
    assert [Mimic("a").position(leader) for leader in (-0.7, 0.0, 1.3)] == [
        -0.7,
        0,
        1.3,
    ]


def test_jacobians_are_the_slopes_of_places():
    robot, step = _robot(1), 1e-6
    rng = np.random.default_rng(0)
    q, point = rng.uniform(-1.0, 1.0, (1, 3)), rng.normal(size=3)
    dq = rng.uniform(-1.0, 1.0, (1, 3))
    motion = frame_motion(robot, q, dq, frame=robot.link_names[-1], point=point)

    def place(x):
        return frame_motion(robot, x, frame=robot.link_names[-1], point=point).position

    slopes = [place(q + s) - place(q - s) for s in step * np.eye(3)]
    expected = np.stack(slopes, axis=-1) / (2.0 * step)
    assert np.allclose(motion.jacobian[:, :3], expected, rtol=0, atol=1e-8)
    step = 1e-4  # of a second difference
    second = place(q + step * dq) - 2.0 * place(q) + place(q - step * dq)
    assert np.allclose(motion.bias[:, :3], second / step**2, rtol=0, atol=1e-5)
    assert carrying_joints(robot, robot.link_names[2]) == ("j0", "j1")


def test_what_follows_a_locked_joint_is_locked_with_a_note(tmp_path, caplog):
    path = _written(tmp_path, '<mimic joint="slide" multiplier="-2" offset="0.1"/>')
    with caplog.at_level(logging.WARNING):
        robot = load_urdf(path, locked={"slide": 0.2})
    assert "'spin' follows one that does not move; it is locked at -0.3" in caplog.text
    expected = load_urdf(path, locked={"slide": 0.2, "spin": 0.1 - 2.0 * 0.2})
    assert robot.joint_names == expected.joint_names == ("turn",)
    assert np.allclose(robot.nominal, expected.nominal, rtol=0, atol=1e-14)


def test_of_many_that_follow_a_locked_joint_one_note_tells(tmp_path, caplog):
    finger = """<joint name="finger{0}" type="prismatic">
        <parent link="base"/> <child link="tip{0}"/> <axis xyz="0 1 0"/>
        <limit lower="0" upper="1" velocity="1" effort="1"/> {1}
      </joint> <link name="tip{0}"/>"""
    mimic = '<mimic joint="finger0" multiplier="{0}"/>'
    fingers = [finger.format(k, mimic.format(k) if k else "") for k in range(3)]
    path = tmp_path / "hand.urdf"
    path.write_text(
        '<robot name="hand"><link name="base"/>'
        '<joint name="wrist" type="revolute"> <parent link="base"/>'
        '<child link="palm"/> <limit lower="0" upper="1" velocity="1" effort="1"/>'
        f'</joint> <link name="palm"/> {"".join(fingers)}</robot>'
    )
    with caplog.at_level(logging.WARNING):
        robot = load_urdf(path, locked={"finger0": 0.2})
    assert robot.joint_names == ("wrist",)
    notes = [r.getMessage() for r in caplog.records if "follow" in r.getMessage()]
    assert notes == [
        "robot 'hand': 2 joints follow ones that do not move; locked: "
        "'finger1' at 0.2, 'finger2' at 0.4"
    ]


def test_what_follows_a_joint_of_another_branch_stands_as_at_its_zero():
    robot = _robot()
    part = chain(robot, base=robot.link_names[0])
    assert [joint.name for joint in part.joints] == ["j1", "j3", "j4"]
    assert part.links[0].merged[-1].name == robot.link_names[2]
    free = with_followers(robot, {"j4": RULES["j4"]})
    expected = chain(held(free, {"j2": 0.3}), base=robot.link_names[0])
    assert np.allclose(part.nominal, expected.nominal, rtol=0, atol=1e-14)


def test_a_follower_that_is_kept_needs_its_leader(tmp_path):
    path = _written(tmp_path, '<mimic joint="turn"/>')
    assert len(load_urdf(path, joints=["turn"]).joints) == 2
    with pytest.raises(ModelError, match="'spin' is kept, but follows 'turn'"):
        load_urdf(path, joints=["slide", "spin"])


def test_chains_of_followers_are_resolved(tmp_path):
    text = URDF.replace('<axis xyz="0 1 0"/>', '<mimic joint="slide" multiplier="3"/>')
    rule = '<axis xyz="0 -1 0"/><mimic joint="turn" multiplier="2" offset="0.5"/>'
    (tmp_path / "robot.urdf").write_text(text.replace('<axis xyz="0 -1 0"/>', rule))
    robot = load_urdf(tmp_path / "robot.urdf")
    assert robot.joint_names == ("turn",)
    assert [joint.mimic for joint in robot.joints[1:]] == [
        Mimic("turn", 2.0, 0.5),
        Mimic("turn", 6.0, 1.5),
    ]


def test_limits_leave_followers_in_their_range():
    robot = _robot()
    limits = {"j0": JointLimits(-2.0, 2.0, 3.0), "j2": JointLimits(-0.2, 0.5, 1.0)}
    joints = [replace(j, limits=limits.get(j.name, j.limits)) for j in robot.joints]
    first, *_ = limits_with_followers(joints)
    # -0.2 <= -0.5 q + 0.3 <= 0.5, and |-0.5 dq| <= 1
    assert np.allclose([first.lower, first.upper, first.velocity], [-0.4, 1.0, 2.0])
    joints[2] = replace(joints[2], limits=JointLimits(5.0, 6.0))
    with pytest.raises(ModelError, match=r"'j2' follows 'j0', but its range \[5, 6\]"):
        limits_with_followers(joints)
