"""A path or another value in place of a robot, a log, an estimate or a model."""

from functools import partial

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.service import MomentumObserver, control_model

ARM = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
MODEL = ci.TorqueModel(ARM, ci.DriveTerms(viscous=True))


@pytest.fixture(scope="module")
def log():
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    return ci.simulate_torque(MODEL, [*body, 0.4], motion)


@pytest.fixture(scope="module")
def estimate(log):
    return ci.least_squares(MODEL, ci.build_regression(MODEL, log))


ROBOT = r"a str, expected a RobotModel; load_robot\('arm.urdf'\)"
ESTIMATE = r"a str, expected an Estimate; open_results\("
LOG = r"a str, expected a Recording; read_recording\('a.csv'\)"


@pytest.mark.parametrize(
    ("function", "given", "said"),
    [
        (ci.motion_limits, "arm.urdf", ROBOT),
        (ci.design_trajectory, "arm.urdf", ROBOT),
        (ci.to_urdf, "arm.urdf", ESTIMATE),
        (ci.to_mjcf, "arm.urdf", ESTIMATE),
        (control_model, "arm.urdf", ESTIMATE),
        (MomentumObserver, "arm.urdf", r"a str, expected a ControlModel; control_mod"),
    ],
)
def test_a_path_is_answered_with_the_call_that_reads_it(function, given, said):
    with pytest.raises(ci.ProblemError, match=said):
        function(given)


def test_paths_in_place_of_logs_and_estimates_are_refused(estimate, log):
    for call in (
        estimate.predict,
        estimate.score,
        partial(ci.build_regression, MODEL),
        partial(ci.huber, MODEL),
        partial(ci.diagnose, MODEL),
        ci.trimmed,
        ci.differentiated,
        partial(ci.low_passed, motion_cutoff=5.0),
        partial(ci.resampled, rate=50.0),
        partial(ci.simulate_torque, MODEL, np.ones(11)),
    ):
        with pytest.raises(ci.ProblemError, match=LOG):
            call("a.csv")
    with pytest.raises(ci.ProblemError, match=LOG):
        ci.compare([estimate], ["a.csv"])
    with pytest.raises(ci.ProblemError, match=LOG):
        ci.compare([estimate], [log], training=["a.csv"])
    with pytest.raises(ci.ProblemError, match=ESTIMATE):
        ci.compare(["results"], [log])


def test_a_robot_is_no_torque_model_and_a_log_no_regression(log):
    regression = ci.build_regression(MODEL, log)
    model = r"model: a RobotModel, expected a TorqueModel; TorqueModel\(robot\) makes"
    for call, given in (
        (ci.build_regression, log),
        (ci.huber, log),
        (ci.diagnose, log),
        (ci.least_squares, regression),
        (ci.constrained_least_squares, regression),
        (ci.uncertainty, [regression]),
    ):
        with pytest.raises(ci.ProblemError, match=model):
            call(ARM, given)
    rows = r"a Recording, expected a Regression; build_regression\(model, recordings\)"
    for fit in (ci.least_squares, ci.constrained_least_squares):
        with pytest.raises(ci.ProblemError, match=rows):
            fit(MODEL, log)


def test_one_value_in_place_of_a_list_is_refused(estimate, log):
    with pytest.raises(ci.ProblemError, match="an Estimate, expected a list of Estim"):
        ci.compare(estimate, [log])
    with pytest.raises(ci.ProblemError, match="a Recording, expected a list of Record"):
        ci.compare([estimate], log)


def test_values_without_a_path_are_answered_with_the_same_call():
    with pytest.raises(ci.ProblemError, match=r"a dict, .*; load_robot\(PATH\) reads"):
        ci.motion_limits({})
