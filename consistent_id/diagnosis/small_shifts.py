"""Zeros that are a little off, and torque that lags: found by linearisation.

Near the truth the torque changes by ``d_j dtau/dq_j`` for a zero that is off by
``d_j``, and by ``-t dtau/dt`` for a torque that lags by ``t``.  Zeros are tried one at
a time beside the parameters and the lag: what the parameters can take over is not
theirs, and a robot with one zero off needs no other to explain it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.findings import Finding
from consistent_id.diagnosis.jackknife import Fitted
from consistent_id.diagnosis.linearise import Linearised
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import Joint

# Twenty segments leave Student's t 19 degrees of freedom: it exceeds five once in ten
# thousand times by chance.
_SURE = 5.0  # estimates over their standard errors that are reported
_ANGLE = np.radians(1.0)
_SLIDE = 0.005  # m
_BLIND = 10.0  # times these sizes, from which on a zero that hides is worth a note
_LAG = 0.012  # s: less is what filters of currents do
_LATE = 0.05  # s: a drive's filters and a bus reach 15 to 40 ms in real robots
_LARGEST = np.radians(30.0)  # beyond which linearisation is believed of no zero


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """Zeros' offsets, each estimated without the others, and the lag.

    Parameters
    ----------
    offsets, offset_errors : ndarray, shape (joints,), [rad or m]
        To be added to the positions; standard errors are infinite where parameters can
        take the offset over.
    misfits : ndarray, shape (joints,)
        What is left of the torque with each, relative to the joints' misfits.
    lag, lag_error : float, [s]
        Of the torque behind the motion.
    """

    offsets: Vector
    offset_errors: Vector
    misfits: Vector
    lag: float
    lag_error: float


def estimate_shifts(system: Linearised, beside: tuple[int, ...] = ()) -> Shifts:
    """Fit each zero's offset beside the base parameters, the lag, and some zeros.

    Parameters
    ----------
    system : Linearised
    beside : tuple of int
        Joints whose zeros are off as well; they are estimated together.
    """
    zeros = range(system.joints)
    fits = [_fit(system, (j, *(i for i in beside if i != j))) for j in zeros]
    lag = _fit(system, beside)
    return Shifts(
        offsets=np.array([f.solution[0] for f in fits]),
        offset_errors=np.array([f.errors[0] for f in fits]),
        misfits=np.array([f.misfit for f in fits]),
        lag=float(lag.solution[-1]),
        lag_error=float(lag.errors[-1]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Zeros:
    """Zeros that are off, and the lag beside them.

    Parameters
    ----------
    offsets : ndarray, shape (joints,), [rad or m]
        To be added to the positions; zero where nothing is sure.
    scores : ndarray, shape (joints,)
        How far they are beyond what is small or unsure.
    shifts : Shifts
        As they were estimated last, positions corrected.
    """

    offsets: Vector
    scores: Vector
    shifts: Shifts


def moved_zeros(
    model: TorqueModel, linearised_at: Callable[[Vector], Linearised]
) -> Zeros:
    """Find zeros that are off, one after another.

    That which, moved, leaves the least misfit is moved, and the others are tried again
    beside it.  If none is sure alone, all are tried together.

    Parameters
    ----------
    model : TorqueModel
    linearised_at : callable
        From offsets of all joints [rad or m] to the rows with positions so corrected.
    """
    joints, least = model.robot.driven, _small(model)
    moved = np.zeros(len(joints))
    off: tuple[int, ...] = ()
    while True:
        system = linearised_at(moved)
        shifts = estimate_shifts(system, off)
        sizes = moved + shifts.offsets
        scores = _scores(sizes, least, shifts.offset_errors)
        rest = [j for j in range(len(joints)) if j not in off and scores[j] >= 1.0]
        if rest:
            off = (*off, min(rest, key=lambda j: shifts.misfits[j]))
            moved[list(off)] = sizes[list(off)]
        elif not off and (several := _together(system, shifts, least)):
            off = tuple(several)
            moved[list(off)] = list(several.values())
        else:
            break
    turns = np.array([joint.kind != "prismatic" for joint in joints])
    possible = ~turns | (abs(moved) <= _LARGEST)
    sure = np.isin(range(len(joints)), off) & (scores >= 1.0) & possible
    return Zeros(np.where(sure, sizes, 0.0), scores, shifts)


def _together(system: Linearised, alone: Shifts, least: Vector) -> dict[int, float]:
    """Return zeros that are sure only beside each other: opposite ones hide."""
    seen = np.flatnonzero(np.isfinite(alone.offset_errors))
    fit = _fit(system, tuple(seen.tolist()))
    sizes = fit.solution[:-1]
    scores = _scores(sizes, least[seen], fit.errors[:-1])
    return {
        int(j): float(d)
        for j, d, score in zip(seen, sizes, scores, strict=True)
        if score >= 1.0
    }


def shift_findings(model: TorqueModel, zeros: Zeros) -> list[Finding]:
    """Report zeros that are off, and a lag."""
    found = [
        _zero(joint, d, score)
        for joint, d, score in zip(
            model.robot.driven, zeros.offsets, zeros.scores, strict=True
        )
        if d != 0.0
    ]
    return found + _lags(zeros.shifts)


def hidden_zeros(model: TorqueModel, zeros: Zeros) -> list[Finding]:
    """Note the joints whose zero offset the log does not identify."""
    reach = _SURE * zeros.shifts.offset_errors
    hidden = [
        f"{joint.name} ({_from_where(joint, size)})"
        for joint, size, least in zip(
            model.robot.driven, reach, _small(model), strict=True
        )
        if size >= _BLIND * least
    ]
    if not hidden:
        return []
    return [
        Finding(
            "hidden zero",
            "note",
            "some joints",
            f"the log does not identify the zero offsets of {', '.join(hidden)}",
            "where it matters, move more widely and faster; no motion identifies the "
            "zero of an axis along gravity at the base, nor that of the last joint",
        )
    ]


def _from_where(joint: Joint, size: float) -> str:
    if joint.kind == "prismatic":
        return f"below {size:.2g} m" if np.isfinite(size) else "any length"
    degrees = float(np.degrees(size))
    return f"below {degrees:.2g} degrees" if degrees < 90.0 else "any angle"


def _small(model: TorqueModel) -> Vector:
    """Return what of each joint's zero is too small to be reported, [rad or m]."""
    slides = [joint.kind == "prismatic" for joint in model.robot.driven]
    return np.where(slides, _SLIDE, _ANGLE)


