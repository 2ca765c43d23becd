"""The scale of one position, where zeros and gains stand in for it."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm, clean_log, logs

from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.encoder_scales import scale_instead
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.regression import base_parameters

ZERO = LogFinding("offset zero", "fault", "joint1", "a zero", "check it")
HIDDEN = LogFinding("hidden zero", "note", "joint4", "any zero", "nothing")


def _fitted(scale):
    model, log = arm(), clean_log(5)
    times = np.where(np.arange(4) == 1, scale, 1.0)
    moved = replace(log, position=times * log.position, velocity=times * log.velocity)
    rows = logs().prepared(moved)
    base = base_parameters(model)
    return moved, fitted_log(model, rows, datasheet_constraints(model), base)


@pytest.mark.slow
def test_a_scale_that_explains_more_than_zeros_and_gains_is_named_instead():
    _, fitted = _fitted(1.25)
    found = scale_instead([fitted], [ZERO, HIDDEN], lambda _: 0.9 * fitted.misfit)
    assert [(f.kind, f.where) for f in found] == [
        ("encoder scale", "joint2"),
        ("hidden zero", "joint4"),
    ]
    assert "times 0.8" in found[0].statement


@pytest.mark.slow
def test_zeros_that_explain_more_than_any_scale_stay():
    _, fitted = _fitted(1.25)
    assert scale_instead([fitted], [ZERO], lambda _: 0.0) == [ZERO]
    _, right = _fitted(1.0)
    assert scale_instead([right], [ZERO], lambda _: right.misfit) == [ZERO]


def test_a_scale_stands_for_no_fault_of_another_kind_and_for_no_doubt():
    lean = replace(ZERO, kind="gravity")
    assert scale_instead([], [ZERO, lean], lambda _: 0.0) == [ZERO, lean]
    doubt = replace(ZERO, severity="warning")
    assert scale_instead([], [doubt], lambda _: 0.0) == [doubt]


@pytest.mark.slow
def test_a_diagnosis_of_a_wrong_gear_ratio_accuses_no_zero():
    moved, _ = _fitted(1.25)
    found = diagnose(arm(), moved, prepare=logs().prepared)
    assert not any(f.kind in ("offset zero", "torque gain") for f in found.faults)
