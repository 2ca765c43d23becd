"""The clock beside free bodies: no nominal body tells how fast it runs."""

from dataclasses import replace

import numpy as np
import pytest
from known_arm import arm, logged

from consistent_id import InertialParameters
from consistent_id.diagnosis import all_logs, diagnose, free_clock
from consistent_id.diagnosis.factor_rows import FactorLogs
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.free_clock import (
    SURE,
    free_clock_findings,
)
from consistent_id.diagnosis.free_clock import (
    free_clock as estimated,
)


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


@pytest.mark.parametrize("factor", [0.7, 1.3, 2.0])
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


def test_a_fault_beside_nominal_bodies_is_kept(monkeypatch):
    clock = LogFinding("clock", "fault", "time", "slow", "check it")
    monkeypatch.setattr(all_logs, "free_clock_findings", lambda _: [clock])
    zero = LogFinding("offset zero", "fault", "joint1", "off", "check it")
    doubt = replace(zero, severity="warning")
    assert all_logs._with_free_clock(None, [zero]) == [zero]
    assert all_logs._with_free_clock(None, [doubt]) == [clock]
    monkeypatch.setattr(all_logs, "free_clock_findings", lambda _: [])
    assert all_logs._with_free_clock(None, [doubt]) == [doubt]


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
