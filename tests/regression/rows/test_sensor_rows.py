"""Rows of a wrench sensor by the joints of its arm: Pinocchio says what it measures."""

import numpy as np
import pinocchio as pin
import pytest

from consistent_id import (
    DHRow,
    InertialParameters,
    ModelError,
    ProblemError,
    TorqueModel,
    from_modified_dh,
)
from consistent_id.regression import SensorRows, base_parameters, tool_model
from consistent_id.robot import load_urdf

TOOL = InertialParameters.from_central(
    1.3, [0.02, -0.01, 0.08], [[4e-3, 1e-4, 0], [1e-4, 3e-3, 2e-4], [0, 2e-4, 2e-3]]
)
BIAS = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])
# A sensor that is turned and shifted on the last link, and a joint that slides.
URDF = """
<robot name="arm">
  <link name="base"/><link name="upper"/><link name="rod"/><link name="hand"/>
  <link name="sensor"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="upper"/>
    <origin xyz="0.1 0 0.3" rpy="0.3 0.2 0"/><axis xyz="0 1 0"/></joint>
  <joint name="slide" type="prismatic"><parent link="upper"/><child link="rod"/>
    <origin xyz="0 0.2 0.1" rpy="0 0 0.5"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
  <joint name="roll" type="continuous"><parent link="rod"/><child link="hand"/>
    <origin xyz="0.3 0 0" rpy="0.1 0 0"/><axis xyz="0.6 0 0.8"/></joint>
  <joint name="mount" type="fixed"><parent link="hand"/><child link="sensor"/>
    <origin xyz="0.05 -0.02 0.1" rpy="0.4 -0.3 0.7"/></joint>
</robot>
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture(scope="module")
def rows(file):
    return SensorRows(tool_model("gripper"), load_urdf(file), "sensor")


def measured(file, q, dq, ddq):
    """Return the wrench on the tool, by Pinocchio, and the sensor's bias."""
    model = pin.buildModelFromUrdf(str(file))
    data, frame = model.createData(), model.getFrameId("sensor")
    body = pin.Inertia(TOOL.mass, TOOL.com, TOOL.central_inertia)
    found = []
    for state, rate, push in zip(q, dq, ddq, strict=True):
        # a joint that turns without end is a point on a circle
        at = np.array([np.cos(state[0]), np.sin(state[0]), state[1]])
        at = np.append(at, [np.cos(state[2]), np.sin(state[2])])
        pin.forwardKinematics(model, data, at, rate, push)
        pin.updateFramePlacements(model, data)
        v = pin.getFrameVelocity(model, data, frame)
        a = pin.getFrameAcceleration(model, data, frame)
        down = data.oMf[frame].actInv(pin.Motion(model.gravity.linear, np.zeros(3)))
        found.append((body * (a - down) + v.cross(body * v)).vector)
    return np.array(found) + BIAS


def test_rows_of_a_sensor_are_what_it_measures(file, rows):
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 12, 3))
    said = np.einsum(
        "jps,p->sj", rows.regressor(q, dq, ddq), np.append(TOOL.vector, BIAS)
    )
    assert said == pytest.approx(measured(file, q, dq, ddq), abs=1e-10)


def test_expressions_of_the_rows_are_the_rows(rows):
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, 5, 3))
    expression, Y = rows.casadi(), rows.regressor(q, dq, ddq)
    for k in range(len(q)):
        one = expression(q[k], dq[k], ddq[k]).full()
        assert one == pytest.approx(Y[:, :, k], abs=1e-12)


def test_rows_come_in_pieces_and_by_columns(rows):
    q, dq, ddq = np.random.default_rng(2).normal(size=(3, 7, 3))
    Y = rows.regressor(q, dq, ddq)
    for part, block in rows.chunks(q, dq, ddq, 3):
        assert np.array_equal(block, Y[:, :, part])
    kept = [np.array([0, 2])] * 6
    ((_, blocks),) = rows.kept_chunks(kept, q, dq, ddq)
    assert np.allclose(blocks[3][:, :2], Y[3, [0, 2]].T)


def test_an_arm_that_turns_the_tool_every_way_tells_all_of_it(rows):
    assert len(base_parameters(rows)) == 16


def test_an_arm_with_upright_axes_tells_no_inertia_about_level_ones():
    """Gravity stays along z: nothing tips the tool."""
    scara = from_modified_dh("scara", [DHRow(0, 0), DHRow(0, 0.4), DHRow(0, 0.3)])
    base = base_parameters(SensorRows(tool_model("gripper"), scara, "link3"))
    assert set(base.without_effect) == {f"gripper.I{ij}" for ij in ("xx", "xy", "yy")}
    assert len(base) == 13


def test_what_is_no_tool_or_no_arm_is_refused(rows, file):
    arm = rows.arm
    with pytest.raises(ProblemError, match="build it with tool_model"):
        SensorRows(TorqueModel(arm), arm, "sensor")
    with pytest.raises(ProblemError, match="its base floats"):
        SensorRows(tool_model(), load_urdf(file, base="floating"), "sensor")
    with pytest.raises(ModelError, match="does not move"):
        SensorRows(tool_model(), arm, "base")
