"""URDF: Pinocchio as the truth, and every fault with its line."""

import os
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robots import URDF as ROBOT

from consistent_id import ModelError, TorqueModel
from consistent_id.regression import joint_torque_regressor
from consistent_id.robot import load_urdf
from consistent_id.robot.model import JointLimits


def _written(tmp_path, text):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return path


def _states(reference, samples, seed=0):
    """States for the package, and configurations as Pinocchio wants them."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = rng.uniform(-1.5, 1.5, (3, samples, reference.nv))
    configurations = []
    for row in q:
        parts = [
            [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            for x, joint in zip(row, list(reference.joints)[1:], strict=True)
        ]
        configurations.append(np.concatenate(parts))
    return (q, dq, ddq), configurations


def _assert_same_regressor(robot, reference, relative):
    data = reference.createData()
    (q, dq, ddq), configurations = _states(reference, 5)
    Y = joint_torque_regressor(robot, q, dq, ddq)
    for s, configuration in enumerate(configurations):
        expected = pin.computeJointTorqueRegressor(
            reference, data, configuration, dq[s], ddq[s]
        )
        assert abs(Y[:, :, s] - expected).max() <= relative * abs(expected).max()


def test_the_loaded_robot_is_pinocchios(tmp_path):
    path = _written(tmp_path, ROBOT)
    robot, reference = load_urdf(path), pin.buildModelFromUrdf(str(path))
    # 1.57079632679 is taken for a right angle: the rotation is off by 5e-12.
    _assert_same_regressor(robot, reference, 1e-10)
    assert robot.joint_names == tuple(reference.names)[1:]
    assert sorted(robot.link_names) == ["one", "three", "two"]
    for link, inertia in zip(robot.links, list(reference.inertias)[1:], strict=True):
        assert np.allclose(
            link.nominal.vector, inertia.toDynamicParameters(), atol=1e-12
        )
        assert link.datasheet.mass == pytest.approx(inertia.mass)


def test_limits_are_those_stated_and_infinite_where_none_are(tmp_path):
    robot = load_urdf(_written(tmp_path, ROBOT))
    limits = {joint.name: joint.limits for joint in robot.joints}
    turn, spin = limits["turn"], limits["spin"]
    assert (turn.lower, turn.upper, turn.velocity, turn.effort) == (-2, 1.5, 3, 50)
    assert (spin.lower, spin.upper, spin.velocity) == (-np.inf, np.inf, np.inf)
    assert {j.name: j.kind for j in robot.joints} == {
        "turn": "revolute",
        "slide": "prismatic",
        "spin": "continuous",
    }


@pytest.mark.parametrize("missing", ["velocity", "effort", "both"])
def test_limits_of_speed_and_effort_are_not_demanded(tmp_path, missing, caplog):
    gone = {"velocity": 'velocity="3" ', "effort": ' effort="50"'}
    text = ROBOT
    for key in gone if missing == "both" else [missing]:
        assert gone[key] in text
        text = text.replace(gone[key], "")
    robot = load_urdf(_written(tmp_path, text))
    limits = next(joint.limits for joint in robot.joints if joint.name == "turn")
    speed = np.inf if missing in ("velocity", "both") else 3.0
    effort = np.inf if missing in ("effort", "both") else 50.0
    assert (limits.lower, limits.upper) == (-2.0, 1.5)
    assert (limits.velocity, limits.effort) == (speed, effort)
    assert "read as unlimited" in caplog.text


def test_the_chain_to_a_tip_can_be_loaded_alone(tmp_path):
    path = _written(tmp_path, ROBOT)
    assert load_urdf(path, tip="one").joint_names == ("turn",)


LOCKED = {"slide": 0.3}


def test_a_locked_joint_stands_where_it_is_told(tmp_path):
    path = _written(tmp_path, ROBOT)
    whole, robot = load_urdf(path), load_urdf(path, locked=LOCKED)
    assert robot.joint_names == ("turn", "spin")
    assert robot.link_names == ("one", "three")
    q, dq, ddq = np.random.default_rng(4).uniform(-1.5, 1.5, (3, 6, 2))
    places = [whole.joint_names.index(name) for name in robot.joint_names]
    states = [np.zeros((6, 3)) for _ in range(3)]
    for mine, state in zip(states, (q, dq, ddq), strict=True):
        mine[:, places] = state
    states[0][:, whole.joint_names.index("slide")] = 0.3
    expected = TorqueModel(whole).predict(whole.nominal, *states)[:, places]
    torque = TorqueModel(robot).predict(robot.nominal, q, dq, ddq)
    # 1.57079632679 is taken for a right angle in one of the two: off by 5e-12.
    assert np.allclose(torque, expected, rtol=0, atol=1e-10 * abs(expected).max())


def test_the_body_on_a_locked_joint_is_merged_into_its_parent(tmp_path):
    path = _written(tmp_path, ROBOT)
    robot, whole = load_urdf(path, locked=LOCKED), load_urdf(path)
    masses = {link.name: link.datasheet.mass for link in robot.links}
    assert masses == pytest.approx({"one": 2.0 + 1.0 + 0.5, "three": 0.7})
    slide, one, two = whole.joints[1], *whole.links[:2]
    place = slide.translation + slide.rotation @ slide.axis * LOCKED["slide"]
    merged = one.nominal + two.nominal.transformed(slide.rotation, place)
    assert np.allclose(robot.links[0].nominal.vector, merged.vector, atol=1e-10)
    assert np.allclose(robot.links[0].datasheet.com, merged.com, atol=1e-10)


def test_joints_that_are_not_kept_are_locked_at_zero(tmp_path):
    path = _written(tmp_path, ROBOT)
    kept = load_urdf(path, joints=["turn", "spin"])
    told = load_urdf(path, locked={"slide": 0.0})
    assert kept.joint_names == told.joint_names == ("turn", "spin")
    assert np.array_equal(kept.nominal, told.nominal)


def test_a_continuous_joint_is_locked_at_an_angle(tmp_path):
    path = _written(tmp_path, ROBOT)
    robot = load_urdf(path, locked={"spin": 0.4})
    turned = load_urdf(path)
    c, s = np.cos(0.4), np.sin(0.4)
    body = turned.links[2].nominal.transformed(
        [[c, 0, s], [0, 1, 0], [-s, 0, c]], np.zeros(3)
    )
    merged = turned.links[1].nominal + body
    assert np.allclose(robot.links[1].nominal.vector, merged.vector, atol=1e-12)


def test_a_mimic_joint_may_be_locked(tmp_path):
    text = ROBOT.replace('<axis xyz="0 1 0"/>', '<mimic joint="turn"/>')
    robot = load_urdf(_written(tmp_path, text), joints=["turn", "slide"])
    assert robot.joint_names == ("turn", "slide")


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({"locked": {"slid": 0.0}}, "no joint 'slid' .*slide"),
        ({"joints": ["trun"]}, "no joint 'trun' .*turn"),
        ({"joints": ["turn"], "locked": {"turn": 0.0}}, "both kept and locked"),
        ({"locked": {"slide": np.nan}}, "'slide' is locked at nan"),
        ({"locked": dict.fromkeys(("turn", "slide", "spin"), 0.0)}, "nothing moves"),
    ],
)
def test_locks_that_make_no_sense_are_refused(tmp_path, wish, message):
    with pytest.raises(ModelError, match=message):
        load_urdf(_written(tmp_path, ROBOT), **wish)


@pytest.mark.parametrize("text", ["", "not xml", "<sdf/>", "\x00\x01"])
def test_what_is_no_urdf_is_refused(tmp_path, text):
    with pytest.raises(ModelError, match=r"robot\.urdf"):
        load_urdf(_written(tmp_path, text))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.urdf: cannot be read"):
        load_urdf(tmp_path / "nowhere.urdf")


def test_the_real_ur10e_is_pinocchios():
    if "CONSISTENT_ID_DATASETS" not in os.environ:
        pytest.skip("CONSISTENT_ID_DATASETS does not name the folder of recordings")
    path = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "ur10e" / "ur10e.urdf"
    robot, reference = load_urdf(path), pin.buildModelFromUrdf(str(path))
    assert len(robot) == 6
    _assert_same_regressor(robot, reference, 1e-10)  # right angles again


@pytest.mark.parametrize("comment", ["", "<!-- a comment -->"])
def test_a_joint_without_limits_is_read_as_unlimited(tmp_path, caplog, comment):
    limit = '<limit lower="0" upper="0.4" velocity="1" effort="20"/>'
    assert limit in ROBOT
    robot = load_urdf(_written(tmp_path, ROBOT.replace(limit, comment)))
    assert (
        "joint 'slide': a prismatic joint needs <limit>; it is read as" in caplog.text
    )
    kept = load_urdf(_written(tmp_path, ROBOT))
    assert robot.joint_names == kept.joint_names
    assert np.array_equal(robot.nominal, kept.nominal)
    for mine, other in zip(robot.joints, kept.joints, strict=True):
        if mine.name == "slide":
            assert mine.kind == "prismatic"
            assert mine.limits == JointLimits()
        else:
            assert mine.limits == other.limits
