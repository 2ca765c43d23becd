"""Small errors of joint zero offsets and gains, and lags, found by linearisation.

Near the truth the torque changes by ``d_j dtau/dq_j`` for a zero offset of ``d_j``, by
``c_j tau_j`` for a torque that is logged ``1 + c_j`` times as large, and by ``-t
dtau/dt`` for a lag of ``t``.  Gains can be seen because several joints carry one body.
Zero offsets and gains are tried one at a time beside the parameters and the lag: only
torque that the parameters cannot explain is attributed to them, and a robot with one
wrong zero offset needs no other.  All recordings of a robot are used together, each
with parameters and a lag of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.linearise import Fitted, Jackknife, Linearised
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
