"""The scale of one position, where zeros, gains or a clock stand in for it.

A wrong gear ratio, as of an encoder at the motor, moves a joint farther, or less far,
than its link.  Zeros and gains of several joints explain a part of such a log.  If one
scale of a position explains more than all of them, it has fewer numbers, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from consistent_id.diagnosis.corrections import LOOKS_ALIKE, Cause, corrections
from consistent_id.diagnosis.explain import FittedLog, corrected
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.best_fit import best_fit

STAND_INS = ("offset zero", "torque gain", "clock")
"""Kinds of faults that a wrong scale of a position looks like."""


def scale_instead(
    logs: Sequence[FittedLog],
    found: Sequence[LogFinding],
    left: Callable[[Sequence[FittedLog]], float],
) -> list[LogFinding]:
    """Replace faults of zeros, gains and the clock by a scale that explains more.

    Parameters
    ----------
    logs : sequence of FittedLog
        Logs in which the same joints have a torque.
    left : callable
        Returns the misfit of logs with corrected zeros and gains, see `together`.
    """
    faults = [f for f in found if f.severity == "fault"]
    if not faults or any(f.kind not in STAND_INS for f in faults):
        return list(found)
    as_is = together([log.misfit for log in logs])
    best, misfit = _best_scale(logs)
    if best is None or misfit * best.threshold > as_is or misfit >= left(logs):
        return list(found)
    rest = [f for f in found if f.kind not in STAND_INS]
    return [_finding(best, misfit, as_is), *rest]


def together(misfits: Sequence[float]) -> float:
    """Return the root of the mean square of logs' misfits."""
    return float(np.sqrt(np.mean(np.square(misfits))))


def _best_scale(logs: Sequence[FittedLog]) -> tuple[Cause | None, float]:
    """Return the scale with the least misfit in all logs, and that misfit."""
    each = [_misfits(log) for log in logs]
    shared = [cause for cause in each[0] if all(cause in one for one in each)]
    misfits = {cause: together([one[cause] for one in each]) for cause in shared}
    best = min(shared, key=misfits.__getitem__, default=None)
    return best, np.inf if best is None else misfits[best]


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


def _finding(cause: Cause, misfit: float, as_is: float) -> LogFinding:
    cause = replace(cause, excuse=0)
    return LogFinding(
        cause.kind,
        "fault",
        cause.where,
        f"{cause.statement}, {misfit:.1%} instead of {as_is:.1%} of each joint's "
        "torque is unexplained, less than with any zeros and gains; a link that is "
        "longer or shorter than the model's looks like it",
        f"{cause.advice}; check the lengths of the model",
        as_is / misfit / cause.threshold,
    )
