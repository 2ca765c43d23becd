"""Robot models, DH tables and parameter layouts."""

import numpy as np
import pytest

from consistent_id import (
    DHRow,
    DriveTerms,
    ModelError,
    ProblemError,
    RobotModel,
    TorqueModel,
    from_modified_dh,
)
from consistent_id.regression import joint_torque_regressor
from consistent_id.robot import Datasheet, Joint, JointLimits, Link, chain
from consistent_id.robot.parameters import ParameterLayout

ELBOW = from_modified_dh(
    "elbow", [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0.1), DHRow(0, 0.2)]
)


def _joint(name="a", parent=-1, **changes):
    values = {"rotation": np.eye(3), "translation": np.zeros(3), "axis": [0, 0, 1]}
    return Joint(name, changes.pop("kind", "revolute"), parent, **(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "helical"}, "kind 'helical'"),
        ({"axis": [0, 0, 0]}, "axis is zero"),
        ({"axis": [0, 0, np.inf]}, "inf"),
        ({"rotation": 2 * np.eye(3)}, "not orthonormal"),
        ({"rotation": np.diag([1, 1, -1])}, "reflection"),
        ({"translation": [0, 0]}, "shape"),
    ],
)
def test_joints_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ModelError, match=message):
        _joint(**changes)


def test_axes_are_made_unit_vectors():
    assert np.allclose(_joint(axis=[0, 3, 4]).axis, [0, 0.6, 0.8])


@pytest.mark.parametrize(
    ("joints", "links", "message"),
    [
        ((), (), "no moving joint"),
        ((_joint(),), (), "each joint moves one link"),
        ((_joint(), _joint()), (Link("x"), Link("y")), r"joint names repeat \['a'\]"),
        ((_joint(), _joint("b")), (Link("x"), Link("x")), "link names repeat"),
        ((_joint("a\nb"),), (Link("x"),), r"joint 'a\\nb' has a control character"),
        ((_joint(),), (Link("x\u2028"),), r"link 'x\\u2028' has a control character"),
        ((_joint(parent=0),), (Link("x"),), "comes before"),
    ],
)
def test_trees_that_are_none_are_refused(joints, links, message):
    with pytest.raises(ModelError, match=message):
        RobotModel("robot", joints, links)


@pytest.mark.parametrize(
    "limits", [{"lower": 1.0, "upper": -1.0}, {"velocity": -1.0}, {"effort": np.nan}]
)
def test_limits_that_make_no_sense_are_refused(limits):
    with pytest.raises(ModelError, match="joint limits"):
        JointLimits(**limits)


@pytest.mark.parametrize(
    "sheet",
    [
        {"mass": -1.0},
        {"mass": np.inf},
        {"mass_bounds": (2.0, 1.0)},
        {"com": [0, np.nan, 0]},
        {"com_box": [[0, 0, 1], [1, 1, 0]]},
    ],
)
def test_datasheets_that_make_no_sense_are_refused(sheet):
    with pytest.raises(ModelError, match="datasheet"):
        Datasheet(**sheet)


def test_datasheets_are_replaced_by_name_and_leave_the_model_alone():
    changed = ELBOW.with_datasheet({"link2": Datasheet(mass=3.0)})
    assert changed.links[1].datasheet.mass == 3.0
    assert ELBOW.links[1].datasheet.mass is None
    with pytest.raises(ModelError, match="no moving link named 'link9'; known: link"):
        ELBOW.with_datasheet({"link9": Datasheet()})


def test_a_chain_up_to_a_tip_drops_the_rest_and_keeps_its_torque():
    tree = RobotModel(
        "tree",
        (_joint("a"), _joint("b", 0, translation=[1, 0, 0]), _joint("c", 0)),
        (Link("x"), Link("y"), Link("z")),
    )
    assert chain(tree, tip="z").joint_names == ("a", "c")
    with pytest.raises(ModelError, match="no link named 'w'"):
        chain(tree, tip="w")
    state = np.random.default_rng(0).normal(size=(3, 4, 3))
    whole = joint_torque_regressor(ELBOW, *state)
    short = joint_torque_regressor(chain(ELBOW, tip="link2"), *state[:, :, :2])
    assert np.allclose(whole[:2, :20], short, atol=1e-13)


def test_right_angles_of_a_table_are_exact():
    joint = ELBOW.joints[1]
    assert set(abs(np.array(joint.rotation)).ravel()) == {0.0, 1.0}


def test_the_layout_names_parameters_and_suggests_near_ones():
    layout = TorqueModel(ELBOW, DriveTerms(viscous=True, offset=True)).layout
    assert len(layout) == 36
    assert layout.names[10:12] == ("link2.m", "link2.hx")
    assert layout.index("joint3.offset") == 35
    assert layout.units[layout.index("joint3.viscous")] == "N m s/rad"
    assert layout.drive_indices("offset") == (31, 33, 35)
    with pytest.raises(ProblemError, match=r"known: .*link2\.Ixx"):
        layout.index("link2.ixx")
    with pytest.raises(ProblemError, match="not unique"):
        ParameterLayout(("a",), (("a", "m"),), ("kg",))
