"""The scale of one position, where zeros and gains stand in for it."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from faulty_logs import arm, at_samples, clean_log

from consistent_id.diagnosis import all_logs, diagnose
from consistent_id.diagnosis.all_logs import scale_instead
from consistent_id.diagnosis.corrections import corrections
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.joint_shifts import CommonShifts, joint_shifts
from consistent_id.regression import base_parameters

ZERO = LogFinding("offset zero", "fault", "joint1", "a zero", "check it")
HIDDEN = LogFinding("hidden zero", "note", "joint4", "any zero", "nothing")


def _geared(scale):
    """Return a log in which the third position has another scale."""
    log, times = clean_log(1), np.where(np.arange(4) == 2, scale, 1.0)
    return replace(log, position=times * log.position, velocity=times * log.velocity)


@cache
def _fitted(scale):
    model, rows = arm(), at_samples(_geared(scale))
    base = base_parameters(model)
    return fitted_log(model, rows, datasheet_constraints(model), base)


def _instead(logs, found, misfit_of_zeros, misfit_of_clock=np.inf):
    """Name a scale of logs in which zeros, or a clock, leave a misfit."""
    shifts = SimpleNamespace(logs=logs, misfit=misfit_of_zeros)
    return scale_instead(SimpleNamespace(misfit=misfit_of_clock), shifts, found)


@pytest.mark.slow
def test_a_scale_that_explains_more_than_zeros_and_gains_is_named_instead():
    fitted = _fitted(1.25)
    left = 0.9 * fitted.misfit
    first, *rest = _instead([fitted], [ZERO, HIDDEN], left)
    assert (first.kind, first.where, rest) == ("encoder scale", "joint3", [HIDDEN])
    assert "times 0.8" in first.statement
    assert "check the lengths" in first.advice
    # The same of two logs: each of them allows it.
    assert _instead([fitted, fitted], [ZERO, HIDDEN], left)[0].where == "joint3"


@pytest.mark.slow
def test_a_clock_that_explains_more_than_any_scale_stays():
    fitted = _fitted(1.25)
    clock = replace(ZERO, kind="clock")
    assert _instead([fitted], [clock], fitted.misfit, 0.0) == [clock]


@pytest.mark.slow
def test_zeros_that_explain_more_than_any_scale_stay():
    assert _instead([_fitted(1.25)], [ZERO], 0.0) == [ZERO]
    right = _fitted(1.0)
    assert _instead([right], [ZERO], 1.0) == [ZERO]
    # Half of the logs without the scale are explained too little by it.
    assert _instead([_fitted(1.25), right], [ZERO], 1.0) == [ZERO]


@pytest.mark.parametrize("margin", [0.99, 1.01])
def test_a_scale_has_to_explain_as_much_as_any_fault(margin, monkeypatch):
    fitted = _fitted(1.25)
    (scale,) = (
        c.cause
        for c in corrections(arm().robot, arm().torque_joints)
        if (c.where, c.fault.kind, c.change.size) == ("joint3", "encoder scale", 0.9)
    )
    left = margin * fitted.misfit / scale.threshold
    monkeypatch.setattr(all_logs, "_scale_misfits", lambda log: {scale: left})
    found = _instead([fitted], [ZERO], fitted.misfit)
    assert (found == [ZERO]) == (margin > 1.0)


def test_a_scale_stands_for_no_fault_of_another_kind_and_for_no_doubt():
    lean = replace(ZERO, kind="gravity")
    assert _instead([], [ZERO, lean], 1.0) == [ZERO, lean]
    doubt = replace(ZERO, severity="warning")
    assert _instead([], [doubt], 1.0) == [doubt]


@pytest.mark.slow
def test_a_diagnosis_of_a_wrong_gear_ratio_accuses_no_gain():
    # By themselves, zeros and gains would explain the log by a gain.
    accused = [
        f.kind
        for f in joint_shifts(CommonShifts([_fitted(1.25)]))
        if f.severity == "fault"
    ]
    assert accused == ["torque gain"]
    found = diagnose(arm(), at_samples(_geared(1.25)))
    assert [(f.kind, f.where) for f in found.faults] == [("encoder scale", "joint3")]
