"""Small errors of joint zero offsets and gains, and lags, found by linearisation.

Near the truth the torque changes by ``d_j dtau/dq_j`` for a zero offset of ``d_j``, by
``c_j tau_j`` for a torque that is logged ``1 + c_j`` times as large, and by ``-t
dtau/dt`` for a lag of ``t``.  Gains can be seen because several joints carry one body.
Zero offsets and gains are tried one at a time beside the parameters and the lag: only
torque that the parameters cannot explain is attributed to them, and a robot with one
wrong zero offset needs no other.  All recordings of a robot are used together, each
with parameters and a lag of its own.

The linearisation of each log is repeated at its own best fit, with the zeros and gains
found so far taken out.  Nominal bodies may contradict the result.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints.priors import nominal_distance
from consistent_id.diagnosis.explain import (
    FittedLog,
    bodies_known,
    fitted_log,
    masses_known,
)
from consistent_id.diagnosis.factor_findings import doubted
from consistent_id.diagnosis.factor_logs import FactorLogs
from consistent_id.diagnosis.factor_rows import FactorRows
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.linearise import Fitted, Jackknife, Linearised, linearised
from consistent_id.diagnosis.whole_robot import contradicted
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.penalised import penalised_fit
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import Joint

# Twenty segments leave Student's t 19 degrees of freedom: it exceeds five once in ten
# thousand times by chance.
SURE = 5.0
"""Least ratio of an estimate to its standard error that is reported."""
# Clean logs show zero offsets of up to 2 degrees and gains of 0.1
# (benchmarks/faults_named.py), because friction and its smoothed edges differ from the
# model.
_ANGLE = np.radians(3.0)
_SLIDE = 0.015  # m
_HALF_TURN = np.pi  # a larger zero offset equals a smaller one
_LARGEST = np.radians(30.0)  # above, the linearisation has to converge
_FACTORS = (0.25, 4.0)  # of a torque; outside, it is another quantity
_SETTLED = 0.1  # share of a shift by which it may still change when converged
_ROUNDS = 8  # most linearisations, besides one for each wrong channel
_SHARE = 0.1  # of the squared misfit; in clean logs shifts explain up to 0.09
_ALIKE = 0.9  # share of the best explanation that rivals reach
_GAIN = 0.15  # relative

SHIFT_KINDS = ("offset zero", "torque gain")
"""Kinds of faults that the zeros and gains of joints are."""

# Share of the torque that zero offsets and gains have to explain.  Friction that no
# model has leaves 0.3 to 2 %; a zero offset may take up 0.6 % of that by chance.
_WORTH = 0.008
_LARGE = 2.0  # a gain with this score or more is large
_PULL = 1e-4  # weight of the squared distance to the nominal robot


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """Zero offsets and gains, each estimated without the others.

    Parameters
    ----------
    sizes, errors : ndarray, shape (joints + torque joints,), [rad or m; 1]
        To be added to the positions; and relative excess of the logged torque.  Errors
        are infinite where parameters have the same effect.
    misfits : ndarray, shape (joints + torque joints,)
        Misfit of the torque with each, relative to the joints' misfits.
    """

    sizes: Vector
    errors: Vector
    misfits: Vector


def estimate_shifts(system: Jackknife, beside: tuple[int, ...] = ()) -> Shifts:
    """Fit each zero offset and each gain, with the base parameters and some others.

    Parameters
    ----------
    system : Jackknife
        Columns of the zero offsets and gains.
    beside : tuple of int
        Indices of others that are wrong as well and are estimated together with it.
    """
    every = range(system.whole.shape[1] - 1)
    fits = [system.fitted([k, *(i for i in beside if i != k)]) for k in every]
    return Shifts(
        sizes=np.array([f.solution[0] for f in fits]),
        errors=np.array([f.errors[0] for f in fits]),
        misfits=np.array([f.misfit for f in fits]),
    )


def estimate_lag(system: Linearised, beside: Sequence[int] = ()) -> Fitted:
    """Fit the lag (first value of the solution) with some zero offsets and gains."""
    return system.with_lag.fitted([0, *(k + 1 for k in beside)])


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """Wrong zero offsets and gains.

    Parameters
    ----------
    sizes : ndarray, shape (joints + torque joints,), [rad or m; 1]
        As in `Shifts`; zero where no error is certain.
    scores : ndarray, shape (joints + torque joints,)
        Ratio to the least size, or to `SURE` standard errors, whichever is smaller.
    rivals : dict of int to tuple of int
        By index: others that alone would explain about as much.
    shifts : Shifts
        Last estimates, with corrected channels.
    systems : tuple of Linearised
        One for each recording, with corrected channels.
    """

    sizes: Vector
    scores: Vector
    rivals: dict[int, tuple[int, ...]]
    shifts: Shifts
    systems: tuple[Linearised, ...]


def moved_channels(
    model: TorqueModel, linearised_at: Callable[[Vector], Sequence[Linearised]]
) -> Moved:
    """Find wrong zero offsets and gains, one after another.

    The channel whose correction leaves the least misfit is corrected.  The others are
    then tried again, with the corrected log.  If none is certain alone, all zero
    offsets are tried together.

    Parameters
    ----------
    linearised_at : callable
        Function from the sizes of all shifts to the rows of all corrected recordings.
    """
    least = small_shifts(model)
    joints = len(model.robot)
    sizes = np.zeros(len(least))
    off: list[int] = []
    rivals: dict[int, tuple[int, ...]] = {}
    for _ in range(len(least) + _ROUNDS):
        systems = tuple(linearised_at(sizes))
        pooled = reduce(add, (system.without_lag for system in systems))
        shifts = estimate_shifts(pooled, tuple(off))
        found = _composed(sizes, shifts.sizes, joints)
        found[joints:] = np.clip(1.0 + found[joints:], *_FACTORS) - 1.0
        scores = _scores(found, least, shifts.errors)
        as_is = pooled.misfit(off)
        worth = shifts.misfits**2 <= (1.0 - _SHARE) * as_is**2
        fresh = (scores >= 1.0) & worth & ~np.isin(range(len(least)), off)
        rest = [int(k) for k in np.flatnonzero(fresh)]
        converged = abs(found - sizes) <= _SETTLED * abs(found)
        if rest:
            best = min(rest, key=lambda k: shifts.misfits[k])
            rivals[best] = _rivals(as_is, shifts, rest, best)
            off.append(best)
        elif not off and (several := _together(pooled, shifts, least[:joints])):
            off = list(several)
            found[off] = list(several.values())
        elif converged[off].all():
            break
        sizes[off] = found[off]
    shown = (abs(found) <= _LARGEST) | (converged & (abs(found) <= _HALF_TURN))
    low, high = _FACTORS
    shown[joints:] = (found[joints:] > low - 1.0) & (found[joints:] < high - 1.0)
    sure = np.isin(range(len(least)), off) & (scores >= 1.0) & shown
    return Moved(np.where(sure, found, 0.0), scores, rivals, shifts, systems)


def _rivals(
    as_is: float, shifts: Shifts, rest: list[int], best: int
) -> tuple[int, ...]:
    """Return the others that would explain about as much as the best."""
    explained = as_is**2 - shifts.misfits**2
    return tuple(
        k for k in rest if k != best and explained[k] >= _ALIKE * explained[best]
    )


def _composed(sizes: Vector, more: Vector, joints: int) -> Vector:
    """Return combined shifts: zero offsets add, factors of torque multiply."""
    both = sizes + more
    both[joints:] += sizes[joints:] * more[joints:]
    return both


def _together(system: Jackknife, alone: Shifts, least: Vector) -> dict[int, float]:
    """Return zero offsets that are certain only together: opposite ones cancel."""
    seen = np.flatnonzero(np.isfinite(alone.errors[: len(least)]))
    fit = system.fitted(seen.tolist())
    if fit.misfit**2 > (1.0 - _SHARE) * system.misfit([]) ** 2:
        return {}
    scores = _scores(fit.solution, least[seen], fit.errors)
    return {
        int(j): float(d)
        for j, d, score in zip(seen, fit.solution, scores, strict=True)
        if score >= 1.0
    }


def small_shifts(model: TorqueModel) -> Vector:
    """Return the least size of each shift that is reported, [rad or m; 1]."""
    slides = [joint.kind == "prismatic" for joint in model.robot.driven]
    zeros = np.where(slides, _SLIDE, _ANGLE)
    return np.append(zeros, np.full(len(model.torque_joints), _GAIN))


def _scores(sizes: Vector, least: Vector, errors: Vector) -> Vector:
    """Return ratios to the least sizes, or to `SURE` standard errors if smaller."""
    return np.minimum(abs(sizes) / least, abs(sizes) / (SURE * errors))


_BLIND = 10.0  # times the least size: zero offsets below it may stay unseen
_LAG = 0.012  # s: filters of currents cause less
LONG = 0.04  # s: filters and buses of real robots cause 15 to 40 ms
_LATE = 0.05  # s: a longer lag makes estimates wrong
# Share of the torque that a lag changes.  Filters of currents reach 0.03 in the usual
# motions of real robots.
_EFFECT = 0.04


def shift_findings(model: TorqueModel, moved: Moved) -> list[LogFinding]:
    """Report wrong zero offsets and gains.

    Where both explain a log equally well, neither is named as the cause.
    """
    found = []
    for k in np.flatnonzero(moved.sizes):
        finding = _shift(model, moved, int(k))
        others = [_shift(model, moved, i) for i in moved.rivals.get(int(k), ())]
        names = ", ".join(dict.fromkeys(f.where for f in (finding, *others)))
        if {f.kind for f in others} - {finding.kind}:
            finding = replace(
                finding,
                kind="model does not explain",
                where=names,
                statement=f"{finding.statement}; or another cause at {names}",
            )
        elif others:
            finding = replace(
                finding,
                where=names,
                statement=f"{finding.statement}; or it is another of {names}",
            )
        found.append(finding)
    return found


def _shift(model: TorqueModel, moved: Moved, place: int) -> LogFinding:
    joints = model.robot.driven
    size, score = float(moved.sizes[place]), float(moved.scores[place])
    if place < len(joints):
        return _zero(joints[place], size, score)
    return _gain(model.torque_joints[place - len(joints)], size, score)


def hidden_zeros(model: TorqueModel, moved: Moved) -> list[LogFinding]:
    """Note the joints whose zero offset the recordings do not identify."""
    joints = model.robot.driven
    reach = SURE * moved.shifts.errors
    hidden = [
        f"{joint.name} ({_from_where(joint, size)})"
        for joint, size, least in zip(joints, reach, small_shifts(model), strict=False)
        if size >= _BLIND * least
    ]
    if not hidden:
        return []
    return [
        LogFinding(
            "hidden zero",
            "note",
            "some joints",
            f"the log does not identify the zero offsets of {', '.join(hidden)}",
            "if they matter, move more widely and faster; no motion identifies the "
            "zero of an axis along gravity at the base, nor that of the last joint",
        )
    ]


def _from_where(joint: Joint, size: float) -> str:
    if joint.kind == "prismatic":
        return f"below {size:.2g} m" if np.isfinite(size) else "any length"
    degrees = float(np.degrees(size))
    return f"below {degrees:.2g} degrees" if degrees < 90.0 else "any angle"


def _zero(joint: Joint, d: float, score: float) -> LogFinding:
    slides = joint.kind == "prismatic"
    size = f"{abs(d):.2g} m" if slides else f"{np.degrees(abs(d)):.2g} degrees"
    larger, change = ("larger", "add {} to") if d > 0.0 else ("smaller", "take {} from")
    return LogFinding(
        "offset zero",
        "fault",
        joint.name,
        f"{joint.name}: its torque fits a position about {size} {larger}",
        f"{change.format(size)} the position of {joint.name} (--position-offset "
        f"{joint.name}={d:.3g}), or calibrate its zero; check again afterwards",
        float(score),
    )


def _gain(joint: str, c: float, score: float) -> LogFinding:
    return LogFinding(
        "torque gain",
        "fault",
        joint,
        f"{joint}: its torque is {1.0 + c:.3g} times the value that the other joints' "
        "torques imply",
        f"check the gain and gear ratio of {joint} (times {1.0 / (1.0 + c):.3g} would "
        "fit)",
        float(score),
        size=f"{1.0 + c:.3g}",
    )


def lag_findings(system: Linearised) -> list[LogFinding]:
    """Report torque that is later or earlier than the motion."""
    fit = estimate_lag(system)
    lag, error = abs(float(fit.solution[0])), float(fit.errors[0])
    score = min(lag / _LAG, lag / (SURE * error))
    if score < 1.0:
        return []
    effect = lag * system.quickness
    matters = lag >= LONG or effect >= _EFFECT
    later = "later" if fit.solution[0] > 0.0 else "earlier"
    return [
        LogFinding(
            "lag",
            "fault" if lag >= _LATE else "warning" if matters else "note",
            "all joints",
            f"the torque is {1e3 * lag:.3g} ms {later} than the motion, which changes "
            f"it by {effect:.1%}",
            "shift torque or motion in time before filtering",
            score,
            size=f"{fit.solution[0]:.3g}",
        )
    ]


@dataclass(frozen=True, eq=False)
class CommonShifts:
    """The zeros and gains that all logs show, found when first needed, and once.

    Parameters
    ----------
    logs : sequence of FittedLog
        Logs in which the same joints have a torque and move.
    """

    logs: Sequence[FittedLog]

    @cached_property
    def moved(self) -> Moved | None:
        """The zeros and gains; None if no robot explains the corrected logs."""
        try:
            return moved_channels(
                self.logs[0].factors.model,
                lambda sizes: [
                    _linearised(corrected_shifts(log, sizes)) for log in self.logs
                ],
            )
        except (InfeasibleError, SolverError):
            return None

    @cached_property
    def misfit(self) -> float:
        """The misfit of the corrected logs.

        It is zero if no robot explains them, so that nothing explains more.
        """
        if self.moved is None:
            return 0.0
        sizes = self.moved.sizes
        return together([corrected_shifts(log, sizes).misfit for log in self.logs])


def joint_shifts(shifts: CommonShifts) -> list[LogFinding]:
    """Find wrong zero offsets and gains in all logs together, and the lag of each."""
    logs, moved = shifts.logs, shifts.moved
    if moved is None:
        return []  # there is no correction
    model = logs[0].factors.model
    lags = [
        replace(f, recording=log.recording.name)
        for log, system in zip(logs, moved.systems, strict=True)
        for f in lag_findings(system)
    ]
    if any(f.severity == "fault" for f in lags):
        return lags  # with a large lag the linearisation is not valid
    found = shift_findings(model, moved)
    if found and _explained(logs, moved.sizes) < _WORTH:
        found = [_unsure(f) for f in found]
    elif found and _contradicted_shifts(logs, moved.sizes):
        found = [doubted(f) for f in found]
    return [*found, *hidden_zeros(model, moved), *lags]


def all_faults_are(kinds: Collection[str], found: Sequence[LogFinding]) -> bool:
    """Return whether there are faults, and all are of kinds that others look like."""
    faults = {f.kind for f in found if f.severity == "fault"}
    return bool(faults) and faults <= {*kinds}


def together(misfits: Sequence[float]) -> float:
    """Return the root of the mean square of logs' misfits."""
    return float(np.sqrt(np.mean(np.square(misfits))))


