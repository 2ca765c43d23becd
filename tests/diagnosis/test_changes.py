"""Changes in the course of logs whose robot is known."""

from dataclasses import replace

import numpy as np
import pytest
from known_arm import logged

from consistent_id import diagnose
from consistent_id.diagnosis.changes import change_findings, changes
from consistent_id.diagnosis.factor_logs import FactorLogs


def _changed(course, *, friction_only=False, seed=1):
    """Return the model and a log whose torque, or friction, follows a course."""
    model, log = logged(seed, spread=0.5)
    torque = log.torque
    part = torque
    if friction_only:
        part = torque - logged(seed, spread=0.5, friction=(0.0, 0.0, 0.0))[1].torque
    return model, replace(log, torque=torque + course(log.time)[:, None] * part)


def _stepped(time):
    return np.where(time >= 10.0, 0.4, 0.0)  # from the middle on


def _fading(time):
    return -0.8 * (time - time[0]) / (time[-1] - time[0])


def _found(model, *logs):
    return change_findings(FactorLogs.of(model, logs))


def test_a_clean_log_does_not_change():
    model, log = logged(1, spread=0.5)
    assert _found(model, log) == []
    assert max(c.harm for c in changes(FactorLogs.of(model, [log]))) < 0.02


def test_a_gain_that_changes_is_found_when_it_does():
    model, log = _changed(_stepped)
    best = max(changes(FactorLogs.of(model, [log])), key=lambda c: c.explained)
    assert (best.where, best.start) == ("torque", 0.5)
    assert best.size == pytest.approx(0.4 / 1.2, rel=0.1)  # of its mean
    assert best.harm == pytest.approx(best.size / 2.0, rel=0.1)
    (finding,) = _found(model, log)
    assert (finding.kind, finding.severity) == ("drift", "fault")
    assert "at 10 s" in finding.statement


def test_friction_that_fades_is_told_from_torque_that_does():
    model, log = _changed(_fading, friction_only=True)
    best = max(changes(FactorLogs.of(model, [log])), key=lambda c: c.explained)
    assert (best.where, best.start) == ("friction", 0.0)
    assert best.size == pytest.approx(-0.8 / 0.6, rel=0.15)
    model, log = _changed(lambda time: 0.3 * _fading(time))
    best = max(changes(FactorLogs.of(model, [log])), key=lambda c: c.explained)
    assert (best.where, best.start) == ("torque", 0.0)


@pytest.mark.slow
def test_a_change_that_hardly_matters_is_no_finding_and_a_small_one_a_warning():
    found = {}
    for size in (0.03, 0.16, 0.3):
        model, log = _changed(lambda time, size=size: size / 0.4 * _stepped(time))
        found[size] = [f.severity for f in _found(model, log)]
    assert found == {0.03: [], 0.16: ["warning"], 0.3: ["fault"]}


def test_logs_change_from_one_to_the_next():
    model, log = _changed(lambda time: np.where(time >= 12.0, 0.4, 0.0))
    first, second = log.samples(slice(0, 360)), log.samples(slice(360, 600))
    (finding,) = _found(model, first, replace(second, name="second.csv"))
    assert "of second.csv" in finding.statement


@pytest.mark.slow
def test_a_diagnosis_names_a_change_before_what_it_looks_like():
    model, log = _changed(_stepped)
    kinds = [f.kind for f in diagnose(model, log).findings if f.severity == "fault"]
    assert kinds == ["drift"]
