"""Limits of torque as a real robot has them: friction, heat, rates, currents."""

import numpy as np
import pytest
from excited import arm, arm_limits

from consistent_id import ProblemError, TorqueModel, design_trajectory
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.verification import FRICTION_SHARE, demands


def _limited(robot, **given):
    effort = dict.fromkeys(robot.joint_names, 50.0)
    return arm_limits(robot, effort=effort, **given)


def test_a_share_of_the_effort_is_left_for_friction_that_is_not_known():
    robot = arm(2)
    model, limits = TorqueModel(robot), _limited(robot)
    required = demands(model, limits)
    left = (1.0 - FRICTION_SHARE) * limits.effort
    np.testing.assert_allclose(required.limits.effort, left)
    assert "30 % of the limits is left" in required.torque_of
    assert any("--parameters" in note for note in required.notes)
    # Parameters know their friction: nothing is left for it.
    known = demands(model, limits, robot.nominal)
    np.testing.assert_allclose(known.limits.effort, limits.effort)
    assert demands(model, limits, friction_share=0.0).limits.effort[0] == 50.0
    with pytest.raises(ProblemError, match="friction_share is 1"):
        demands(model, limits, friction_share=1.0)


def test_a_current_limits_torque_by_the_constant_of_the_joint():
    limits = _limited(arm(2))
    one = limits.with_currents({"joint1": 3.0}, 12.0)
    assert one.effort.tolist() == [36.0, 50.0]
    both = limits.with_currents([3.0, 9.0], [12.0, 12.0])
    assert both.effort.tolist() == [36.0, 50.0]
    assert limits.with_currents(None, None) is limits
    with pytest.raises(ProblemError, match="limits: torque_constant is missing"):
        limits.with_currents(3.0, None)
    with pytest.raises(ProblemError, match="no joint 'jiont1'"):
        limits.with_currents({"jiont1": 1.0}, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["effort_rms", "effort_rate"])
def test_a_design_keeps_what_is_demanded_of_torque_over_time(quantity):
    """Eight tenths of what the design reaches without the limit are kept with it."""
    robot = arm(2)
    model, parameters = TorqueModel(robot), robot.nominal

    def designed(limits):
        return design_trajectory(
            robot, PathForm(5.0, 3), Aim(noise=0.02), limits=limits,
            parameters=parameters, starts=1, workers=1, time_limit=60.0,
        )  # fmt: skip

    def reached(design):
        path = design.trajectory
        time = np.linspace(0.0, path.duration, 20_001)
        torque = model.predict(parameters, *path.evaluate(time))
        if quantity == "effort_rms":
            return np.sqrt((torque**2).mean(axis=0))
        return abs(np.gradient(torque, time, axis=0)[1:-1]).max(axis=0)

    free = reached(designed(_limited(robot)))
    allowed = dict(zip(robot.joint_names, 0.8 * free, strict=True))
    kept = designed(_limited(robot, **{quantity: allowed}))
    assert kept.proof.holds
    assert (reached(kept) <= 0.8 * free).all()
    assert (reached(kept) > 0.4 * free).any()
