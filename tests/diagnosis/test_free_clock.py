"""The clock beside free bodies: no nominal body tells how fast it runs."""

import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from faulty_logs import DRIVE, at_samples, clean_log
from faulty_logs import arm as other_arm
from known_arm import arm, logged, slow_log

from consistent_id import InertialParameters
from consistent_id._support import executors
from consistent_id._support.run import Run, running
from consistent_id.diagnosis import all_logs, diagnose, free_clock, joint_shifts
from consistent_id.diagnosis.all_logs import scale_instead
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.diagnosis.factor_logs import FactorLogs
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.free_clock import (
    SURE,
    SureClock,
    clock_instead,
    free_clock_findings,
)
from consistent_id.diagnosis.free_clock import (
    free_clock as estimated,
)
from consistent_id.diagnosis.joint_shifts import CommonShifts
from consistent_id.regression import base_parameters


def _clocked(log, factor):
    """Return a log whose clock shows `factor` times the time."""
    return replace(
        log,
        time=factor * log.time,
        velocity=log.velocity / factor,
        acceleration=log.acceleration / factor**2,
    )


def _foreign():
    """Return the model of the arm with nominal bodies that are far from its own."""
    model = arm()
    central = InertialParameters.from_central(3.0, [0.1, 0.1, 0.1], 0.2 * np.eye(3))
    links = tuple(replace(link, nominal=central) for link in model.robot.links)
    return replace(model, robot=replace(model.robot, links=links))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.2, 0.7, 1.3, 2.0, 5.0])
def test_the_clock_is_known_though_nominal_bodies_are_wrong(factor):
    _, log = logged(1)
    found = estimated(FactorLogs.of(_foreign(), [_clocked(log, factor)]))
    assert np.exp(found.size) == pytest.approx(factor, rel=0.02)
    assert abs(found.size - np.log(factor)) < 3.0 * found.error
    assert found.explained > SURE**2


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_a_right_clock_and_one_that_is_off_by_less_than_counts_are_not_named(factor):
    _, log = logged(1)
    assert free_clock_findings(FactorLogs.of(_foreign(), [_clocked(log, factor)])) == []


@pytest.mark.slow
@pytest.mark.parametrize("velocity_scale", [0.01, 0.05, 0.08])
def test_a_wrong_width_of_friction_is_no_clock(velocity_scale):
    """The model says 0.02: with another clock, its friction has the true width."""
    model = replace(arm(), drive=DRIVE)
    log = slow_log(model, velocity_scale)
    assert estimated(FactorLogs.of(model, [log])) is None


@pytest.mark.slow
def test_accelerations_that_are_noise_are_no_slow_clock(monkeypatch):
    """Any clock explains the log better by which there is less inertial torque."""
    _, log = logged(1)
    rng = np.random.default_rng(0)
    noise = 3.0 * np.std(log.acceleration, axis=0) * rng.normal(size=log.position.shape)
    shaken = replace(log, acceleration=log.acceleration + noise)
    as_is = FactorLogs.of(_foreign(), [shaken])
    assert estimated(as_is) is None
    monkeypatch.setattr(free_clock, "_AT_HALF", 1.0)
    found = estimated(as_is)
    assert found.size < -0.5
    assert found.explained > SURE**2


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.05, 0.1, 20.0, 30.0])
def test_a_clock_beyond_all_that_are_tried_is_not_given_another_speed(factor):
    _, log = logged(1)
    assert estimated(FactorLogs.of(_foreign(), [_clocked(log, factor)])) is None


@pytest.mark.parametrize(
    ("severity", "kinds"),
    [
        ("fault", ["clock", "hidden zero"]),
        ("warning", ["clock", "gravity", "hidden zero"]),
    ],
)
def test_a_clock_that_is_a_warning_takes_no_others_place(severity, kinds):
    def said(kind, severity):
        return LogFinding(kind, severity, "somewhere", "", "", 1.0)

    found = [said("gravity", "warning"), said("hidden zero", "note")]
    clock = [said("clock", severity)]
    after = all_logs._with_free_clock(lambda: clock, found)
    assert [f.kind for f in after] == kinds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drives", "agree", "named"),
    [(0.51, False, False), (0.51, True, True), (0.49, False, True)],
)
def test_where_drives_take_most_torque_all_joints_have_to_show_the_clock(
    drives, agree, named, monkeypatch
):
    _, log = logged(1)
    as_is = FactorLogs.of(_foreign(), [_clocked(log, 1.3)])
    monkeypatch.setattr(free_clock, "drives_share", lambda _: drives)
    monkeypatch.setattr(free_clock.ClockSpeeds, "all_show", lambda *_: agree)
    assert (estimated(as_is) is not None) is named


