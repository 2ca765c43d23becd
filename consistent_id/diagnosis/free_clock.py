"""The speed of the clock that logs show with free bodies, without nominal ones.

Gravity torque and inertial torque contain the same first moments.  So a clock at the
wrong speed leaves a residual whatever the bodies are, and nominal bodies that are wrong
cannot hide it; see `ClockSpeeds`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from consistent_id.diagnosis.clock_speeds import SEVERAL, ClockSpeeds
from consistent_id.diagnosis.explain import FittedLog, fitted_log
from consistent_id.diagnosis.factor_findings import (
    FARTHEST,
    RUBBING,
    FoundFactor,
    harm,
)
from consistent_id.diagnosis.factor_logs import (
    HARM,
    FactorLogs,
    drives_share,
)
from consistent_id.diagnosis.findings import LogFinding, Severity
from consistent_id.diagnosis.joint_shifts import (
    SHIFT_KINDS,
    CommonShifts,
    all_faults_are,
    together,
)
from consistent_id.errors import InfeasibleError, SolverError

SURE = 5.0
"""Standard errors from which on the clock is named: the root of the likelihood ratio.

Of the clean logs of six real arms, the largest is 2.2 (a Z1, nearly all friction).
"""

_NEARLY = float(np.log(1.05))  # least logarithm of a speed that is compared with them
_WIDEN = 1.5  # ratio of the steps of a search
_HALVES = 2, 4  # times that an interval is halved, at first and for a likely clock
_LOOKS = 7  # speeds over the whole range at which a likely clock is looked for, too
# Shares of what a sure clock explains, below which no better one is looked for: after
# growing steps, and after the first halves.
_HOPELESS = 0.25, 0.75
# Share of what a clock explains that half its logarithm explains at most, of a parabola
# three quarters.  If more, any slow clock is as likely: the accelerations are wrong.
_AT_HALF = 0.8
_FREE = 1e3  # times the widths of nominal bodies: these are free


def free_clock(as_is: FactorLogs, least: float | None = None) -> FoundFactor | None:
    """Estimate the speed of the clock with free bodies.

    Parameters
    ----------
    least : float, optional
        Least logarithm of the speed that counts; by default that of the factor.

    Returns
    -------
    FoundFactor or None
        None if no speed that differs by the least size is likelier than none, none can
        be sure, or it may be friction.  `explained` is twice the logarithm of the
        likelihood ratio.
    """
    speeds = ClockSpeeds(as_is)
    least = speeds.factor.least if least is None else least
    most = FARTHEST["clock"]
    low, size, high = _bracket(speeds.lost, least, most)
    # Of a parabola, some four fifths of what the best size explains.
    if speeds.explained(size) < _HOPELESS[0] * SURE**2:
        return None
    # The likelihood may have another maximum, far away on the other side.
    grid = np.linspace(-most, most, _LOOKS)
    far = int(np.argmin([speeds.lost(float(other)) for other in grid]))
    if speeds.lost(float(grid[far])) < speeds.lost(size):
        if far in (0, _LOOKS - 1):
            return None  # the best one is farther away than speeds that are tried
        low, size, high = (float(other) for other in grid[far - 1 : far + 2])
    low, size, high = _narrowed(speeds.lost, (low, size, high), _HALVES[0])
    if speeds.explained(size) < _HOPELESS[1] * SURE**2:
        return None
    _, size, _ = _narrowed(speeds.lost, (low, size, high), _HALVES[1])
    as_likely = speeds.explained(0.5 * size) > _AT_HALF * speeds.explained(size)
    if abs(size) < least or as_likely:
        return None
    drives = drives_share(as_is)
    if drives >= RUBBING and not speeds.all_show(size):
        return None  # friction that the model lacks may show it
    error = speeds.error(size, 0.5 * least)
    free = replace(as_is, widths=_FREE * as_is.widths)
    return FoundFactor(
        speeds.factor,
        size,
        error,
        error,
        speeds.explained(size),
        harm=harm(free, speeds.factor, size),
        drives=drives,
    )


def _bracket(
    lost: Callable[[float], float], step: float, most: float
) -> tuple[float, float, float]:
    """Return sizes around the least value of a function, found in growing steps.

    The middle one is zero if the function rises on both sides.
    """
    side = min((-step, step), key=lost)
    if lost(side) >= lost(0.0):
        return -step, 0.0, step
    low, best, high = 0.0, side, _WIDEN * side + side
    while abs(high) < most and lost(high) < lost(best):
        low, best, high = best, high, high + _WIDEN * (high - best)
    return low, best, float(np.clip(high, -most, most))


def _narrowed(
    lost: Callable[[float], float], around: tuple[float, float, float], halves: int
) -> tuple[float, float, float]:
    """Return sizes around a function's least value, nearer than those of `_bracket`."""
    low, best, high = around
    for _ in range(halves):
        before, after = 0.5 * (low + best), 0.5 * (best + high)
        least = min((best, before, after), key=lost)
        if least == best:
            low, high = before, after
        elif least == before:
            best, high = before, best
        else:
            low, best = best, after
    return low, best, high


