"""The scale of one position, where zeros, gains or a clock stand in for it.

A wrong gear ratio, as of an encoder at the motor, moves a joint farther, or less far,
than its link.  Zeros and gains of several joints explain a part of such a log.  If one
scale of a position explains more than all of them, and than a clock, it has fewer
numbers, too.
"""

from collections.abc import Sequence
from dataclasses import replace

from consistent_id.diagnosis.corrections import LOOKS_ALIKE, Cause, corrections
from consistent_id.diagnosis.explain import (
    Explanation,
    FittedLog,
    corrected,
    explanation_finding,
)
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.free_clock import SureClock
from consistent_id.diagnosis.joint_shifts import (
    SHIFT_KINDS,
    CommonShifts,
    all_faults_are,
    together,
)
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.best_fit import best_fit

STAND_INS = (*SHIFT_KINDS, "clock")
"""Kinds of faults that a wrong scale of a position looks like."""


def scale_instead(
    clock: SureClock, shifts: CommonShifts, found: Sequence[LogFinding]
) -> list[LogFinding]:
    """Replace faults of zeros, gains and the clock by a scale that explains more.

    Parameters
    ----------
    clock, shifts
        Of the same logs.
    found : sequence of LogFinding
        Findings of all these logs together.
    """
    if not all_faults_are(STAND_INS, found):
        return list(found)
    best = _best_scale(shifts.logs)
    if best is None or best.score < 1.0:
        return list(found)
    if best.misfit >= min(shifts.misfit, clock.misfit):
        return list(found)
    return [_finding(best), *(f for f in found if f.kind not in STAND_INS)]


def _best_scale(logs: Sequence[FittedLog]) -> Explanation | None:
    """Return the scale with the least misfit in all logs, if all allow one."""
    as_is = together([log.misfit for log in logs])
    each = [_misfits(log) for log in logs]
    shared = [
        Explanation(cause, together([one[cause] for one in each]), as_is)
        for cause in each[0]
        if all(cause in one for one in each)
    ]
    return min(shared, key=lambda scale: scale.misfit, default=None)


def _misfits(log: FittedLog) -> dict[Cause, float]:
    """Return the misfits with scales that a few samples do not exclude."""
    model = log.factors.model
    every = corrections(model.robot, model.torque_joints)
    near = [c for c in every if c.cause.excuse == LOOKS_ALIKE]
    found = {}
    for candidate in corrected(log, near):
        factors = candidate.factors
        try:
            fit = best_fit(
                model, factors.regression(), candidate.constraints, base=factors.base
            )
        except (InfeasibleError, SolverError):
            continue  # no robot explains the log with this scale
        found[candidate.cause] = factors.relative(fit.misfit)
    return found


def _finding(scale: Explanation) -> LogFinding:
    finding = explanation_finding(scale)
    return replace(
        finding,
        statement=f"{finding.statement}; zeros, gains and the clock explain less; a "
        "link that is longer or shorter than the model's looks the same",
        advice=f"{finding.advice}; check the lengths of the model",
    )
