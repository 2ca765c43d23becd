"""Advice on a log whose torque is made of commands."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from some_fast import some_fast

from consistent_id import draft_problem
from consistent_id.diagnosis import Diagnosis, LogFinding
from consistent_id.problems import log_check
from consistent_id.problems.log_check import check_problem
from tests.problems.test_drafts_of_commands import GAINS, commanded_logs


@pytest.mark.slow
@pytest.mark.parametrize("late", some_fast([6, 0]))
def test_late_commands_are_to_be_given_their_delay(tmp_path, late):
    urdf, (log,) = commanded_logs(tmp_path, 1.0)
    head, *_ = log.read_text().splitlines()
    rows = np.loadtxt(log, delimiter=",", skiprows=1, max_rows=1500)
    rows[late:, 3:] = rows[: len(rows) - late, 3:]  # commands, by 60 ms
    np.savetxt(log, rows, "%.9g", ",", header=head, comments="")
    problem = draft_problem(urdf, log, gains=GAINS, select=False, cutoff=10.0).problem()
    lags = check_problem(problem).of("lag")
    assert bool(lags) == bool(late)
    assert all("[data.gains]" in f.advice for f in lags)


EFFECTS = ("clock", "masses or gain", "offset zero", "gravity")


def findings(*kinds, severity="warning", size="0.06"):
    found = [
        LogFinding(kind, severity, "all joints", "said", "", 1.0, size=size)
        for kind in kinds
    ]
    return Diagnosis(tuple(found), ("log",))


@pytest.fixture
def late_by_60_ms(tmp_path):
    urdf, (log,) = commanded_logs(tmp_path, 1.0)
    problem = draft_problem(urdf, log, gains=GAINS, select=False, cutoff=10.0).problem()
    data = problem.table.data
    preparation = msgspec.structs.replace(data.preparation, delays={"torque": 0.06})
    data = msgspec.structs.replace(data, preparation=preparation)
    return replace(problem, table=msgspec.structs.replace(problem.table, data=data))


def checked(monkeypatch, problem, corrected, recorded):
    """Check a problem, given the findings with the delay corrected, and as recorded."""
    asked = []

    def look(_, prepare):
        asked.append(prepare)
        return corrected if len(asked) == 1 else recorded

    monkeypatch.setattr(log_check, "_checked", look)
    found = check_problem(problem).findings
    return [f.kind for f in found], len(asked)


def test_a_drive_filter_behind_a_delay_replaces_what_it_looks_like(
    monkeypatch, late_by_60_ms
):
    corrected = findings("outliers", *EFFECTS)
    behind = findings("drive filter", severity="fault")
    kinds, _ = checked(monkeypatch, late_by_60_ms, corrected, behind)
    assert kinds == ["drive filter", "outliers"]
    # A lag is a warning, and explains none of them.
    kinds, _ = checked(monkeypatch, late_by_60_ms, corrected, findings("lag"))
    assert kinds == ["outliers", *EFFECTS, "lag"]


def test_a_log_with_a_fault_is_not_examined_without_its_delay(
    monkeypatch, late_by_60_ms
):
    corrected = findings("torque sign", severity="fault")
    behind = findings("drive filter", severity="fault")
    kinds, times = checked(monkeypatch, late_by_60_ms, corrected, behind)
    assert (kinds, times) == (["torque sign"], 1)


@pytest.mark.parametrize(
    ("lag", "said"), [([], ["fault"]), (["lag"], ["warning", "warning"])]
)
def test_what_a_filter_may_look_like_is_not_sure_beside_it(
    monkeypatch, late_by_60_ms, lag, said
):
    corrected = findings("gravity", severity="fault")
    asked = iter([corrected, findings(*lag)])
    monkeypatch.setattr(log_check, "_checked", lambda *_: next(asked))
    found = check_problem(late_by_60_ms).findings
    assert [f.severity for f in found] == said


@pytest.mark.parametrize(
    ("seconds", "severity"),
    [(0.084, "warning"), (0.036, "warning"), (0.086, "fault"), (0.034, "fault")],
)
def test_a_lag_that_is_not_the_delay_that_is_corrected_is_a_fault(
    monkeypatch, late_by_60_ms, seconds, severity
):
    recorded = findings("lag", size=f"{seconds:.3g}")
    asked = iter([findings("clock"), recorded])
    monkeypatch.setattr(log_check, "_checked", lambda *_: next(asked))
    found = check_problem(late_by_60_ms).findings
    (lag,) = (f for f in found if f.kind == "lag")
    assert lag.severity == severity
    assert "corrects a delay of 60 ms" in lag.statement
    (own,) = log_check._hidden(late_by_60_ms, recorded)
    assert ("{ torque = SECONDS }" in own.advice) == (severity == "fault")
    # Velocities that are late are no late torque.
    assert log_check._hidden(late_by_60_ms, findings("lag", size="")) == ()
    # What a lag causes is not stated beside one that is sure.
    assert ("clock" in [f.kind for f in found]) == (severity == "warning")
