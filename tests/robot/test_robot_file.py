"""A robot's file is URDF or MJCF: its root element decides, then its suffix."""

import numpy as np
import pytest
from robots import URDF

from consistent_id import ModelError, load_robot
from consistent_id.robot import load_mjcf, load_urdf

MJCF = """<!-- <robot> --><mujoco model="pendulum">
  <option gravity="1 2 3"/>
  <worldbody><body name="arm">
    <joint name="turn"/>
    <joint name="lift" type="slide"/>
    <geom size="0.1" mass="2" pos="0.3 0 0"/>
  </body></worldbody>
</mujoco>
"""


@pytest.mark.parametrize("name", ["robot.urdf", "robot.xml", "robot.URDF", "robot"])
def test_a_file_whose_root_is_robot_is_urdf_whatever_its_suffix(tmp_path, name):
    path = tmp_path / name
    path.write_text(URDF)
    robot, expected = load_robot(path), load_urdf(path)
    assert robot.joint_names == expected.joint_names
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]


@pytest.mark.parametrize("name", ["robot.xml", "robot.urdf"])
def test_a_file_whose_root_is_mujoco_is_mjcf_whatever_its_suffix(tmp_path, name):
    pytest.importorskip("mujoco")
    path = tmp_path / name
    path.write_text(MJCF)
    robot = load_robot(path)
    assert robot.joint_names == load_mjcf(path).joint_names == ("turn", "lift")
    assert robot.gravity.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(("name", "text"), [("a.urdf", URDF), ("a.xml", MJCF)])
def test_gravity_and_the_choice_of_joints_reach_both_formats(tmp_path, name, text):
    pytest.importorskip("mujoco")
    path = tmp_path / name
    path.write_text(text)
    first, *others = load_robot(path).joint_names
    held = load_robot(path, gravity=(4.0, 5.0, 6.0), locked={first: 0.2})
    assert held.joint_names == tuple(others)
    assert held.gravity.tolist() == [4.0, 5.0, 6.0]
    alone = load_robot(path, joints=[first])
    assert alone.joint_names == (first,)
    assert np.isfinite(alone.links[0].nominal.vector).all()


@pytest.mark.parametrize("name", ["robot.xml", "robot.urdf"])
def test_a_file_that_is_no_robot_or_not_there_is_refused_by_name(tmp_path, name):
    pytest.importorskip("mujoco")
    path = tmp_path / name
    with pytest.raises(ModelError, match=rf"{name}: cannot be read \(No such file"):
        load_robot(path)
    path.write_text("<robot><link")
    with pytest.raises(ModelError, match=name):
        load_robot(path)
