"""A path or another value in place of a robot, a log, an estimate or a model."""

import inspect
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints
from unittest.mock import Mock

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


WALKED = ("excitation", "export", "motion", "rollout")


def own_types(hint: Any) -> Iterator[type]:
    """Yield the package's types in an annotation; none if a text is such a value."""
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if str in parts:
        return
    for part in parts:
        if get_origin(part) in (Sequence, Iterable):
            (part,) = get_args(part)
        if inspect.isclass(part) and part.__module__.startswith("consistent_id."):
            yield part


def stand_in(hint: Any) -> Any:
    """Return something that passes as a value of an annotation, but is none."""
    own = list(own_types(hint))
    if not own:
        return Mock()
    value = Mock(spec=own[0])
    return [value] if get_origin(hint) in (Sequence, Iterable) else value


def arguments() -> list[Any]:
    """Return public functions with the names of their arguments that are our values."""
    found = []
    for room in WALKED:
        owner = import_module(f"consistent_id.{room}")
        for function in (getattr(owner, name) for name in owner.__all__):
            if not inspect.isfunction(function):
                continue
            hints = get_type_hints(inspect.unwrap(function))
            required = {
                name: hints[name]
                for name, given in inspect.signature(function).parameters.items()
                if given.default is given.empty and name in hints
            }
            for name, hint in required.items():
                if any(own_types(hint)):
                    words = f"{room}.{function.__name__}-{name}"
                    found.append(pytest.param(function, required, name, id=words))
    return found


def test_many_arguments_are_walked():
    assert len(arguments()) > 40


@pytest.mark.parametrize("wrong", ["a.csv", 3.0])
@pytest.mark.parametrize(("function", "hints", "name"), arguments())
def test_a_value_of_another_type_is_refused_by_name(function, hints, name, wrong):
    given = {key: stand_in(hint) for key, hint in hints.items()}
    if get_origin(hints[name]) is Iterable and wrong != "a.csv":
        wrong = [wrong]
    with pytest.raises(ci.ProblemError, match=r"a (str|float), expected an? "):
        function(**given | {name: wrong})


def test_a_robot_file_that_is_missing_is_no_model_for_replays(tmp_path):
    pytest.importorskip("mujoco")
    from consistent_id.recordings.signals import PDGains
    from consistent_id.rollout import replay_model

    with pytest.raises(ci.ModelError, match=r"leg\.xml: cannot be read"):
        replay_model(tmp_path / "leg.xml", ("hip",), PDGains(20.0, 1.0))
