"""Findings about factors of a whole robot: which are named, and what is not known.

A factor is named from three standard errors on (clock and gain: two and a half), and is
a fault if it is five, or if an estimate that does not know it may be harmful: with a
factor as large as its size and one standard error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.factor_logs import HARM, FactorLogs, leaning, solution_of
from consistent_id.diagnosis.factor_rows import Factor
from consistent_id.diagnosis.findings import LogFinding, Severity
from consistent_id.regression.regressor import TorqueModel

_WORTH_SAYING, _NAMED = 0.02, 3  # least doubt that is said, and how many
_ALIKE = 0.8  # share of the best explanation that rivals reach

# Standard errors from which on a factor is a warning, and a fault.  Of right logs of
# four real arms (benchmarks/whole_robot.py), the largest are 2.2 for the clock, 2.7 for
# zeros up to `FARTHEST`; for gains 1.4, and 2.7 for a KUKA whose counterbalance its
# model lacks: that is a warning.  A Z1, nearly all friction, has 3.8 for a zero and 3.0
# for the base, which explain too little to be named (`_MUCH`).
LIKELY, _SURE = 3.0, 5.0
_LIKELY_ONE = 2.5  # the same for clock and gain: there is one of each, not one a joint
# Share of the squares that a zero, a lean or a joint's gain has to explain.  Where
# drives take most of the torque, friction that the model lacks looks like one: in
# logs of three robots up to 0.031, at 4 to 6 standard errors.  Faults of four arms
# explain 0.048 to 0.91.  Wrong clocks of five arms explain 0.037 to 0.39; the legs of
# a Go2 in the air show one that explains 0.005, at 3.5 standard errors.
# Below `RUBBING`, the drives' share of the torque, a harmful one may explain less.
RUBBING = 0.5
_MUCH = {"clock": 0.01, "offset zero": 0.04, "gravity": 0.04, "torque gain": 0.04}
_HALF_SURE = 2.0  # standard errors from which on a joint's gain is corrected
_LOOSE = 5.0  # times the widths: bodies are nearly free
_LARGE = 2.0  # times the least size that is reported: a fault
FARTHEST = {  # beyond, it is another fault: another unit, another channel
    "clock": float(np.log(10.0)),
    "masses or gain": float(np.log(3.0)),
    "torque gain": float(np.log(3.0)),
    "offset zero": float(np.radians(45.0)),  # or m
    "gravity": float(np.pi),
}


@dataclass(frozen=True, slots=True, eq=False)
class FoundFactor:
    """An estimated factor.

    Parameters
    ----------
    size, error : float
        In the units of `Factor.least`; the log is right after removing this size.
    cautious : float
        Error that counts noise twice, by which a factor is reported.
    explained : float
        Decrease of the sum of squares, in squared noise.
    cost : float
        The sum of squares of the unchanged logs.
    harm, doubt : float
        Error of an estimate that does not know the factor, over the torque of all
        joints; and the same for a factor as large as its cautious error.
    drives : float
        Torque of the drives over that of all joints.
    """

    factor: Factor
    size: float
    error: float
    cautious: float
    explained: float
    cost: float = 0.0
    harm: float = 0.0
    doubt: float = 0.0
    drives: float = 1.0

    @property
    def ratio(self) -> float:
        """Size over the cautious error."""
        return abs(self.size) / self.cautious

    @property
    def may_harm(self) -> float:
        """Harm of a factor that is larger than its size by one standard error."""
        return self.harm * (1.0 + self.error / abs(self.size)) if self.size else 0.0


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
    fault = (sure and not rivals) or _harmful(best, rivals)
    severity: Severity = "fault" if fault else "warning"
    causes = "; or ".join(_cause(model, f) for f in (best, *rivals))
    return [
        LogFinding(
            best.factor.kind,
            severity,
            best.factor.where,
            f"bodies like the nominal ones explain the log much better {causes} "
            "(standard errors); otherwise, bodies would be "
            f"{_WITHOUT[best.factor.kind]}; an estimate that does not know it would be "
            f"{best.harm:.0%} off in torque{_at_most(best, rivals)}",
            _advice(best),
            min(best.ratio / gate_of(best.factor), abs(best.size) / best.factor.least),
            size="" if rivals else _size(best),
        )
    ]


def _at_most(best: FoundFactor, rivals: Sequence[FoundFactor]) -> str:
    """Return in words the harm of a larger factor, or of another, if that counts."""
    worst = max((best, *rivals), key=lambda f: f.may_harm)
    if not best.harm < HARM <= worst.may_harm:
        return ""
    if worst.harm < HARM:
        return f", or {worst.may_harm:.0%} with a standard error more"
    return f", or {worst.harm:.0%} with the other cause"


def _advice(found: FoundFactor) -> str:
    advice = _ADVICE[found.factor.kind]
    if found.factor.kind != "offset zero":
        return advice
    option = f"--position-offset {found.factor.where}={found.size:.2g}"
    return f"{advice}; if the log's is wrong, {option}"


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


def hidden_factors(
    model: TorqueModel, found: Sequence[FoundFactor]
) -> list[LogFinding]:
    """Return the possible size of factors that no log shows, and their effect.

    Bodies that differ from the nominal ones as far as usual would explain a factor as
    large as its standard error.  It is a warning where a factor may hide that would be
    reported and is harmful, unless one was found: errors of the others contain it.
    """
    alone = not any(_shown(f) for f in found)
    seen = [f for f in found if np.isfinite(f.cautious) and not _shown(f)]
    seen = [f for f in seen if f.factor.kind in _TOLD and f.doubt >= _WORTH_SAYING]
    if not seen:
        return []
    seen = sorted(seen, key=lambda f: (not _hides_harm(f), -f.doubt))
    worst, *others = seen[:_NAMED]
    said = "; ".join(_hidden(model, f) for f in (worst, *others))
    return [
        LogFinding(
            "hidden factor",
            "warning" if alone and any(map(_hides_harm, seen)) else "note",
            worst.factor.where,
            "bodies that differ from the model's as much as usual may hide an error "
            f"of this size (one standard error): {said}",
            _TOLD[worst.factor.kind],
            worst.doubt / HARM,
        )
    ]


def _hides_harm(found: FoundFactor) -> bool:
    """Return whether a factor as large as its standard error should have been found.

    A gain of all torques is stated with the log, or known from the sensors, and where
    masses are free no log ever shows it: that is said, and no doubt.
    """
    large = found.cautious >= found.factor.least and found.doubt >= HARM
    return large and found.factor.kind != "masses or gain"


def _hidden(model: TorqueModel, found: FoundFactor) -> str:
    """Return the possible size of a hidden factor, and its effect on an estimate."""
    kind, error = found.factor.kind, found.cautious
    any_size = error >= FARTHEST[kind]
    if kind in ("clock", "masses or gain"):
        of = "as fast" if kind == "clock" else "the robot's"
        said = "a clock" if kind == "clock" else "torques"
        any_of = " of any speed" if kind == "clock" else " of any size"
        said += any_of if any_size else f" {np.exp(error):.2f} times {of}"
    else:
        joint = model.robot.driven[found.factor.joint]
        off = f"off by {np.degrees(error):.2g} degrees"
        if joint.kind == "prismatic":
            off = f"off by {error:.2g} m"
        said = f"{'any zero' if any_size else 'a zero'} of {joint.name}"
        said += "" if any_size else f" {off}"
    return f"{said} (an estimate is then {found.doubt:.0%} off in torque)"


def _harmful(best: FoundFactor, rivals: Sequence[FoundFactor]) -> bool:
    """Return whether a cause is likely that may make an estimate harmful.

    A gain of all torques has to be sure, because bodies may all be lighter or heavier:
    right logs of a KUKA show a gain of 0.8 at four standard errors, those of a UR10e
    with a load of stated mass a gain of 1.6.
    """
    gate = _SURE if best.factor.kind == "masses or gain" else gate_of(best.factor)
    return best.ratio >= gate and max(f.may_harm for f in (best, *rivals)) >= HARM


def _size(found: FoundFactor) -> str:
    """Return a factor of clock or torque in words."""
    if found.factor.kind not in _RATIOS:
        return ""
    factor = float(np.exp(found.size))
    return f"{factor:.3g} +- {factor * found.error:.2g}"


_RATIOS = ("clock", "masses or gain", "torque gain")
"""Kinds of factors whose size is the logarithm of a ratio."""

_TOLD = {
    "clock": "compare the log's duration with a clock, or record faster motion: if the "
    'clock is known to be right, --accept "hidden factor"',
    "masses or gain": "weigh a known load (consistent-id gains, payload), or state "
    'masses: if gains are known to be right, --accept "hidden factor"',
    "offset zero": "measure this zero, or record poses in which gravity acts on this "
    'joint: if it is known to be right, --accept "hidden factor"',
}
_WITHOUT = {
    "clock": "too hard or too easy to accelerate for their weight",
    "masses or gain": "all too heavy or all too light",
    "torque gain": "heavier or lighter for this joint than for the others that carry "
    "them",
    "offset zero": "turned or moved against the model's",
    "gravity": "moved sideways",
}
_ADVICE = {
    "clock": "find out the unit of time, or the rate of the log",
    "masses or gain": "check the gain of all torques, a load, a counterbalance, and "
    "the model's masses; "
    'if these are not known, masses = "free" (--masses free)',
    "torque gain": "check this joint's gain and gear ratio, and the model's bodies; if "
    'its gain is known to be right, --accept "torque gain"',
    "offset zero": "check the zero of this joint; check again afterwards",
    "gravity": "turn the base or gravity in the model as the robot is mounted",
}


def gate_of(factor: Factor) -> float:
    """Return the standard errors from which on a factor is reported.

    The gain of a joint has to be sure: where friction takes most of its torque, errors
    of the friction model look like one (2.8 in a right log of a TX40).
    """
    if factor.kind == "torque gain":
        return _SURE
    return _LIKELY_ONE if factor.where in ("time", "all joints") else LIKELY


def promising(found: FoundFactor) -> bool:
    """Return whether a factor is worth a closer look.

    The first error contains the fault itself.  That of a joint's gain is too large
    then, because bodies that the other joints carry cannot explain the fault.
    """
    if found.factor.kind != "torque gain":
        return found.ratio >= gate_of(found.factor)
    usual = found.factor.least <= abs(found.size) <= FARTHEST["torque gain"]
    return usual and found.ratio >= _HALF_SURE


def worth_a_look(
    as_is: FactorLogs, likely: Sequence[FoundFactor], cost: float
) -> list[FoundFactor]:
    """Leave out gains of joints that explain little, and change little torque."""
    gains = [f for f in likely if f.factor.kind == "torque gain"]
    little = [f for f in gains if not explains_much(replace(f, cost=cost))]
    if not little:
        return list(likely)
    units = effects(as_is, [f.factor for f in little])
    harmless = [
        f for f, unit in zip(little, units, strict=True) if unit * abs(f.size) < HARM
    ]
    return [f for f in likely if f not in harmless]


def explains_much(found: FoundFactor) -> bool:
    """Return whether a factor explains enough of the squares to be named."""
    return found.explained > _MUCH.get(found.factor.kind, 0.0) * found.cost


def _shown(found: FoundFactor) -> bool:
    much = explains_much(found) or (found.harm >= HARM and found.drives < RUBBING)
    return (
        abs(found.size) <= FARTHEST[found.factor.kind]
        and found.ratio >= gate_of(found.factor)
        and abs(found.size) >= found.factor.least
        and much
    )


def _cause(model: TorqueModel, found: FoundFactor) -> str:
    kind, size, error = found.factor.kind, found.size, found.error
    if kind in _RATIOS:
        said = f"{_size(found)} times"
        if kind == "clock":
            return f"with a clock {said} as fast"
        of = "" if kind == "masses or gain" else f" of {found.factor.where}"
        return f"if the torque{of} is {said} the robot's"
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


def harm(as_is: FactorLogs, factor: Factor, size: float) -> float:
    """Return what error a factor would mean for an estimate that does not know it.

    The logs as they are and the logs without the factor are fitted, both with bodies
    that are nearly free.  The error is that of the former's torque on the motion of the
    latter, relative to the torque of all joints.
    """
    widths, rows = _LOOSE * as_is.widths, as_is.rows.without_loads
    loose = replace(as_is, widths=widths, rows=rows)
    right = loose.without(factor, size)
    wrong, x = solution_of(loose), solution_of(right)
    torque, error = (np.linalg.norm(right.rows.torque_of(y)) for y in (x, wrong - x))
    return float(error / torque)


def effects(state: FactorLogs, factors: Sequence[Factor]) -> Vector:
    """Return the torque that a unit of each factor changes, over that of all joints."""
    x = solution_of(state)
    slopes = [rows.slopes(x, factors) for rows in state.rows.each]
    changed = np.linalg.norm(np.concatenate(slopes, axis=2), axis=(0, 2))
    return np.asarray(changed / np.linalg.norm(state.rows.torque))
