"""Advice on a log whose torque is made of commands."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from consistent_id import draft_problem
from consistent_id.diagnosis import Diagnosis, LogFinding
from consistent_id.problems import log_check
from consistent_id.problems.log_check import check_problem
from tests.problems.test_drafts_of_commands import GAINS, commanded_logs


def commanded_problem(folder, late, delay=0.0):
    """The problem of a log whose commands are `late` rows of 10 ms later than actual.

    Torque is computed with a stated delay [s].
    """
    urdf, (log,) = commanded_logs(folder, 1.0)
    head, *_ = log.read_text().splitlines()
    rows = np.loadtxt(log, delimiter=",", skiprows=1, max_rows=1500)
    rows[:, 3:] = rows[np.clip(np.arange(len(rows)) - late, 0, len(rows) - 1), 3:]
    np.savetxt(log, rows, "%.9g", ",", header=head, comments="")
    problem = draft_problem(urdf, log, gains=GAINS, select=False, cutoff=10.0).problem()
    change, data = msgspec.structs.replace, problem.table.data
    data = change(data, gains=change(data.gains, delay=delay))
    return replace(problem, table=change(problem.table, data=data))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("late", "delay", "said"),
    [
        (-6, 0.0, "state their delay in [data.gains]"),
        (6, 0.0, "logged later than they acted"),
        (-6, 0.02, "is 20 ms already"),
        (6, 0.02, "is 20 ms: it is too long"),
    ],
)
def test_a_lag_of_commands_is_answered_with_what_undoes_it(tmp_path, late, delay, said):
    lags = check_problem(commanded_problem(tmp_path, late, delay)).of("lag")
    assert lags
    assert all(said in f.advice for f in lags)


@pytest.mark.slow
@pytest.mark.parametrize(("late", "delay"), [(0, 0.0), (-6, 0.06)])
def test_commands_with_their_delay_have_no_lag(tmp_path, late, delay):
    assert not check_problem(commanded_problem(tmp_path, late, delay)).of("lag")


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_log_with_a_fault_is_not_examined_without_its_delay(
    monkeypatch, late_by_60_ms
):
    corrected = findings("torque sign", severity="fault")
    behind = findings("drive filter", severity="fault")
    kinds, times = checked(monkeypatch, late_by_60_ms, corrected, behind)
    assert (kinds, times) == (["torque sign"], 1)


@pytest.mark.slow
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


@pytest.mark.slow
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