def _scores(sizes: Vector, least: Vector, errors: Vector) -> Vector:
    """Return how far sizes are beyond what is small, and beyond what is unsure."""
    return np.minimum(abs(sizes) / least, abs(sizes) / (_SURE * errors))


def _zero(joint: Joint, d: float, score: float) -> Finding:
    slides = joint.kind == "prismatic"
    size = f"{abs(d):.2g} m" if slides else f"{np.degrees(abs(d)):.2g} degrees"
    larger, change = ("larger", "add {} to") if d > 0.0 else ("smaller", "take {} from")
    return Finding(
        "offset zero",
        "fault",
        joint.name,
        f"{joint.name}: its torque fits a position some {size} {larger}",
        f"{change.format(size)} the position of {joint.name}, or calibrate its zero; "
        "check again afterwards",
        float(score),
    )


def _lags(shifts: Shifts) -> list[Finding]:
    lag, error = shifts.lag, shifts.lag_error
    score = min(abs(lag) / _LAG, abs(lag) / (_SURE * error))
    if score < 1.0:
        return []
    later = "later" if lag > 0.0 else "earlier"
    return [
        Finding(
            "lag",
            "fault" if abs(lag) >= _LATE else "warning",
            "all joints",
            f"the torque is {1e3 * abs(lag):.3g} ms {later} than the motion",
            "shift one against the other before filtering",
            score,
        )
    ]


def _fit(system: Linearised, zeros: tuple[int, ...]) -> Fitted:
    """Fit some zeros, in their order, and the lag last."""
    return system.factors.fitted([*zeros, system.joints])
