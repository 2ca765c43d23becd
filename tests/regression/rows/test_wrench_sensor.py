"""What hangs on a wrist sensor: Pinocchio says what it measures."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from consistent_id import (
    DHRow,
    InertialParameters,
    NotExcitedError,
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
    constrained_least_squares,
    from_modified_dh,
    least_squares,
)
from consistent_id.constraints import NonNegativeDrive, PhysicalConsistency
from consistent_id.recordings import Wrench
from consistent_id.recordings.beside import BaseMotion
from consistent_id.regression import (
    base_parameters,
    sensor_bias,
    sensor_motion,
    sensor_regression,
    static_poses,
    tool_model,
)

TOOL = InertialParameters.from_central(
    1.3, [0.02, -0.01, 0.08], [[4e-3, 1e-4, 0], [1e-4, 3e-3, 2e-4], [0, 2e-4, 2e-3]]
)
BIAS = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])
RIGHT = np.pi / 2


@pytest.fixture(scope="module")
def arm():
    rows = [DHRow(0, 0), DHRow(RIGHT, 0), DHRow(0, 0.5), DHRow(0, 0.4)]
    rows += [DHRow(RIGHT, 0, d=0.1), DHRow(-RIGHT, 0, d=0.1)]
    return from_modified_dh("arm", rows)


def measured(arm, q, dq, ddq):
    """The wrench on the tool, by Pinocchio: spatial motion of the last frame."""
    model = pin.Model()
    at = 0
    for joint in arm.joints:
        place = pin.SE3(joint.rotation, joint.translation)
        turning = pin.JointModelRevoluteUnaligned(joint.axis)
        at = model.addJoint(at, turning, place, joint.name)
    data = model.createData()
    body = pin.Inertia(TOOL.mass, TOOL.com, TOOL.central_inertia)
    found = []
    for state in zip(q, dq, ddq, strict=True):
        pin.forwardKinematics(model, data, *state)
        gravity = data.oMi[at].actInv(pin.Motion(arm.gravity, np.zeros(3)))
        v, a = data.v[at], data.a[at] - gravity
        wrench = body * a + v.cross(body * v)
        found.append(wrench.vector)
    return np.array(found)


def log_of(arm, samples, *, still=False, noise=0.0):
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.5, 1.5, (3, samples, len(arm)))
    if still:
        dq, ddq = 0 * dq, 0 * ddq
    values = measured(arm, q, dq, ddq) + BIAS + noise * rng.normal(size=(samples, 6))
    return Recording(
        arm.joint_names,
        0.01 * np.arange(samples),
        q,
        dq,
        ddq,
        wrenches=(Wrench("link6", values),),
    )


def test_the_tools_parameters_and_the_bias_are_recovered(arm):
    model = tool_model()
    assert len(base_parameters(model)) == 16
    regression = sensor_regression(model, arm, log_of(arm, 100), frame="link6")
    found = least_squares(model, regression)
    assert np.allclose(found.parameters, [*TOOL.vector, *BIAS], rtol=0, atol=1e-10)


@pytest.mark.slow
def test_with_noise_errors_are_what_they_are_said_to_be(arm):
    model = tool_model(nominal=TOOL)
    log = log_of(arm, 4000, noise=0.2)
    regression = sensor_regression(model, arm, log, frame="link6")
    found = least_squares(model, regression)
    off = (found.base_values - [*TOOL.vector, *BIAS]) / found.standard_errors
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.5)
    constraints = [PhysicalConsistency()]
    tool = constrained_least_squares(model, regression, constraints=constraints)
    assert tool.certificate.verdict == "certified"
    assert tool["tool.m"] == pytest.approx(TOOL.mass, rel=0.01)


def test_offsets_of_a_sensor_are_no_friction(arm):
    model = tool_model()
    regression = sensor_regression(model, arm, log_of(arm, 100), frame="link6")
    fit = least_squares(model, regression).fit
    assert fit.drive_share > 0.1
    assert np.isnan(fit.friction_share)


def test_poses_at_rest_tell_mass_and_centre_of_mass_but_no_inertia(arm):
    log = log_of(arm, 12, still=True)
    poses = static_poses(arm, log.position, log.wrenches[0].values, frame="link6")
    model = tool_model()
    regression = sensor_regression(model, arm, poses, frame="link6")
    found = least_squares(model, regression)
    known = [*range(4), *range(10, 16)]
    expected = np.array([*TOOL.vector, *BIAS])[known]
    assert np.allclose(found.parameters[known], expected, rtol=0, atol=1e-10)
    assert all(origin == "convention" for origin in found.origins[4:10])


def test_the_sensors_own_motion_is_that_of_its_frame(arm):
    log = log_of(arm, 5)
    motion = sensor_motion(arm, log, "link6")
    still = sensor_motion(arm, replace(log, velocity=None, acceleration=None), "link6")
    assert np.allclose(np.linalg.norm(still.specific_force, axis=1), 9.81)
    assert not still.angular_velocity.any()
    model = tool_model(bias=False)
    q = np.zeros((5, 0))
    found = model.predict(TOOL.vector, q, q, q, base=motion)
    states = log.position, log.velocity, log.acceleration
    assert np.allclose(found, measured(arm, *states), rtol=0, atol=1e-10)


def test_a_recording_without_the_wrench_is_refused(arm):
    log = replace(log_of(arm, 5), wrenches=())
    with pytest.raises(RecordingError, match="0 wrenches at 'link6'"):
        sensor_regression(tool_model(), arm, log, frame="link6")


def test_a_model_of_joints_alone_has_no_bias_of_a_base_wrench(arm):
    with pytest.raises(Exception, match="wrench_bias belongs to the sensor"):
        TorqueModel(arm, wrench_bias=True)


def test_biases_are_not_friction(arm):
    """A bias may be negative, whatever is said of friction."""
    model = tool_model()
    regression = sensor_regression(model, arm, log_of(arm, 100), frame="link6")
    constraints = [PhysicalConsistency(margin=0.0), NonNegativeDrive()]
    found = constrained_least_squares(model, regression, constraints=constraints)
    assert found["base.fy.bias"] == pytest.approx(-2.0, abs=1e-3)


def drifting(arm, samples, *, seed, rate, noise=0.0):
    """A log whose sensor starts anew, and drifts; and the bias at its start."""
    log = log_of(arm, samples)
    rng = np.random.default_rng(seed)
    start = BIAS * rng.uniform(-2.0, 2.0, 6)
    q, dq, ddq = rng.uniform(-1.5, 1.5, (3, samples, len(arm)))
    values = measured(arm, q, dq, ddq) + start + rate * log.time[:, None]
    values += noise * rng.normal(size=values.shape)
    log = Recording(
        arm.joint_names, log.time, q, dq, ddq, wrenches=(Wrench("link6", values),)
    )
    return log, start


@pytest.mark.parametrize(
    ("drift", "rate"), [("recordings", np.zeros(6)), ("linear", 3.0 * BIAS)]
)
def test_biases_that_drift_hide_nothing_of_the_tool(arm, drift, rate):
    pairs = [drifting(arm, 60, seed=k, rate=rate) for k in range(3)]
    logs, model = [log for log, _ in pairs], tool_model(bias=False)
    regression = sensor_regression(model, arm, logs, frame="link6", drift=drift)
    found = least_squares(model, regression)
    assert np.allclose(found.parameters, TOOL.vector, rtol=0, atol=1e-10)
    lost = {"recordings": 1, "linear": 2}[drift]
    assert regression.counts == (3 * (60 - lost),) * 6
    for log, start in pairs:
        bias = sensor_bias(
            model, found.parameters, arm, log, frame="link6", drift=drift
        )
        assert np.allclose(bias.start, start, rtol=0, atol=1e-9)
        assert np.allclose(bias.rate, rate, rtol=0, atol=1e-9)
    if drift == "recordings":  # what is largest beside each mean
        shown = [log.wrenches[0].values for log in logs]
        largest = np.max([abs(w - w.mean(axis=0)).max(axis=0) for w in shown], axis=0)
        assert np.allclose(regression.peaks, largest)
    # One bias for all does not hold.
    whole = tool_model()
    same = least_squares(whole, sensor_regression(whole, arm, logs, frame="link6"))
    assert abs(same.parameters[0] - TOOL.mass) > 0.01


def test_a_tool_that_changes_within_a_recording_scatters_between_its_blocks(arm):
    # In each tenth of the recording all forces are larger or smaller by its factor.
    model, noise = tool_model(bias=False), np.repeat([0.2, 0.01], 3)
    log, _ = drifting(arm, 1000, seed=0, rate=np.zeros(6), noise=noise)
    factor = 1.0 + 0.1 * np.repeat(np.random.default_rng(1).normal(size=10), 100)
    (wrench,) = log.wrenches
    changed = replace(wrench, values=wrench.values * factor[:, None])
    plain, between = (
        sensor_regression(model, arm, one, frame="link6", drift="recordings").noise
        for one in (log, replace(log, wrenches=(changed,)))
    )
    assert plain.beyond < 1.2 and between.beyond > 1.5


@pytest.mark.slow
def test_without_drift_rows_hold_what_a_bias_column_leaves(arm):
    """Frisch, Waugh and Lovell: the same estimate, errors and noise."""
    noise = np.repeat([0.2, 0.01], 3)  # of forces and moments
    log, _ = drifting(arm, 2000, seed=0, rate=np.zeros(6), noise=noise)
    free, biased = tool_model(bias=False), tool_model()
    rows = sensor_regression(free, arm, log, frame="link6", drift="recordings")
    whole = sensor_regression(biased, arm, log, frame="link6")
    one, other = least_squares(free, rows), least_squares(biased, whole)
    assert np.allclose(one.parameters, other.parameters[:10], rtol=0, atol=1e-10)
    # By noise alone: the median over parameters of blocks' scatter has the biases, too.
    own = one.standard_errors / np.sqrt(rows.noise.beyond)
    beside = other.standard_errors[:10] / np.sqrt(whole.noise.beyond)
    assert np.allclose(own, beside, rtol=0.02)
    assert rows.noise.beyond == pytest.approx(whole.noise.beyond, rel=0.1)


def test_a_bias_for_all_and_one_for_each_are_not_both(arm):
    with pytest.raises(ProblemError, match=r"give tool_model\(bias=False\)"):
        sensor_regression(
            tool_model(), arm, log_of(arm, 9), frame="link6", drift="recordings"
        )
    short = log_of(arm, 2)
    with pytest.raises(NotExcitedError, match="has 2 samples"):
        sensor_regression(
            tool_model(bias=False), arm, short, frame="link6", drift="linear"
        )


@pytest.mark.parametrize("mass", [0.0, 0.3, 2.0])
def test_the_tool_model_knows_mass_and_centre_of_a_tool_with_mass(mass):
    tool = InertialParameters.from_central(1.0, [0.1, 0.0, 0.2], 0.01 * np.eye(3))
    nominal = InertialParameters(mass * tool.vector)
    (link,) = tool_model(nominal=nominal).robot.links
    assert link.nominal is nominal
    if mass:
        assert link.datasheet.mass == mass
        np.testing.assert_allclose(link.datasheet.com, [0.1, 0.0, 0.2])
    else:
        assert link.datasheet.mass is None and link.datasheet.com is None


def test_the_bias_of_each_row_is_in_what_a_model_predicts():
    model, rng = tool_model("gripper"), np.random.default_rng(3)
    assert model.robot.gravity.tolist() == [0.0, 0.0, -9.81]
    w, dw, felt = rng.normal(size=(3, 5, 3))
    base, still = BaseMotion(w, dw, felt), np.zeros((5, 0))
    x = rng.normal(size=16)
    Y = model.regressor(still, still, still, base=base)
    found = model.predict(x, still, still, still, base=base)
    np.testing.assert_allclose(found, np.einsum("rcn,c->nr", Y, x), atol=1e-12)
