"""Joints whose torque is not known: they move, and have no row."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from robots import random_states

from consistent_id import (
    ProblemError,
    build_regression,
    compare,
    constrained_least_squares,
    huber,
    least_squares,
    simulate_torque,
)
from consistent_id.regression import base_parameters, casadi_regressor, tool_model
from consistent_id.regression.row_names import rows_in_order

FULL, TRUTH, LOG = experiment(3, joints=4, samples=400)
FIRST, LAST = FULL.robot.joint_names[0], FULL.robot.joint_names[2]
MODEL = replace(FULL, torque_joints=(LAST, FIRST))
ROWS = [0, 2]


def test_the_rows_are_those_of_the_joints_named_in_the_robots_order():
    assert MODEL.torque_joints == (FIRST, LAST)
    assert MODEL.layout == FULL.layout
    states = random_states(np.random.default_rng(0), 4, 20)
    whole = FULL.regressor(*states)
    assert np.array_equal(MODEL.regressor(*states), whole[ROWS])
    assert np.array_equal(
        MODEL.predict(TRUTH, *states), FULL.predict(TRUTH, *states)[:, ROWS]
    )
    function = casadi_regressor(MODEL)
    for s, state in enumerate(zip(*states, strict=True)):
        Y = function(*state).full()
        assert np.allclose(Y, whole[ROWS, :, s], rtol=0, atol=1e-12 * abs(Y).max())


def test_all_joints_have_a_row_unless_told_otherwise():
    assert FULL.torque_joints == FULL.robot.joint_names
    assert replace(MODEL, torque_joints=()).fingerprint == FULL.fingerprint
    assert MODEL.fingerprint != FULL.fingerprint


def test_a_simulated_recording_has_the_torques_of_all_joints():
    mine = simulate_torque(MODEL, TRUTH, LOG)
    assert np.array_equal(mine.torque, simulate_torque(FULL, TRUTH, LOG).torque)


def test_the_regression_has_the_factors_of_these_joints():
    regression, whole = build_regression(MODEL, LOG), build_regression(FULL, LOG)
    assert regression.joints == (FIRST, LAST)
    assert regression.counts == (400, 400)
    for mine, row in zip(regression.factors, ROWS, strict=True):
        gram = whole.factors[row].T @ whole.factors[row]
        assert np.allclose(mine.T @ mine, gram, rtol=0, atol=1e-12 * abs(gram).max())


@pytest.mark.slow
@pytest.mark.parametrize("estimate", [least_squares, constrained_least_squares, huber])
def test_what_the_other_columns_hold_is_of_no_account(estimate):
    torque = LOG.torque.copy()
    torque[:, [1, 3]] = 1e6
    values = []
    for log in (LOG, replace(LOG, torque=torque)):
        data = log if estimate is huber else build_regression(MODEL, log)
        options = {"constraints": ()} if estimate is constrained_least_squares else {}
        values.append(estimate(MODEL, data, **options).parameters)
    assert np.array_equal(*values)


def test_what_the_known_torques_determine_is_recovered():
    base = base_parameters(MODEL)
    assert len(base) < len(base_parameters(FULL))
    silent = f"{FULL.robot.joint_names[1]}.viscous"
    assert silent in base.without_effect
    estimate = least_squares(MODEL, build_regression(MODEL, LOG), base=base)
    truth = base.projection @ TRUTH
    assert np.allclose(estimate.base_values, truth, rtol=0, atol=1e-7)
    (report,) = compare([estimate], [LOG]).reports
    assert report.validation[0].rms.shape == (2,)
    assert report.validation[0].stacked < 1e-9


def test_a_name_that_no_joint_has_is_refused():
    with pytest.raises(ProblemError, match="torque_joints: no joint 'elbow'"):
        replace(FULL, torque_joints=("elbow",))


def test_rows_of_one_body_alone_may_be_given_by_others():
    body = tool_model("gripper").robot
    assert body.connected and not body.joint_names
    assert rows_in_order(("left", "right"), body) == ("left", "right")
    assert rows_in_order(("base.nx", "base.fx"), body) == ("base.fx", "base.nx")
    with pytest.raises(ProblemError, match="torque_joints: no joint"):
        rows_in_order(("base.fx", "left"), body)