@pytest.mark.slow
def test_a_clock_that_is_far_from_sure_is_not_looked_for_exactly(monkeypatch):
    _, log = logged(1)
    as_is = FactorLogs.of(_foreign(), [_clocked(log, 1.3)])
    found, looked = estimated(as_is), []
    narrowed = free_clock._narrowed

    def noted(*arguments):
        looked.append(arguments)
        return narrowed(*arguments)

    monkeypatch.setattr(free_clock, "_narrowed", noted)
    # Shares of what the best clock explains, that growing steps and first halves reach.
    for shares, looks in (((0.0, 0.0), 2), ((0.0, 1.1), 1), ((1.1, 0.0), 0)):
        monkeypatch.setattr(free_clock, "SURE", np.sqrt(found.explained))
        monkeypatch.setattr(free_clock, "_HOPELESS", shares)
        looked.clear()
        again = estimated(as_is)
        assert len(looked) == looks
        assert (again is None) == (looks < 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("explained", "harm", "severity"),
    [(0.9, 0.5, None), (1.1, 0.05, "warning"), (1.1, 0.15, "fault")],
)
def test_a_clock_is_named_if_it_is_sure_and_a_fault_if_it_is_harmful(
    explained, harm, severity, monkeypatch
):
    model, log = logged(1)
    as_is = FactorLogs.of(model, [_clocked(log, 1.3)])
    found = replace(estimated(as_is), explained=explained * SURE**2, harm=harm)
    monkeypatch.setattr(free_clock, "free_clock", lambda _: found)
    said = [f.severity for f in free_clock_findings(as_is)]
    assert said == ([] if severity is None else [severity])


def test_a_fault_beside_nominal_bodies_is_kept():
    clock = LogFinding("clock", "fault", "time", "slow", "check it")
    zero = LogFinding("offset zero", "fault", "joint1", "off", "check it")
    doubt = replace(zero, severity="warning")
    needless = partial(pytest.fail, "the clock is not asked for")
    assert all_logs._with_free_clock(needless, [zero]) == [zero]
    assert all_logs._with_free_clock(lambda: [clock], [doubt]) == [clock]
    assert all_logs._with_free_clock(list, [doubt]) == [doubt]


@pytest.mark.parametrize("known", [True, False])
def test_the_clock_stands_beside_changes_of_known_bodies(known, monkeypatch):
    clock = LogFinding("clock", "warning", "time", "slow", "check it")
    change = LogFinding("load", "note", "joint2", "picked up", "check it")
    _, log = logged(1)
    fitted = SimpleNamespace(
        factors=SimpleNamespace(model=arm()),
        friction=0.0,
        recording=log,
        constraints=[],
    )
    monkeypatch.setattr(all_logs, "bodies_known", lambda _: known)
    monkeypatch.setattr(all_logs, "change_findings", lambda _: [change])
    monkeypatch.setattr(all_logs, "whole_robot_findings", lambda _: [])
    monkeypatch.setattr(all_logs, "free_clock_findings", lambda _: [clock])
    found = all_logs._of_whole_robot([fitted])
    assert found == ([clock, change] if known else [clock])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
@pytest.mark.parametrize(("most", "copies"), [(10**6, 2), (1, 1)])
def test_few_logs_are_looked_at_by_two_processes(most, copies, monkeypatch):
    begun, begin = [], executors._begun
    monkeypatch.setattr(
        executors, "_begun", lambda copy: begun.append(1) or begin(copy)
    )
    monkeypatch.setattr(executors, "FEW_SAMPLES", most)
    _, log = logged(1)
    with running(Run(beside=True)):
        shared = diagnose(arm(), [log, replace(log, name="again")])
    assert len(begun) == copies  # one is for the clock
    assert shared == diagnose(arm(), [log, replace(log, name="again")])