def free_clock_findings(as_is: FactorLogs) -> list[LogFinding]:
    """Report a clock that logs show by themselves; a fault if it is harmful."""
    found = free_clock(as_is)
    if found is None or found.explained < SURE**2:
        return []
    return [_finding(found, "fault" if found.harm >= HARM else "warning")]


@dataclass(frozen=True, eq=False)
class SureClock:
    """The clock that all logs show if it is sure, found when first needed, and once.

    Parameters
    ----------
    logs : sequence of FittedLog
        Logs in which the same joints have a torque.
    """

    logs: Sequence[FittedLog]

    @cached_property
    def found(self) -> FoundFactor | None:
        """The clock, however near it is to the right one; None if none is sure."""
        model = self._as_is.model
        if len(model.torque_joints) < SEVERAL:
            return None
        clock = free_clock(self._as_is, _NEARLY)
        return clock if clock is not None and clock.explained >= SURE**2 else None

    @cached_property
    def misfit(self) -> float:
        """The misfit of the logs with the clock corrected.

        It is infinite if no clock is sure, or no robot explains the corrected logs.
        """
        if self.found is None:
            return np.inf
        moved = self._as_is.without(self.found.factor, self.found.size)
        try:
            return together(
                [
                    fitted_log(
                        moved.model, one, log.constraints, log.factors.base
                    ).misfit
                    for log, one in zip(self.logs, moved.logs, strict=True)
                ]
            )
        except (InfeasibleError, SolverError):
            return np.inf

    @cached_property
    def _as_is(self) -> FactorLogs:
        model = self.logs[0].factors.model
        return FactorLogs.of(model, [log.recording for log in self.logs])


def clock_instead(
    clock: SureClock, shifts: CommonShifts, found: Sequence[LogFinding]
) -> list[LogFinding]:
    """Replace faults of zeros and gains by a clock that explains more.

    A joint that gravity does not load has inertial torque alone: a wrong clock looks
    like a gain of this joint.

    Parameters
    ----------
    clock, shifts
        Of the same logs.
    found : sequence of LogFinding
        Findings of all these logs together.
    """
    if not all_faults_are(SHIFT_KINDS, found):
        return list(found)
    if clock.found is None or clock.misfit >= shifts.misfit:
        return list(found)
    left = (f for f in found if f.kind not in SHIFT_KINDS)
    return [_finding(clock.found, "fault"), *left]


def _finding(found: FoundFactor, severity: Severity) -> LogFinding:
    # The likelihood's error of the size is not shown: where friction is most of the
    # torque, its law pulls the size farther than noise does.
    size = f"{float(np.exp(found.size)):.2g}"
    return LogFinding(
        "clock",
        severity,
        found.factor.where,
        f"bodies of any kind explain the log much better with a clock some {size} "
        f"times as fast ({np.sqrt(found.explained):.1f} standard errors): its inertial "
        "torque does not fit its weight; an estimate that does not know it would "
        f"be {found.harm:.0%} off in torque",
        "find out the unit of time, or the rate of the log",
        float(np.sqrt(found.explained)) / SURE,
        size=size,
    )
