"""Locked joints and chains: the torque of the whole robot, with the rest at rest."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from robots import URDF, random_robot, random_states

from consistent_id import DHRow, ModelError, TorqueModel, from_modified_dh
from consistent_id.robot import Datasheet, chain, held, load_urdf
from consistent_id.robot.chains import Selection, branches_with, selected
from consistent_id.robot.model import Mimic


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    return load_urdf(path)


def _torque(robot, states):
    return TorqueModel(robot).predict(robot.nominal, *states)


@pytest.mark.parametrize("seed", range(8))
def test_a_robot_with_joints_held_has_pinocchios_torque(seed):
    rng = np.random.default_rng(seed)
    model, robot = random_robot(rng, 7, tree=True)
    still = {f"j{k}": float(rng.normal()) for k in rng.permutation(7)[:3]}
    part = held(robot, still)
    moving = [int(name[1]) for name in part.joint_names]
    assert sorted([*part.joint_names, *still]) == [f"j{k}" for k in range(7)]
    states = random_states(rng, 4, 3)
    data = model.createData()
    for torque, *state in zip(_torque(part, states), *states, strict=True):
        whole = np.zeros((3, 7))
        whole[0] = [still.get(f"j{k}", 0.0) for k in range(7)]
        whole[:, moving] = state
        expected = pin.rnea(model, data, *whole)[moving]
        assert np.allclose(torque, expected, rtol=0, atol=1e-12 * abs(expected).max())


@pytest.mark.parametrize("base", range(4))
def test_what_a_base_carries_moves_as_on_the_whole_robot(base):
    rng = np.random.default_rng(base)
    _, robot = random_robot(rng, 7, tree=True)
    name = next(
        name
        for k, name in enumerate(robot.link_names)
        if any(joint.parent == k for joint in robot.joints)
    )
    part = chain(robot, base=name)
    places = [robot.joint_names.index(joint) for joint in part.joint_names]
    assert 0 < len(places) < 7
    states = random_states(rng, len(places), 4)
    whole = np.zeros((3, 4, 7))
    whole[:, :, places] = states
    expected = _torque(robot, whole)[:, places]
    assert np.allclose(_torque(part, states), expected, rtol=1e-10, atol=1e-10)


def test_the_chain_between_two_links_leaves_other_branches(robot):
    assert robot.joint_names == ("turn", "slide", "spin")
    assert chain(robot, base="one", tip="two").joint_names == ("slide",)
    assert chain(robot, base="one").joint_names == ("slide", "spin")
    assert chain(robot, base="base") is not None
    part = chain(robot, tip="tool")
    assert part.joint_names == ("turn", "slide")
    assert part.links[1].datasheet.mass == pytest.approx(1.5)  # without "three"


def test_fixed_links_are_found_where_they_are(robot, tmp_path):
    model = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"))
    (tool,) = robot.links[1].merged
    place = model.frames[model.getFrameId("tool")].placement
    assert tool.name == "tool"
    assert np.allclose(tool.rotation, place.rotation, atol=1e-12)
    assert np.allclose(tool.translation, place.translation, atol=1e-12)
    assert robot.carrier("tool") == robot.carrier("two") == 1
    assert robot.carrier("base") == -1
    assert [frame.name for frame in robot.ground] == ["base"]
    with pytest.raises(ModelError, match="no link named 'tol'; known: tool"):
        robot.carrier("tol")


def test_fixed_links_move_with_what_is_locked(robot, tmp_path):
    model = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"))
    q = np.array([0.0, 0.25, 1.0, 0.0])
    reduced = pin.buildReducedModel(model, [model.getJointId("slide")], q)
    part = held(robot, {"slide": 0.25})
    assert part.carrier("tool") == part.carrier("two") == part.carrier("one") == 0
    for frame in part.links[0].merged:
        place = reduced.frames[reduced.getFrameId(frame.name)].placement
        assert np.allclose(frame.rotation, place.rotation, atol=1e-10)
        assert np.allclose(frame.translation, place.translation, atol=1e-10)
    grounded = held(robot, {"turn": 0.0})
    assert {frame.name for frame in grounded.ground} == {"base", "one"}


def test_a_merged_links_datasheet_says_what_both_do():
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 1.0), DHRow(0, 1.0)])
    sheets = {
        "link1": Datasheet(mass=2.0, com=[0, 0, 0], mass_bounds=(1, 3)),
        "link2": Datasheet(mass=1.0, com=[0.5, 0, 0]),
    }
    one = held(arm.with_datasheet(sheets), {"joint2": 0.0}).links[0].datasheet
    assert (one.mass, one.mass_bounds) == (3.0, None)
    assert np.allclose(one.com, [0.5, 0, 0])
    two = held(arm.with_datasheet(sheets), {"joint3": 0.0}).links[1].datasheet
    assert (two.mass, two.com) == (None, None)  # nothing is known of link 3
    sheets["link3"] = Datasheet(mass=1.0)
    two = held(arm.with_datasheet(sheets), {"joint3": 0.0}).links[1].datasheet
    assert (two.mass, two.com) == (2.0, None)


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({"base": "x"}, "no link named 'x'"),
        ({"base": "three"}, "no moving joint between base 'three'"),
        ({"base": "two", "tip": "one"}, "no moving joint between"),
        ({"tip": "base"}, "no moving joint between"),
        (
            {"tip": "two", "joints": ["spin", "slide"]},
            "'spin' is kept, but is not",
        ),
    ],
)
def test_parts_that_are_none_are_refused(robot, wish, message):
    with pytest.raises(ModelError, match=message):
        selected(robot, Selection(**wish))


def test_a_joint_is_not_locked_in_degrees(robot):
    with pytest.raises(ModelError, match=r"locked at 90 rad.*degrees"):
        held(robot, {"turn": 90.0})


def test_branches_with_some_joints_leave_out_the_others():
    tree = from_modified_dh("tree", [DHRow(0.0, 0.1 * k) for k in range(5)])
    parents = (-1, 0, -1, 2, -1)
    joints = [replace(j, parent=p) for j, p in zip(tree.joints, parents, strict=True)]
    tree = replace(tree, joints=tuple(joints))
    part = branches_with(tree, ("joint4",))
    assert part.joint_names == ("joint3", "joint4")
    assert [joint.parent for joint in part.joints] == [-1, 0]
    assert part.link_names == ("link3", "link4")
    assert branches_with(tree, ("joint2", "joint3", "joint5")) is tree
    # A joint that another branch's joint follows is of the same branch.
    fifth = replace(joints[4], mimic=Mimic("joint2", 1.0, 0.0))
    coupled = replace(tree, joints=(*joints[:4], fifth))
    assert branches_with(coupled, ("joint1",)).link_names == ("link1", "link2", "link5")
