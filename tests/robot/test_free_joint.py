"""A base that floats: which files and selections give one, and what they refuse."""

import numpy as np
import pytest
from quadrupeds import quadruped_text

from consistent_id import ModelError, ProblemError, TorqueModel
from consistent_id.problems.stated_model import base_question
from consistent_id.recordings import BaseMotion
from consistent_id.regression import BASE_ROWS, base_parameters
from consistent_id.robot import load_mjcf, load_urdf
from consistent_id.robot.model import Joint, Link, RobotModel


@pytest.fixture
def quadruped(tmp_path):
    def write(joint="<freejoint/>"):
        path = tmp_path / "robot.xml"
        path.write_text(quadruped_text(joint))
        return path

    return write


@pytest.mark.parametrize("joint", ["<freejoint/>", ""])
def test_the_base_of_an_mjcf_robot_floats_when_it_is_said_to(quadruped, joint):
    robot = load_mjcf(quadruped(joint), base="floating")
    assert robot.floating
    assert robot.link_names[0] == "trunk"
    assert len(robot) == 12
    assert robot.links[0].nominal.mass == 7.0


@pytest.mark.slow
def test_ranks_of_a_quadruped_are_known(quadruped):
    """Three links with parallel second and third axes: 17 parameters with held trunk.

    Of a floating one, the base's ten and 21 for each leg: 30 less nine, as the first
    joint's axis shares seven parameters with the trunk and the parallel pair two less.
    """
    held = TorqueModel(load_mjcf(quadruped(), base="trunk"))
    floating = TorqueModel(load_mjcf(quadruped(), base="floating"))
    of_base = TorqueModel(floating.robot, torque_joints=BASE_ROWS)
    ranks = [len(base_parameters(model)) for model in (held, floating, of_base)]
    assert ranks == [4 * 17, 10 + 4 * 21, 10 + 4 * 21]


def test_a_free_joint_is_asked_about_where_the_base_is_not_said_to_float(quadruped):
    with pytest.raises(ModelError, match="'floating'"):
        load_mjcf(quadruped())


def test_motion_without_the_base_is_refused(quadruped):
    robot = load_mjcf(quadruped(), base="floating")
    with pytest.raises(ProblemError, match="base floats, but how it moves"):
        TorqueModel(robot).regressor(*np.zeros((3, 1, 12)))


def test_held_still_a_floating_robot_is_the_fixed_one(quadruped):
    """The same joint torques, and the base's weight besides."""
    floating = load_mjcf(quadruped(), base="floating")
    fixed = load_mjcf(quadruped(), base="trunk")
    # The world's axes are turned against the trunk's, about the vertical.
    states = np.random.default_rng(0).uniform(-1, 1, (3, 5, 12))
    base = BaseMotion.at_rest(5)
    found = TorqueModel(floating).predict(floating.nominal, *states, base=base)
    expected = TorqueModel(fixed).predict(fixed.nominal, *states)
    assert np.allclose(found[:, 6:], expected, rtol=0, atol=1e-12)
    still = TorqueModel(floating).predict(
        floating.nominal, states[0], 0 * states[1], 0 * states[2], base=base
    )
    mass = sum(link.nominal.mass for link in floating.links)
    assert np.allclose(still[:, :3], [0, 0, 9.81 * mass], rtol=0, atol=1e-12)


def test_all_joints_locked_leave_one_body_that_floats(quadruped):
    joints = load_mjcf(quadruped(), base="floating").joint_names
    whole = load_mjcf(quadruped(), base="floating", locked=dict.fromkeys(joints, 0.0))
    assert whole.link_names == ("trunk",)
    assert np.isclose(whole.links[0].nominal.mass, 7 + 4 * 2.3)
    assert len(base_parameters(TorqueModel(whole))) == 10


def test_a_chain_from_a_link_on_stands_still(quadruped):
    fixed = load_mjcf(quadruped(), base="a_hip")
    assert not fixed.floating
    assert fixed.joint_names == ("a_pitch", "a_knee")


def test_a_link_that_is_called_floating_is_a_base(tmp_path):
    path = tmp_path / "arm.urdf"
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    joint = (
        '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/>'
        '<axis xyz="0 0 1"/></joint>'
    )
    path.write_text(
        '<robot name="arm"><link name="root"/>'
        f'<link name="floating">{inertial}</link><link name="tip">{inertial}</link>'
        + joint.format("one", "root", "floating")
        + joint.format("two", "floating", "tip")
        + "</robot>"
    )
    robot = load_urdf(path, base="floating")
    assert robot.joint_names == ("two",)
    assert not robot.floating


def test_a_free_joint_beyond_the_base_is_refused():
    free = Joint("loose", "free", -1, np.eye(3), np.zeros(3), [0, 0, 1])
    hinge = Joint("hinge", "revolute", -1, np.eye(3), np.zeros(3), [0, 0, 1])
    with pytest.raises(ModelError, match="only the first joint"):
        RobotModel("odd", (hinge, free), (Link("a"), Link("b")))
    with pytest.raises(ModelError, match="only the base"):
        Joint("loose", "free", 0, np.eye(3), np.zeros(3), [0, 0, 1])


def test_a_fixed_trunk_with_legs_is_asked_about(quadruped):
    (question,) = base_question(load_mjcf(quadruped(), base="trunk"))
    assert "4 limbs" in question
    assert base_question(load_mjcf(quadruped(), base="floating")) == ()
    assert base_question(load_mjcf(quadruped(), base="trunk", tip="a_calf")) == ()
