"""Clock, gain, zeros, base and load, tested beside the robot's nominal bodies.

Some faults leave hardly a residual: with ``t -> 2 t``, a robot with four times the
inertia explains nearly all of a log.  So each is a factor ``f`` that is fitted together
with all parameters ``x``, while nominal bodies ``b0`` pull the bodies ``b`` of ``x``:

    minimise  sum_j ||(Y_j x + c_j f - tau_j) / s_j||^2 + ||(b - b0) / w||^2

``c_j`` is the derivative of the torque with respect to ``f``, and ``s_j`` the residual
of a joint in least squares, times the root of the number of samples over which it is
correlated.  The widths ``w`` say how well bodies are usually known: masses to 5 %,
centres of mass to 15 % and second moments to 30 % of the link's size.  Drives are free;
each joint gets a rotor inertia and friction that the model may lack.

The error of ``f`` joins two: that of the likelihood, and the scatter when one of twenty
segments is left out (`Jackknife`), which contains what the model does not explain.
Noise is in both, so the error is too large where nothing else is wrong
(`benchmarks/coverage_bodies.py` measures the zero of a joint).
A factor is the same in all logs.  Where each log by itself gives another size, what the
model lacks stands in for the factor, and the error grows by the ratio of Birge
(`_disagreement`).
Some robots' bodies are worse known than the widths say.  That shows when ``f`` is taken
out of the log: the sum of squares then exceeds that without the nominal bodies by more
than one for each base parameter, and all widths are multiplied by the root of that
ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.factor_rows import (
    LEAN,
    Factor,
    FactorLogs,
    FactorRows,
    factor_system,
    factors_of,
    gain_of,
    leaning,
    least_costs,
    least_misfit,
    relative_noise,
)
from consistent_id.diagnosis.findings import LogFinding, Severity
from consistent_id.diagnosis.linearise import Jackknife
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regressor import TorqueModel

_TURNS = 3  # most linearisations until the axis of a leaning base settles
_ROUNDS = 8  # most linearisations until a factor settles
_SETTLED = 0.02  # change of a factor at which it has settled
_LARGEST = 0.7  # change of a factor in one round, at most
_TRIED = 3  # factors that are corrected, of those that explain most
_ALIKE = 0.8  # share of the best explanation that rivals reach

# Standard errors from which on a factor is a warning, and a fault.  Of right logs of
# four real arms (benchmarks/whole_robot.py), the largest are 2.2 for the clock, 2.7 for
# zeros up to `_FARTHEST`; for gains 1.4, and 2.7 for a KUKA whose counterbalance its
# model lacks: that is a warning.  A Z1, nearly all friction, has 3.8 for a zero and 3.0
# for the base, which explain too little to be named (`_MUCH`).
_LIKELY, _SURE = 3.0, 5.0
_LIKELY_ONE = 2.5  # the same for clock and gain: there is one of each, not one a joint
# What nominal bodies cost for each base parameter, and what least squares leaves of the
# torque, at which one alone is enough.  Of right logs of five real arms, up to 6.1 and
# 0.12; of 36 simulated logs of other arms, 2 to 310 and 0.03 to 0.34.
_OTHER, _UNEXPLAINED = 10.0, 0.2
_USUAL = 1.0  # bodies as near as this once a factor is free are those of the model
_AS_RIGHT = 0.12  # the largest of these right logs
# Share of the squares that a zero or a lean has to explain.  Where drives take most of
# the torque, friction that varies with position looks like one: in logs of two robots
# up to 0.028, at 4 to 6 standard errors.  Faults of four arms explain 0.048 to 0.91.
_MUCH = {"offset zero": 0.03, "gravity": 0.03}
_LARGE = 2.0  # times the least size that is reported: a fault
_FARTHEST = {  # beyond, it is another fault: another unit, another channel
    "clock": float(np.log(10.0)),
    "masses or gain": float(np.log(3.0)),
    "offset zero": float(np.radians(45.0)),  # or m
    "gravity": float(np.pi),
}


@dataclass(frozen=True, slots=True, eq=False)
class FoundFactor:
    """A factor as it was estimated.

    Parameters
    ----------
    size, error : float
        In the units of `Factor.least`; the log is right with the size taken out.
    explained : float
        Decrease of the sum of squares, in squared noise.
    cost : float
        The sum of squares of the logs as they are.
    """

    factor: Factor
    size: float
    error: float
    explained: float
    cost: float = 0.0

    @property
    def ratio(self) -> float:
        """Size over standard error."""
        return abs(self.size) / self.error


def whole_robot_factors(as_is: FactorLogs) -> list[FoundFactor]:
    """Estimate factors beside the nominal bodies, the best explanation first.

    Factors that may matter are taken out of the logs, and the logs are linearised
    again, until the factor settles: the effect of large ones is not linear.

    Returns
    -------
    list of FoundFactor
        Those that the logs determine.
    """
    factors = factors_of(as_is.model)
    system = factor_system(as_is, factors)
    level = [k for k, f in enumerate(factors) if f.kind == "gravity"]
    first = [f for f in _alone(system, factors) if f.factor.kind != "gravity"]
    if level:
        turn = _turn(system, factors, level)
        if float(np.linalg.norm(turn)) >= LEAN:
            first += _estimated(as_is, [_lean(as_is, turn)])
    likely = [f for f in first if f.ratio >= _gate(f.factor)]
    likely = sorted(likely, key=lambda f: -f.explained)[:_TRIED]
    cost = least_costs(as_is)[0] if likely else 0.0
    settled = [_settled(as_is, found, cost) for found in likely]
    rest = [f for f in first if f not in likely]
    found = [replace(f, cost=cost) for f in (*settled, *rest)]
    return sorted(found, key=lambda f: -f.explained)


def _turn(system: Jackknife, factors: Sequence[Factor], level: list[int]) -> Vector:
    """Return the turn of gravity about two level axes together, a vector [rad]."""
    angles = system.solution(level)
    return np.asarray(angles @ np.array([factors[k].axis for k in level]))


def _lean(as_is: FactorLogs, turn: Vector) -> Factor:
    """Return the factor of a base that leans about the axis that explains most.

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
        As it was estimated from the logs as they are.
    cost : float
        Least sum of squares of the logs as they are.
    """
    factor = first.factor
    size, _ = _converged(as_is, first)
    without = as_is.without(factor, size)
    explained = cost - least_costs(without)[0]
    state = replace(as_is, noise=relative_noise(without.rows))
    size, error = _converged_from(state, factor, size)
    left, of_drives = least_costs(state.without(factor, size))
    bodies, inertial = left - of_drives, _inertial(as_is.model)
    if bodies > inertial:
        state = replace(state, widths=state.widths * np.sqrt(bodies / inertial))
        size, error = _converged_from(state, factor)
    error *= _disagreement(state, factor)
    return FoundFactor(factor, size, error, explained)


def _disagreement(state: FactorLogs, factor: Factor) -> float:
    """Return how much farther apart logs are than their errors allow, at least one.

    With sizes ``f_k`` and errors ``s_k`` of ``n`` logs by themselves, and the mean
    ``f`` of the sizes weighted with ``1 / s_k^2``, it is the ratio of Birge,
    ``sqrt(sum_k (f_k - f)^2 / s_k^2 / (n - 1))``.
    """
    if len(state.logs) < 2:
        return 1.0
    alone = [replace(state, rows=FactorRows(state.model, [log])) for log in state.logs]
    found = np.array([_converged_from(one, factor) for one in alone])
    sizes, errors = found[np.isfinite(found[:, 1])].T
    if len(sizes) < 2:
        return 1.0
    mean = np.average(sizes, weights=errors**-2)
    squares = float(np.sum(((sizes - mean) / errors) ** 2)) / (len(sizes) - 1)
    return max(float(np.sqrt(squares)), 1.0)


def _converged_from(
    state: FactorLogs, factor: Factor, start: float = 0.0
) -> tuple[float, float]:
    """Return the size and the error with which a factor settles, from a first size."""
    found = _estimated(state.without(factor, start), [factor])
    return _converged(state, found[0], start) if found else (start, np.inf)


def _converged(
    as_is: FactorLogs, first: FoundFactor, start: float = 0.0
) -> tuple[float, float]:
    """Return the size and the error with which a factor settles.

    Parameters
    ----------
    first : FoundFactor
        As it was estimated with the first size taken out of the logs.
    """
    size, found = start, [first]
    for _ in range(_ROUNDS):
        step = float(np.clip(found[0].size, -_LARGEST, _LARGEST))
        size, error = size + step, found[0].error
        if abs(step) <= _SETTLED:
            break
        found = _estimated(as_is.without(first.factor, size), [first.factor])
        if not found:
            break
    return size, error


def _estimated(state: FactorLogs, factors: Sequence[Factor]) -> list[FoundFactor]:
    """Linearise once, and estimate each factor without the others."""
    return _alone(factor_system(state, factors), factors)


def _alone(system: Jackknife, factors: Sequence[Factor]) -> list[FoundFactor]:
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


def _by_least_squares(system: Jackknife, k: int, factor: Factor) -> FoundFactor:
    column, z = system.whole[:, k], system.whole[:, -1]
    fit = system.fitted([k])
    error = float(np.hypot(fit.errors[0], 1.0 / np.linalg.norm(column)))
    explained = float(z @ z) - fit.misfit**2
    return FoundFactor(factor, float(fit.solution[0]), error, explained)


def _by_nominal(
    system: Jackknife, k: int, instrument: int, factor: Factor
) -> FoundFactor:
    """Estimate a factor with its column of nominal bodies as the instrument."""
    w, column, z = (system.whole[:, j] for j in (instrument, k, -1))
    fit = system.by_instrument(k, instrument)
    if not np.isfinite(fit.errors[0]):
        return FoundFactor(factor, 0.0, np.inf, 0.0)
    error = float(np.hypot(fit.errors[0], np.linalg.norm(w) / (w @ column)))
    explained = float((w @ z) ** 2 / (w @ w))
    return FoundFactor(factor, float(fit.solution[0]), error, explained)


def _nearer_to_none(one: FoundFactor, other: FoundFactor) -> FoundFactor:
    """Return the smaller of two estimates of a gain, or none if their signs differ.

    A gain scales all bodies.  Least squares prefers small bodies, because their errors
    are as much smaller; nominal bodies as the instrument do not, but depend on single
    bodies that are badly known.  What only one of both shows is not certain.
    """
    nearer = min(one, other, key=lambda f: abs(f.size))
    if one.size * other.size > 0.0:
        return nearer
    return FoundFactor(one.factor, 0.0, max(one.error, other.error), 0.0)


def gain_beside_bodies(as_is: FactorLogs, joint: str) -> FoundFactor | None:
    """Estimate the gain of one joint's torque beside the nominal bodies.

    Other joints carry the same bodies, and bodies differ from nominal ones as far as
    usual: what both leave is the joint's own gain.

    Returns
    -------
    FoundFactor or None
        None if the logs do not determine it.
    """
    found = _estimated(as_is, [gain_of(as_is.model, joint)])
    if not found or not np.isfinite(found[0].error):
        return None
    cost = least_costs(as_is)[0]
    return replace(_settled(as_is, found[0], cost), cost=cost)


def weighed_gain(finding: LogFinding, as_is: FactorLogs) -> LogFinding:
    """Turn the gain of a joint into a note where its bodies alone may explain it.

    Parameters
    ----------
    finding : LogFinding
        Its size is that of the slope on the joint's nominal torque.
    as_is : FactorLogs
        All logs in which the same joints have a torque.
    """
    found = gain_beside_bodies(as_is, finding.where)
    slope = float(np.log(float(finding.size)))
    if found and found.ratio >= _LIKELY and found.size * slope > 0.0:
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
    """Return whether nominal bodies speak against a correction of logs.

    With the correction, misfit and distance of the bodies are then larger together
    than without it.  The noise is the smaller one of both.
    """
    noise = np.minimum(as_is.noise, relative_noise(corrected.rows))
    before, after = (
        least_costs(replace(logs, noise=noise))[0] for logs in (as_is, corrected)
    )
    return after > before


def doubted_gain(finding: LogFinding, as_is: FactorLogs) -> LogFinding:
    """Turn a gain of all joints into a note where nominal bodies speak against it."""
    factor = next(f for f in factors_of(as_is.model) if f.where == "all joints")
    without = as_is.without(factor, float(np.log(float(finding.size))))
    if not contradicted(as_is, without):
        return finding
    return doubted(finding)


def doubted(finding: LogFinding) -> LogFinding:
    """Turn a finding that nominal bodies contradict into a note."""
    return replace(
        finding,
        severity="note",
        statement=f"{finding.statement}; but bodies would then be farther from the "
        "model's, by more than the torque gains by it: bodies explain it",
        advice="nothing, if the model's bodies are nearly right; else "
        f"{finding.advice}",
    )


def whole_robot_findings(as_is: FactorLogs) -> list[LogFinding]:
    """Report the factor that explains most, and others that explain as much."""
    return factor_findings(as_is.model, whole_robot_factors(as_is))


def factor_findings(
    model: TorqueModel, found: Sequence[FoundFactor]
) -> list[LogFinding]:
    """Report factors that were estimated, see `whole_robot_factors`."""
    shown = [f for f in found if _shown(f)]
    if not shown:
        return []
    best, *others = shown
    rivals = [f for f in others if f.explained >= _ALIKE * best.explained]
    sure = best.ratio >= _SURE and abs(best.size) >= _LARGE * best.factor.least
    severity: Severity = "fault" if sure and not rivals else "warning"
    causes = "; or ".join(_cause(model, f) for f in (best, *rivals))
    return [
        LogFinding(
            best.factor.kind,
            severity,
            best.factor.where,
            f"bodies like the nominal ones explain the log much better {causes} "
            "(standard errors, rather too large); otherwise, bodies would be "
            f"{_WITHOUT[best.factor.kind]}",
            _ADVICE[best.factor.kind],
            min(best.ratio / _gate(best.factor), abs(best.size) / best.factor.least),
            size="" if rivals else _size(best),
        )
    ]


def _size(found: FoundFactor) -> str:
    """Return a factor of clock or torque in words."""
    if found.factor.kind not in ("clock", "masses or gain"):
        return ""
    factor = float(np.exp(found.size))
    return f"{factor:.3g} +- {factor * found.error:.2g}"


_WITHOUT = {
    "clock": "too hard or too easy to accelerate for their weight",
    "masses or gain": "all too heavy or all too light",
    "offset zero": "turned or moved against the model's",
    "gravity": "moved sideways",
}
_ADVICE = {
    "clock": "find out the unit of time, or the rate of the log",
    "masses or gain": "check the gain of all torques, a load, a counterbalance, and "
    "the model's masses; "
    'if these are not known, masses = "free" (--masses free)',
    "offset zero": "check the zero of this joint; check again afterwards",
    "gravity": "turn the base or gravity in the model as the robot is mounted",
}


def other_robot(as_is: FactorLogs) -> list[LogFinding]:
    """Say that logs may be another robot's: no factor makes their bodies nominal ones.

    Two signs count together.  With all factors free, the nominal bodies still cost far
    more than in a right robot's log.  And least squares leaves much of the torque
    unexplained, whatever the bodies: then lengths or axes are not the model's.  If it
    leaves as little as in a right log, a load alone may be the cause.
    """
    unexplained, distance = least_misfit(as_is), _distance(as_is)
    score = max(distance, 0.0) / _OTHER + unexplained / _UNEXPLAINED
    if score > 1.0 and unexplained <= _AS_RIGHT:
        # What a last link carries changes no length and no axis.
        distance = min(distance, _distance_of_loaded(as_is))
        score = max(distance, 0.0) / _OTHER + unexplained / _UNEXPLAINED
    if score <= 1.0 or distance < _USUAL:
        return []
    return [
        LogFinding(
            "another robot",
            "fault",
            "model",
            "the log does not look like this robot's: with clock, gain, zeros and base "
            "free, bodies are "
            f"{np.sqrt(max(distance, 0.0)):.2g} times as far from the nominal ones as "
            f"usual, and bodies of any kind leave {unexplained:.1%} of each joint's "
            "torque unexplained",
            "check that model and log belong together, and the order of columns",
            score,
        )
    ]


def _distance(as_is: FactorLogs) -> float:
    """Return what nominal bodies cost for each base parameter, all factors free.

    The squared distance in units of the widths; the better of all factors, linearised,
    and of the best one, settled.
    """
    factors = factors_of(as_is.model)
    costs = []
    for nominal in (True, False):
        system = factor_system(as_is, factors, nominal=nominal, scatter=False)
        free = system.whole[:, : len(factors)]
        seen = np.flatnonzero(np.linalg.norm(free, axis=0) > 0.0)
        costs.append(system.misfit(seen.tolist()) ** 2)
    linear = costs[0] - costs[1]
    first = [f for f in _estimated(as_is, factors) if np.isfinite(f.error)]
    best = max(first, key=lambda f: f.explained, default=None)
    if best is not None:
        size, _ = _converged(as_is, best)
        left, of_drives = least_costs(as_is.without(best.factor, size))
        settled = left - of_drives
        linear = min(linear, settled)
    return linear / _inertial(as_is.model)


def _distance_of_loaded(as_is: FactorLogs) -> float:
    """Return the same where the last links carry anything, and nothing else is wrong.

    Bodies of all last links and all factors together would explain too much.
    """
    left, of_drives = least_costs(replace(as_is, loaded=True))
    return (left - of_drives) / _inertial(as_is.model)


def _inertial(model: TorqueModel) -> int:
    """Return the number of base parameters of bodies."""
    size = model.layout.inertial_size
    return sum(k < size for k in base_parameters(model).independent)


def _gate(factor: Factor) -> float:
    """Return the standard errors from which on a factor is reported."""
    return _LIKELY_ONE if factor.where in ("time", "all joints") else _LIKELY


def _shown(found: FoundFactor) -> bool:
    return (
        abs(found.size) <= _FARTHEST[found.factor.kind]
        and found.ratio >= _gate(found.factor)
        and abs(found.size) >= found.factor.least
        and found.explained > _MUCH.get(found.factor.kind, 0.0) * found.cost
    )


def _cause(model: TorqueModel, found: FoundFactor) -> str:
    kind, size, error = found.factor.kind, found.size, found.error
    if kind in ("clock", "masses or gain"):
        said = f"{_size(found)} times"
        if kind == "clock":
            return f"with a clock {said} as fast"
        return f"if the torque is {said} the robot's"
    if kind == "gravity":
        turned = leaning(model, found.factor.axis, size).robot.gravity
        along = ", ".join(f"{g:.2f}" for g in turned)
        return (
            f"if the base leans by {abs(np.degrees(size)):.2g} +- "
            f"{np.degrees(error):.2g} degrees (gravity along ({along}) m/s^2: "
            f"--gravity {along.replace(',', '')})"
        )
    joint, sign = model.robot.driven[found.factor.joint], "+" if size > 0.0 else "-"
    if joint.kind == "prismatic":
        moved = f"{sign}{abs(size):.2g} m (+- {error:.2g})"
    else:
        moved = (
            f"{sign}{abs(np.degrees(size)):.2g} (+- {np.degrees(error):.2g}) degrees"
        )
    return f"with {moved} added to the position of {joint.name}"
