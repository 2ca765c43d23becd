"""Changes in the course of logs: drives that warm up, a gain that is not the same.

No estimate is right before and after a change.  All torque, or the drives' part of it,
may change steadily or at once: each such change is a factor ``f`` that is fitted with
all parameters ``x``, bodies and drives free,

    minimise  sum_j ||(Y_j x + f s(t) t_j - tau_j) / s_j||^2

where ``t_j`` is the torque, or the part, as it was fitted without a change, and
``s(t)`` is a line or a step.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.diagnosis.factor_logs import (
    HARM,
    FactorLogs,
    eliminated,
    solution_of,
)
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.linearise import SEGMENTS
from consistent_id.recordings.recording import instant

_EARLIEST = 2  # segments before a change at once, and after it
_LIKELY = 3.0  # standard errors from which on a change is reported
# Share of the squared residual that a change has to explain, and error of an estimate,
# over all torque, from which on it is a warning.  Clean simulated logs reach 0.014 and
# 0.001.  Of clean logs of four arms, a TX40's drives explain most, 0.20 at 0.05.
_EXPLAINS, _HARMFUL = 0.1, 0.07
_ALIKE = 0.8  # share of the best explanation that others reach


@dataclass(frozen=True, slots=True)
class LogChange:
    """A change of all torque, or of the drives', in the course of the logs.

    Parameters
    ----------
    where : {"torque", "friction"}
    start : float
        Share of all samples after which it happens; zero if it is steady.
    size : float
        Relative to the mean: from the first sample to the last, or at once.
    explained : float
        Share of the squared residual, with bodies and drives free.
    harm : float
        Error of an estimate that does not know it, relative to the torque of all
        joints: half of the change.
    """

    where: str
    start: float
    size: float
    explained: float
    harm: float


def changes(state: FactorLogs) -> list[LogChange]:
    """Return changes in the course of the logs, each with free bodies and drives.

    All torque, or the drives' alone, grows steadily, or at once after one of twenty
    segments.  Friction that grows with the measured torque would take part in the
    change: it is left out.
    """
    state, parts = _changing(state)
    starts = [0.0, *np.arange(_EARLIEST, SEGMENTS - _EARLIEST + 1) / SEGMENTS]
    cases = [(where, float(start)) for where in parts for start in starts]
    c = np.stack([parts[where] * _course(state, k) for where, k in cases], axis=1)
    system = eliminated(state, c, nominal=False, scatter=False)
    whole, found = max(system.misfit([]) ** 2, 1e-300), []
    for k, (where, start) in enumerate(cases):
        size = float(system.solution([k])[0])
        share = np.linalg.norm(parts[where]) / np.linalg.norm(state.rows.torque)
        explained = 1.0 - system.misfit([k]) ** 2 / whole
        half = float(abs(size) / 2.0 * share)
        found.append(LogChange(where, start, size, explained, half))
    return found


def change_ratio(state: FactorLogs, change: LogChange) -> float:
    """Return the size of a change over its standard error, see `Jackknife`."""
    state, parts = _changing(state)
    c = (parts[change.where] * _course(state, change.start))[:, None]
    fit = eliminated(state, c, nominal=False, scatter=True).fitted([0])
    return abs(float(fit.solution[0])) / float(fit.errors[0])


def _changing(state: FactorLogs) -> tuple[FactorLogs, dict[str, Matrix]]:
    """Return logs without friction by load, and the torques that may change."""
    state = replace(state, rows=state.rows.without_loads)
    A, inertial = state.rows.columns, state.model.layout.inertial_size
    x = solution_of(state)
    drives = np.einsum("jps,p->js", A[:, inertial:], x[inertial:])
    return state, {"torque": np.einsum("jps,p->js", A, x), "friction": drives}


def _course(state: FactorLogs, start: float) -> Vector:
    """Return the course of a change by one, with a mean of zero."""
    count = state.rows.torque.shape[1]
    lapse = np.arange(count) / count
    return np.asarray((lapse >= start) - (1.0 - start) if start else lapse - 0.5)


def change_findings(as_is: FactorLogs) -> list[LogFinding]:
    """Report a change of all torque, or of friction, in the course of the logs."""
    found = changes(as_is)
    best = max(found, key=lambda change: change.explained)
    alike = [c for c in found if c.explained >= _ALIKE * best.explained]
    harmful = max(c.harm for c in alike)
    if best.explained < _EXPLAINS or harmful < _HARMFUL:
        return []
    if change_ratio(as_is, best) < _LIKELY:
        return []
    of_friction = any(c.where == "friction" for c in alike)
    what = "the torque of " + ("drives" if best.where == "friction" else "all joints")
    when = "from the first sample to the last"
    if best.start:
        when = f"at {_time_of(as_is, best.start)}"
    return [
        LogFinding(
            "drift",
            "fault" if harmful >= HARM else "warning",
            "all joints",
            f"{what} changes by {best.size:+.0%} of its mean {when}, which explains "
            f"{best.explained:.0%} of what is left unexplained: an estimate is "
            f"{harmful:.0%} off in torque before or after it",
            "split the log there, or leave one part out"
            + ("; let drives warm up before recording" if of_friction else "")
            + "; check for a load, a gain or a supply that changed",
            harmful / _HARMFUL,
        )
    ]


def _time_of(as_is: FactorLogs, share: float) -> str:
    """Return where a share of all samples ends, in words."""
    place = round(share * sum(len(log) for log in as_is.logs))
    for log in as_is.logs:
        if place < len(log):
            return f"{instant(log.time[place], log.time)} s of {log.name}"
        place -= len(log)
    return "the end"