def _contradicted_shifts(logs: Sequence[FittedLog], sizes: Vector) -> bool:
    """Return whether nominal bodies contradict shifts; no, if they are not known."""
    model, known = logs[0].factors.model, masses_known(logs[0].constraints)
    if not bodies_known(model):
        return False
    as_is = FactorLogs.of(model, [log.recording for log in logs], masses_known=known)
    moved = [corrected_shifts(log, sizes).recording for log in logs]
    return contradicted(as_is, replace(as_is, rows=FactorRows(model, moved)))


def _explained(logs: Sequence[FittedLog], sizes: Vector) -> float:
    """Return the torque that shifts explain, relative to all torque."""
    left = [corrected_shifts(log, sizes).misfit for log in logs]
    gain = [log.misfit**2 - rest**2 for log, rest in zip(logs, left, strict=True)]
    return float(max(sum(gain) / len(gain), 0.0) ** 0.5)


def _unsure(finding: LogFinding) -> LogFinding:
    """Lower a finding that explains little to a note, or a large gain to a warning.

    Free masses can stand in for a gain, so that a wrong gain explains little more.
    """
    large = finding.kind == "torque gain" and finding.score >= _LARGE
    return replace(
        finding,
        severity="warning" if large else "note",
        statement=f"{finding.statement}, if nothing else is missing in the model",
    )


def corrected_shifts(log: FittedLog, sizes: Vector) -> FittedLog:
    """Return a log with corrected zero offsets and gains, fitted again."""
    if not sizes.any():
        return log
    model, recording = log.factors.model, log.recording
    count = len(model.robot)
    factor = np.ones(count)
    places = [model.robot.joint_names.index(name) for name in model.torque_joints]
    factor[places] += sizes[count:]

    def corrected(raw: Recording) -> Recording:
        position = raw.position + sizes[:count]
        return replace(raw, position=position, torque=np.asarray(raw.torque) / factor)

    moved = altered(recording, corrected)
    return fitted_log(model, moved, log.constraints, log.factors.base)


def _linearised(log: FittedLog) -> Linearised:
    """Linearise about the best fit; undetermined parameters take nominal values."""
    model, scaled = log.factors.model, log.fit.scaled
    distance = nominal_distance(model, "pullback", scaled.unit)
    x = penalised_fit(scaled, distance, _PULL).solution.u * scaled.unit
    return linearised(model, x, log.recording, log.factors.base)
