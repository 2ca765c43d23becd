"""Clock, gain, zeros, base and load, tested beside the robot's nominal bodies.

Some faults leave hardly a residual: with ``t -> 2 t``, a robot with four times the
inertia explains nearly all of a log.  So each is a factor ``f`` that is fitted together
with all parameters ``x``, while nominal bodies ``b0`` pull the bodies ``b`` of ``x``:

    minimise  sum_j ||(Y_j x + c_j f - tau_j) / s_j||^2 + ||(b - b0) / w||^2

``c_j`` is the derivative of the torque with respect to ``f``, and ``s_j`` the residual
of a joint in least squares, times the root of the number of samples over which it is
correlated.  The widths ``w`` are usual errors of nominal bodies: 5 % for masses, and 15
% and 30 % of the link's size for centres of mass and second moments.  Drives are free;
each joint gets a rotor inertia and friction that the model may lack.

The error of ``f`` combines two: that by bodies, which differ from nominal ones by the
widths ``w``, and that by noise.  The latter is the scatter when one of twenty segments
is left out (`Jackknife`), which contains errors of the model, and is at least that of
the likelihood (`benchmarks/coverage_bodies.py` measures how often the error holds).  A
reported factor has to exceed a more cautious error, which counts noise twice: the gates
were found for it.  A factor is the same in all logs.  If the logs disagree on its size,
a missing part of the model imitates the factor, and the error is multiplied by the
ratio of Birge (`_disagreement`).  Some robots' bodies have larger errors than these
widths.  That shows in the log without ``f``: the sum of squares then exceeds that
without the nominal bodies by more than one for each base parameter, and all widths are
multiplied by the root of that ratio.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import in_halves
from consistent_id.diagnosis.factor_findings import (
    FARTHEST,
    LIKELY,
    FoundFactor,
    doubted,
    effects,
    factor_findings,
    gate_of,
    harm,
    hidden_factors,
    promising,
    worth_a_look,
)
from consistent_id.diagnosis.factor_logs import (
    LEAN,
    FactorLogs,
    FactorSystem,
    drives_share,
    factor_system,
    factors_of,
    gain_of,
    leaning,
    least_costs,
    told_gains,
)
from consistent_id.diagnosis.factor_rows import Factor, FactorRows, relative_noise
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regressor import TorqueModel

_TURNS = 3  # most linearisations until the axis of a leaning base settles
_ROUNDS = 8  # most linearisations until a factor settles
_SETTLED = 0.02  # change of a factor at which rounds end
_LARGEST = 0.7  # change of a factor in one round, at most
_TRIED = 3  # most factors that are corrected


class _Sized(NamedTuple):
    """The size of a factor, its error, and the cautious one."""

    size: float
    error: float
    cautious: float


def whole_robot_factors(as_is: FactorLogs) -> list[FoundFactor]:
    """Estimate factors beside the nominal bodies, the best explanation first.

    Factors that may matter are removed from the logs, and the logs are linearised again
    until the factor converges, because the effect of large factors is not linear.

    Returns
    -------
    list of FoundFactor
        The factors that the logs determine.
    """
    factors = [*factors_of(as_is.model), *told_gains(as_is)]
    system = factor_system(as_is, factors)
    level = [k for k, f in enumerate(factors) if f.kind == "gravity"]
    first = [f for f in _alone(system, factors) if f.factor.kind != "gravity"]
    if level:
        turn = _turn(system, factors, level)
        if float(np.linalg.norm(turn)) >= LEAN:
            first += estimated(as_is, [_lean(as_is, turn)])
    likely = [f for f in first if promising(f)]
    cost = least_costs(as_is)[0] if likely else 0.0
    likely = [f for f in worth_a_look(as_is, likely, cost) if _sure(as_is, f)]
    likely = sorted(likely, key=lambda f: -f.explained)[:_TRIED]
    settled = list(in_halves(lambda found: _settled(as_is, found, cost), likely))
    rest = [f for f in first if f not in likely]
    found = [replace(f, cost=cost) for f in (*settled, *rest)]
    return sorted(_weighed(as_is, found), key=lambda f: -f.explained)


def _sure(as_is: FactorLogs, first: FoundFactor) -> bool:
    """Return whether a joint's gain is beyond its gate with the noise of logs without.

    What follows only adds to its error.  Other factors are not asked.
    """
    factor, size = first.factor, first.size
    if factor.kind != "torque gain":
        return True
    without = as_is.without(factor, size)
    found = estimated(replace(without, noise=relative_noise(without.rows)), [factor])
    return any(abs(size + f.size) >= gate_of(factor) * f.cautious for f in found)


def _weighed(as_is: FactorLogs, found: Sequence[FoundFactor]) -> list[FoundFactor]:
    """Add what each factor, or as much as its error, would mean for an estimate."""
    if not found:
        return []
    units, weighed = effects(as_is, [f.factor for f in found]), []
    drives = drives_share(as_is)
    for one, unit in zip(found, units, strict=True):
        factor, error = one.factor, min(one.cautious, FARTHEST[one.factor.kind])
        doubt = harm(as_is, factor, error) if factor.kind == "clock" else unit * error
        likely = one.ratio >= gate_of(factor) and abs(one.size) >= factor.least
        harms = harm(as_is, factor, one.size) if likely else unit * abs(one.size)
        weighed.append(
            replace(one, harm=float(harms), doubt=float(doubt), drives=drives)
        )
    return weighed


def _turn(system: FactorSystem, factors: Sequence[Factor], level: list[int]) -> Vector:
    """Return the turn of gravity about two level axes together, a vector [rad]."""
    angles = system.solution(level)
    return np.asarray(angles @ np.array([factors[k].axis for k in level]))


def _lean(as_is: FactorLogs, turn: Vector) -> Factor:
    """Return the factor of a base that leans about the most likely axis.

    The axis is that of the turn from the model's gravity to the gravity found.
    """
    gravity = np.asarray(as_is.model.robot.gravity)
    state, axis = as_is, turn
    for _ in range(_TURNS):
        size = float(np.linalg.norm(turn))
        if size == 0.0:
            break
        turned = leaning(state.model, tuple(turn / size), min(size, _LARGEST))
        axis = np.cross(gravity, np.asarray(turned.robot.gravity))
        state = replace(state, rows=FactorRows(turned, state.logs))
        factors = [f for f in factors_of(state.model) if f.kind == "gravity"]
        turn = _turn(factor_system(state, factors, scatter=False), factors, [0, 1])
    axis = axis / np.linalg.norm(axis)
    return Factor("gravity", "base", LEAN, axis=tuple(axis.tolist()))


def _settled(as_is: FactorLogs, first: FoundFactor, cost: float) -> FoundFactor:
    """Estimate a factor anew with the logs without it, until it changes little.

    The residual of the logs as they are contains the fault itself.  So the noise is
    estimated again from the logs without it.

    Parameters
    ----------
    first : FoundFactor
        The factor estimated from the unchanged logs.
    cost : float
        Least sum of squares of the unchanged logs.
    """
    factor = first.factor
    size = converged(as_is, first).size
    without = as_is.without(factor, size)
    explained = cost - least_costs(without)[0]
    state = replace(as_is, noise=relative_noise(without.rows))
    found = _converged_from(state, factor, size)
    left, of_drives = least_costs(state.without(factor, found.size))
    bodies, inertial = left - of_drives, body_parameters(as_is.model)
    if bodies > inertial:
        state = replace(state, widths=state.widths * np.sqrt(bodies / inertial))
        found = _converged_from(state, factor)
    wider = _disagreement(state, factor)
    error, cautious = wider * found.error, wider * found.cautious
    return FoundFactor(factor, found.size, error, cautious, explained)


def _disagreement(state: FactorLogs, factor: Factor) -> float:
    """Return the scatter of logs over that which their errors allow, at least one.

    With sizes ``f_k`` and errors ``s_k`` of ``n`` logs by themselves, and the mean
    ``f`` of the sizes weighted with ``1 / s_k^2``, it is the ratio of Birge,
    ``sqrt(sum_k (f_k - f)^2 / s_k^2 / (n - 1))``.
    """
    if len(state.logs) < 2:
        return 1.0
    alone = [replace(state, rows=FactorRows(state.model, [log])) for log in state.logs]
    found = np.array([_converged_from(one, factor) for one in alone])
    sizes, _, errors = found[np.isfinite(found[:, 2])].T
    if len(sizes) < 2:
        return 1.0
    mean = np.average(sizes, weights=errors**-2)
    squares = float(np.sum(((sizes - mean) / errors) ** 2)) / (len(sizes) - 1)
    return max(float(np.sqrt(squares)), 1.0)


def _converged_from(state: FactorLogs, factor: Factor, start: float = 0.0) -> _Sized:
    """Return the size and the errors to which a factor converges from a first size."""
    first = state.without(factor, start)
    step = _step(first, factor)
    if step is None:
        return _Sized(start, np.inf, np.inf)
    size, last = _in_rounds(state, factor, (start, step))
    return _with_errors(size, last or first, factor)


def converged(as_is: FactorLogs, first: FoundFactor, start: float = 0.0) -> _Sized:
    """Return the size and the errors to which a factor converges.

    Parameters
    ----------
    first : FoundFactor
        The factor estimated from logs without the first size.
    """
    size, last = _in_rounds(as_is, first.factor, (start, first.size))
    if last is None:
        return _Sized(size, first.error, first.cautious)
    return _with_errors(size, last, first.factor)


def _in_rounds(
    as_is: FactorLogs, factor: Factor, first: tuple[float, float]
) -> tuple[float, FactorLogs | None]:
    """Return the size to which steps converge, and the last logs linearised for one.

    Steps of linearised logs may go to and fro between two sizes.  Where two of them
    point at each other, what is left of the factor is zero in between.

    Parameters
    ----------
    first : (float, float)
        A size, and the step from it.
    """
    (size, found), last = first, None
    left: dict[bool, tuple[float, float]] = {}  # by sign: a size, and what it leaves
    for _ in range(_ROUNDS):
        step = float(np.clip(found, -_LARGEST, _LARGEST))
        left[step > 0.0] = size, step
        if len(left) == 2:
            (low, up), (high, down) = left[True], left[False]
            if abs(step) > 0.5 * abs(high - low):
                step = (low * down - high * up) / (down - up) - size
        size += step
        if abs(step) <= _SETTLED:
            break
        moved = as_is.without(factor, size)
        further = _step(moved, factor)
        if further is None:
            break
        found, last = further, moved
    return size, last


def _step(state: FactorLogs, factor: Factor) -> float | None:
    """Linearise once, and return the size of a factor alone; None if there is none.

    Errors, which take most of the time, are needed of the last round alone; but the
    size of all gains together depends on them.
    """
    if factor.kind == "masses or gain":
        found = estimated(state, [factor])
        return found[0].size if found else None
    system = factor_system(state, [factor], scatter=False)
    if np.linalg.norm(system.whole[:, 0]) == 0.0:
        return None
    return float(system.solution([0])[0])


def _with_errors(size: float, state: FactorLogs, factor: Factor) -> _Sized:
    """Return a size with the errors of the factor in linearised logs."""
    found = estimated(state, [factor])
    if not found:
        return _Sized(size, np.inf, np.inf)
    return _Sized(size, found[0].error, found[0].cautious)


def estimated(state: FactorLogs, factors: Sequence[Factor]) -> list[FoundFactor]:
    """Linearise once, and estimate each factor without the others."""
    return _alone(factor_system(state, factors), factors)


def _alone(system: FactorSystem, factors: Sequence[Factor]) -> list[FoundFactor]:
    """Estimate each factor without the others; those that the logs determine."""
    found = []
    for k, factor in enumerate(factors):
        if np.linalg.norm(system.whole[:, k]) == 0.0:
            continue
        one = _by_least_squares(system, k, factor)
        if factor.kind == "masses or gain":
            one = _nearer_to_none(one, _by_nominal(system, k, len(factors), factor))
        found.append(one)
    return found


def _by_least_squares(system: FactorSystem, k: int, factor: Factor) -> FoundFactor:
    column, z = system.whole[:, k], system.whole[:, -1]
    fit = system.fitted([k])
    explained = float(z @ z) - fit.misfit**2
    norm = float(np.linalg.norm(column))
    errors = _errors(float(fit.errors[0]), norm, float(system.pulled[k]), norm**2)
    return FoundFactor(factor, float(fit.solution[0]), *errors, explained)


def _errors(
    scatter: float, norm: float, pulled: float, slope: float
) -> tuple[float, float]:
    """Return the error of a factor ``w^T z / slope``, and the cautious one.

    Parameters
    ----------
    scatter : float
        Over segments.
    norm, pulled : float
        Norm of ``w``, and the square of its part in rows of nominal bodies.
    """
    by_bodies = min(pulled, norm**2) / slope**2
    by_noise = max(scatter**2, norm**2 / slope**2 - by_bodies)
    return float(np.sqrt(by_bodies + by_noise)), float(np.hypot(scatter, norm / slope))


def _by_nominal(
    system: FactorSystem, k: int, instrument: int, factor: Factor
) -> FoundFactor:
    """Estimate a factor with its column of nominal bodies as the instrument."""
    w, column, z = (system.whole[:, j] for j in (instrument, k, -1))
    fit = system.by_instrument(k, instrument)
    if not np.isfinite(fit.errors[0]):
        return FoundFactor(factor, 0.0, np.inf, np.inf, 0.0)
    pulled, norm = float(system.pulled[instrument]), float(np.linalg.norm(w))
    errors = _errors(float(fit.errors[0]), norm, pulled, float(w @ column))
    explained = float((w @ z) ** 2 / (w @ w))
    return FoundFactor(factor, float(fit.solution[0]), *errors, explained)


def _nearer_to_none(one: FoundFactor, other: FoundFactor) -> FoundFactor:
    """Return the smaller of two estimates of a gain, or none if their signs differ.

    A gain scales all bodies.  Least squares prefers small bodies, because their errors
    are smaller in proportion.  Nominal bodies as the instrument do not, but the result
    depends on single bodies that are badly known.  A gain is certain only if both show
    it.
    """
    nearer = min(one, other, key=lambda f: abs(f.size))
    if one.size * other.size > 0.0:
        return nearer
    errors = max(one.error, other.error), max(one.cautious, other.cautious)
    return FoundFactor(one.factor, 0.0, *errors, 0.0)


def gain_beside_bodies(as_is: FactorLogs, joint: str) -> FoundFactor | None:
    """Estimate the gain of one joint's torque beside the nominal bodies.

    The gain is the part of the torque that neither bodies with usual errors nor the
    other joints, which carry the same bodies, explain.

    Returns
    -------
    FoundFactor or None
        None if the logs do not determine it.
    """
    found = estimated(as_is, [gain_of(as_is.model, joint)])
    if not found or not np.isfinite(found[0].error):
        return None
    cost = least_costs(as_is)[0]
    return replace(_settled(as_is, found[0], cost), cost=cost)


def weighed_gain(finding: LogFinding, as_is: FactorLogs) -> LogFinding:
    """Turn the gain of a joint into a note where its bodies alone may explain it.

    Parameters
    ----------
    finding : LogFinding
        A finding whose size is the slope on the joint's nominal torque.
    as_is : FactorLogs
        All logs in which the same joints have a torque.
    """
    found = gain_beside_bodies(as_is, finding.where)
    slope = float(np.log(float(finding.size)))
    if found and found.ratio >= LIKELY and found.size * slope > 0.0:
        if abs(found.size) >= found.factor.least:
            return finding
    seen = "do not show its gain"
    if found:
        gain = float(np.exp(found.size))
        seen = f"show a gain of {gain:.2f} +- {gain * found.error:.2f}"
    return replace(
        finding,
        severity="note",
        statement=f"{finding.statement}; beside bodies that differ from the model's as "
        f"far as usual, all joints together {seen}: bodies explain it",
        advice="an estimate of all parameters does not need the model's bodies; "
        "correct these where they are used themselves",
    )


def contradicted(as_is: FactorLogs, corrected: FactorLogs) -> bool:
    """Return whether nominal bodies contradict a correction of logs.

    With the correction, misfit and distance of the bodies are then larger together
    than without it.  The noise is the smaller one of both.
    """
    noise = np.minimum(as_is.noise, relative_noise(corrected.rows))
    before, after = (
        least_costs(replace(logs, noise=noise))[0] for logs in (as_is, corrected)
    )
    return after > before


def doubted_gain(finding: LogFinding, as_is: FactorLogs) -> LogFinding:
    """Turn a gain of all joints into a note if nominal bodies contradict it."""
    factor = next(f for f in factors_of(as_is.model) if f.where == "all joints")
    without = as_is.without(factor, float(np.log(float(finding.size))))
    if not contradicted(as_is, without):
        return finding
    return doubted(finding)


def whole_robot_findings(as_is: FactorLogs) -> list[LogFinding]:
    """Report the factor that explains most, others that explain as much, and doubts."""
    found = whole_robot_factors(as_is)
    return [
        *factor_findings(as_is.model, found),
        *hidden_factors(as_is.model, found),
    ]


def body_parameters(model: TorqueModel) -> int:
    """Return the number of base parameters of bodies."""
    size = model.layout.inertial_size
    return sum(k < size for k in base_parameters(model).independent)
