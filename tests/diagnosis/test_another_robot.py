"""Logs of another robot than the model, and faults that make no other robot."""

from dataclasses import replace

import numpy as np
import pytest
from known_arm import OTHER_ROWS, arm, logged
from spoilt_arm import FAULTS, LITTLE, factor_logs, faulty

from consistent_id import InertialParameters, TorqueModel, simulate_torque
from consistent_id.diagnosis import LogFinding, all_logs, diagnose
from consistent_id.diagnosis.all_logs import _without_wrong_gains
from consistent_id.diagnosis.another_robot import (
    _distance_of_loaded,
    of_usual_size,
    other_robot,
)
from consistent_id.diagnosis.factor_logs import (
    least_misfit,
)


@pytest.mark.slow
def test_the_log_of_a_robot_with_other_axes_is_another_robot_s():
    model, log = logged(5, spread=0.5, friction=LITTLE)
    assert other_robot(factor_logs(model, log)) == []
    (finding,) = other_robot(factor_logs(arm(OTHER_ROWS), log))
    assert (finding.kind, finding.severity) == ("another robot", "fault")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place", "size"), FAULTS)
def test_one_fault_makes_no_other_robot(kind, place, size):
    model, log = logged(6, spread=0.5)
    assert other_robot(factor_logs(*faulty(log, model, kind, place, size))) == []


@pytest.mark.slow
def test_a_diagnosis_names_another_robot_before_its_effects():
    _, log = logged(5, spread=0.5, friction=LITTLE)
    assert diagnose(arm(OTHER_ROWS), [log]).findings[0].kind == "another robot"


@pytest.mark.slow
def test_another_robot_is_a_note_where_the_unit_of_torque_is_one(monkeypatch):
    unit = LogFinding("torque unit", "note", "all joints", "in N cm", "state it", 1.0)
    monkeypatch.setattr(all_logs, "findings_of", lambda *given: [unit])
    _, log = logged(5, spread=0.5, friction=LITTLE)
    other, told = diagnose(arm(OTHER_ROWS), [log]).findings
    assert (other.kind, other.severity) == ("another robot", "note")
    assert told == replace(unit, recording=log.name)


@pytest.mark.slow
def test_torque_in_another_unit_makes_no_other_robot():
    model, log = logged(6, spread=0.5)
    far = factor_logs(model, replace(log, torque=1e3 * log.torque))
    assert other_robot(of_usual_size(far)) == []
    (other,) = other_robot(of_usual_size(factor_logs(arm(OTHER_ROWS), far.logs[0])))
    assert other.kind == "another robot"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "place", "size", "first"),
    [
        ("masses or gain", 0, np.log(100.0), {"torque gain", "torque unit"}),
        ("offset zero", 1, np.pi, {"offset zero"}),
        ("gravity", 0, np.pi, {"gravity"}),
    ],
)
def test_a_large_fault_that_explains_the_log_is_named_alone(kind, place, size, first):
    """However far bodies would be from the nominal ones without it."""
    model, log = logged(6, spread=0.5)
    model, log = faulty(log, model, kind, place, size)
    assert other_robot(factor_logs(model, log)) != []
    found = diagnose(model, [log]).findings
    assert found[0].kind in first
    assert all(f.kind != "another robot" for f in found)


@pytest.mark.slow
def test_the_torque_of_one_motor_in_front_of_its_gear_makes_no_other_robot():
    model, log = logged(6, spread=0.5)
    torque = log.torque / np.where(np.arange(log.torque.shape[1]) == 1, 80.0, 1.0)
    log = replace(log, torque=torque)
    assert other_robot(factor_logs(model, log)) != []
    found = diagnose(model, [log]).findings
    assert (found[0].kind, found[0].severity) == ("torque gain", "fault")
    assert all(f.kind != "another robot" for f in found)


def test_joints_with_a_wrong_gain_are_left_out_of_the_test_for_another_robot():
    model = arm()
    gain = LogFinding("torque gain", "fault", "joint2", "", "", 1.0, "log")
    # A fault of all joints, a doubt, another kind, and a fault of the nominal bodies.
    others = [
        replace(gain, where="all joints"),
        replace(gain, where="joint1", severity="warning"),
        replace(gain, where="joint3", kind="offset zero"),
        replace(gain, where="joint4", recording=""),
    ]
    left = _without_wrong_gains(model, [gain, *others])
    assert left.torque_joints == ("joint1", "joint3", "joint4")
    # Most gains are wrong by one cause, which may be another robot.
    more = [replace(gain, where=f"joint{k}") for k in (1, 2, 3)]
    assert len(_without_wrong_gains(model, more[:2]).torque_joints) == 2
    assert _without_wrong_gains(model, more) is model


@pytest.mark.slow
def test_a_load_of_negative_mass_explains_nothing():
    model, log = logged(5, spread=0.5)
    n = 10 * len(model.robot.links)
    last = np.zeros(n)
    last[-10] = 2.0
    lighter = _without_mass(model, log, last)
    assert np.isfinite(_distance_of_loaded(factor_logs(model, log)))
    assert _distance_of_loaded(factor_logs(model, lighter)) == np.inf


def _without_mass(model, log, bodies):
    """Return a log of a robot without some masses at its links' origins."""
    rigid = TorqueModel(model.robot)
    part = simulate_torque(rigid, bodies, replace(log, torque=None)).torque
    return replace(log, torque=log.torque - part)


@pytest.mark.slow
def test_a_clock_far_from_the_linear_makes_no_other_robot():
    model, log = logged(6, spread=0.1, noise=0.001)
    assert other_robot(factor_logs(*faulty(log, model, "clock", 0, np.log(8.0)))) == []


@pytest.mark.slow
def test_a_robot_on_the_wall_is_no_other_robot():
    """Bodies of any kind leave much unexplained there, but the nominal ones fit."""
    model, log = logged(10, spread=0.02, noise=0.0005)
    as_is = factor_logs(*faulty(log, model, "gravity", 1, np.radians(90.0)))
    assert least_misfit(as_is) > 0.2
    assert other_robot(as_is) == []


@pytest.mark.slow
def test_what_the_last_link_carries_makes_no_other_robot():
    """A large load and noise would, if the last link's body were taken for known."""
    model, log = logged(1, spread=0.5)
    load = InertialParameters.from_central(15.0, [0.3, 0.3, 0.4], 150.0 * np.eye(3))
    body = np.zeros(len(model.layout))
    body[30:40] = load.vector
    carrying = model.predict(body, log.position, log.velocity, log.acceleration)
    torque = log.torque + carrying
    noise = 0.11 * np.sqrt(np.mean(torque**2, axis=0))
    torque += noise * np.random.default_rng(0).normal(size=torque.shape)
    assert other_robot(factor_logs(model, replace(log, torque=torque))) == []