@pytest.mark.slow
def test_a_diagnosis_without_known_bodies_names_the_clock():
    _, log = logged(1)
    model = _foreign()
    bare = tuple(replace(link, nominal=None) for link in model.robot.links)
    unknown = replace(model, robot=replace(model.robot, links=bare))
    named = diagnose(unknown, _clocked(log, 1.5)).findings
    assert [(f.kind, f.severity) for f in named if f.severity != "note"] == [
        ("clock", "fault")
    ]
    assert not any(f.severity == "fault" for f in diagnose(unknown, log).findings)


GAIN = LogFinding("torque gain", "fault", "joint1", "1.21 times", "check it")
HIDDEN = LogFinding("hidden zero", "note", "joint4", "any zero", "nothing")


def _fitted(log):
    model = other_arm()
    rows, base = at_samples(log), base_parameters(model)
    return fitted_log(model, rows, datasheet_constraints(model), base)


def _slow(seed, factor):
    log = clean_log(seed)
    return replace(log, time=factor * log.time, velocity=log.velocity / factor)


@pytest.mark.slow
def test_a_clock_that_explains_more_than_zeros_and_gains_is_named_instead():
    fitted = _fitted(_slow(1, 1.1))
    clock = SureClock([fitted])
    assert clock.misfit < 0.9 * fitted.misfit
    worse = SimpleNamespace(misfit=1.01 * clock.misfit)
    first, *rest = clock_instead(clock, worse, [GAIN, HIDDEN])
    assert (first.kind, first.severity, rest) == ("clock", "fault", [HIDDEN])
    assert float(first.size.split()[0]) == pytest.approx(1.1, rel=0.02)
    better = SimpleNamespace(misfit=0.99 * clock.misfit)
    assert clock_instead(clock, better, [GAIN, HIDDEN]) == [GAIN, HIDDEN]


@pytest.mark.parametrize(
    "found", [[HIDDEN], [replace(GAIN, severity="warning")], [replace(GAIN, kind="x")]]
)
def test_only_faults_of_zeros_and_gains_are_compared_with_a_clock(found):
    assert clock_instead(SureClock([]), CommonShifts([]), found) == found


@pytest.mark.slow
def test_no_clock_is_found_in_a_right_log_nor_in_one_of_a_single_torque():
    assert SureClock([_fitted(clean_log(1))]).misfit == np.inf
    model, log = (
        replace(other_arm(), torque_joints=("joint2",)),
        at_samples(_slow(1, 2)),
    )
    one = fitted_log(model, log, datasheet_constraints(model), base_parameters(model))
    assert SureClock([one]).misfit == np.inf


@pytest.mark.slow
def test_the_clock_and_the_shifts_of_logs_are_searched_once(monkeypatch):
    searched = []
    for module, name in ((free_clock, "free_clock"), (joint_shifts, "moved_channels")):
        search = getattr(module, name)

        def noted(*arguments, name=name, search=search):
            searched.append(name)
            return search(*arguments)

        monkeypatch.setattr(module, name, noted)
    fitted = _fitted(_slow(1, 1.1))
    clock, shifts = SureClock([fitted]), CommonShifts([fitted])
    found = joint_shifts.joint_shifts(shifts)
    assert {f.kind for f in found if f.severity == "fault"} == {"torque gain"}
    named = scale_instead(clock, shifts, clock_instead(clock, shifts, found))
    assert [f.kind for f in named if f.severity == "fault"] == ["clock"]
    assert sorted(searched) == ["free_clock", "moved_channels"]


@pytest.mark.slow
def test_a_clock_is_no_gain_of_the_joint_that_gravity_does_not_load():
    named = diagnose(other_arm(), at_samples(_slow(1, 1.1))).faults
    assert [f.kind for f in named] == ["clock"]
    log = clean_log(5)
    wrong = replace(log, torque=log.torque * [1.21, 1.0, 1.0, 1.0])
    named = diagnose(other_arm(), at_samples(wrong)).faults
    assert [(f.kind, f.where) for f in named] == [("torque gain", "joint1")]
