"""Faults found by physical consistency: the correction that makes a log possible.

A physically consistent robot with the datasheet's masses and friction that dissipates
cannot explain a log with a torque reversed or two channels exchanged.  Corrections are
compared by the misfit of the constrained fit.  Least squares bounds that misfit from
below.  Corrections are fitted in the order of their bounds, until no remaining bound is
below the best misfit, so that few of them need a cone programme.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
)
from consistent_id.constraints.cones.certificate import GAP_TOLERANCE
from consistent_id.diagnosis.channel_factors import (
    ChannelFactors,
    channel_factors,
    half_spaces_at,
    least_misfits,
    least_within,
)
from consistent_id.diagnosis.corrections import LOOKS_ALIKE, Cause, Correction
from consistent_id.diagnosis.coverage import of_samples
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.filters import spaced
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import placeholders

SAMPLES = 1500
"""Most samples that are used; more samples cost time and change no result."""

RUBS = 0.9
"""Share of friction above which the bodies distinguish no causes."""

_SCREENED = 100  # samples on which corrections of the motion are tried first
_MARGIN = 1.15  # factor by which so few samples may overstate a misfit
_WHITE = 3.0  # times the white noise: filters lower it, edges of friction raise it
_BEYOND = 1.5  # times least squares: 1.0 to 1.1 in clean simulated and real logs
_MOST = 0.12  # of the torque: a log with a larger misfit is not explained
_SURE = 0.999  # of a bound on a misfit: fits are this exact
_RIVAL = 1.25  # ratio of misfits within which two causes explain a log equally well
_CLEARLY = 2.0  # ratio beyond which other masses explain a log better than a fault
_MIRRORED = ("torque sign", "position sign")  # equivalent at the last joint
LOAD = "load"
"""Kind of a load that the model does not have."""
_NESTED = {LOAD, "masses or gain"}  # the first is a special case of the second
_UNUSUAL = 0.06  # of the torque: clean logs without noise leave 0.5 to 3 %
# Share of friction that laws with constant coefficients miss: up to 0.15 in recordings
# of a UR10e, because drives warm up and gears mesh.
_OF_FRICTION = 0.15
_BAD = 0.3  # of the torque: misfit that makes any estimate useless
_SHOWN = 3  # candidates that are mentioned
_STRETCHES = 20  # parts of a log, whose misfits scatter
_LIKELY = 2.0  # standard errors of a misfit that its interval reaches to


@dataclass(frozen=True, eq=False)
class FittedLog:
    """A prepared log, and its best constrained fit.

    Parameters
    ----------
    recording : Recording
        Prepared, with the robot's joints.  Rows are filtered like its torque.
    """

    constraints: Sequence[Constraint]
    recording: Recording
    factors: ChannelFactors
    fit: BestFit

    @cached_property
    def screen(self) -> "Screen":
        """Few samples, on which changes of the motion are tried first."""
        return Screen.of(self)

    @property
    def misfit(self) -> float:
        """Torque error of the fit, each joint relative to its own torque.

        Root of the mean over joints of the squared residual over the squared torque.
        """
        return self.factors.relative(self.fit.misfit)

    @property
    def least_likely(self) -> float:
        """Lower end of the misfit's confidence interval, from the scatter over parts.

        In a short log, one reversal of friction more or less changes the misfit.
        """
        model, log = self.factors.model, self.recording
        motion = motion_of(model, log, None)
        left = motion.torque - motion.predicted(model, self.fit.parameters)
        sizes = np.maximum(np.mean(motion.torque**2, axis=0), 1e-300)
        squares = np.mean(left**2 / sizes, axis=1)
        of_each = [part.mean() for part in np.array_split(squares, _STRETCHES)]
        error = np.std(of_each, ddof=1) / np.sqrt(_STRETCHES)
        return float(np.sqrt(max(squares.mean() - _LIKELY * error, 0.0)))

    @property
    def friction(self) -> float:
        """Friction of the best fit over the torque, at most one.

        Root of the mean over joints of the squares, as in `misfit`.
        """
        factors = self.factors
        part = np.append(factors.base.projection @ self._frictions, 0.0)
        return min(float(np.linalg.norm(factors.joined() @ part)), 1.0)

    def rubs(self, joint: str) -> bool:
        """Return whether a joint's torque is friction, but for what its law misses."""
        factors, size = self.factors, len(self.factors.base)
        j = factors.model.torque_joints.index(joint)
        own = factors.factors[j]
        part = own[:, :size] @ (factors.base.projection @ self._frictions)
        torque = np.linalg.norm(own[:, size + j])
        return float(np.linalg.norm(part)) >= (1.0 - _OF_FRICTION) * float(torque)

    @property
    def _frictions(self) -> Vector:
        """Parameters of the best fit that are friction; the others are zero."""
        model, x = self.factors.model, self.fit.parameters
        friction = np.zeros(len(x))
        for joint, drive in zip(model.robot.joint_names, model.terms, strict=True):
            for term in drive.terms:
                if term.friction and term.nonnegative:
                    places = [model.layout.index(f"{joint}.{n}") for n in term.names]
                    friction[places] = x[places]
        return friction


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A cause, and the log as it would be without it.

    Parameters
    ----------
    factors : ChannelFactors
        Factors of the corrected log, or of the corrected model.
    """

    cause: Cause
    factors: ChannelFactors
    constraints: Sequence[Constraint]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A cause, and the misfits with and without its correction, over the torque."""

    cause: Cause
    misfit: float
    as_is: float

    @property
    def score(self) -> float:
        """Ratio of the misfits over the cause's threshold."""
        ratio = self.as_is / max(self.misfit, 1e-12)
        return ratio / self.cause.threshold


@dataclass(frozen=True, slots=True)
class Explanations:
    """Candidates that were fitted to a log, the best first.

    Parameters
    ----------
    tried : tuple of Explanation
        Candidates whose misfit is low enough for their thresholds.
    floor : float
        Misfit, relative to the torque, below which a log counts as explained.
    usual : float
        Misfit of clean logs.  A cause that can stand in for others has to reach it.
    """

    tried: tuple[Explanation, ...]
    floor: float
    usual: float

    @property
    def explained(self) -> list[Explanation]:
        """Candidates whose misfit is low enough to explain the log."""
        bound = {0: self.floor, 1: self.usual, 2: self.floor, LOOKS_ALIKE: self.floor}
        return [
            e
            for e in self.tried
            if e.misfit <= bound[e.cause.excuse]
            and not (e.cause.of_residual and e.misfit > self.usual)
        ]

    @property
    def best(self) -> Explanation | None:
        """The one cause that explains the log; None if there is none, or several.

        If causes of different kinds explain the log about equally well, none of them is
        certain.  A cause whose misfit is much larger than that of others is not certain
        either.
        """
        explained = self.explained
        for excuse, others, margin in ((0, (0, 1), _CLEARLY), (1, (0, 1, 2), _RIVAL)):
            causes = [e for e in explained if e.cause.excuse in (excuse, LOOKS_ALIKE)]
            least = min(
                (e.misfit for e in explained if e.cause.excuse in others), default=0.0
            )
            rivals = [e for e in causes if e.misfit <= _RIVAL * causes[0].misfit]
            if not rivals or rivals[0].misfit > margin * least:
                continue
            kinds = {e.cause.kind for e in rivals}
            if kinds == set(_MIRRORED) and len({e.cause.where for e in rivals}) == 1:
                return next(e for e in rivals if e.cause.kind == _MIRRORED[0])
            if kinds == _NESTED:
                return next(e for e in rivals if e.cause.kind == LOAD)
            alike = len(kinds) > 1 or rivals[0].cause.excuse == LOOKS_ALIKE
            return None if alike else rivals[0]
        return None


def datasheet_constraints(model: TorqueModel) -> tuple[Constraint, ...]:
    """Return physical consistency, signs of drive terms, and the datasheet's masses."""
    known = any(link.datasheet.mass is not None for link in model.robot.links)
    masses = (FixedMasses(),) if known else ()
    return (PhysicalConsistency(), *masses, NonNegativeDrive())


def masses_known(constraints: Sequence[Constraint]) -> bool:
    """Return whether masses are those of the datasheet."""
    return any(isinstance(c, FixedMasses) for c in constraints)


def bodies_known(model: TorqueModel) -> bool:
    """Return whether there are enough torques for a test against nominal bodies."""
    robot = model.robot
    some = robot.nominal is not None and not placeholders(robot)
    return some and len(model.torque_joints) > 1


def fitted_log(
    model: TorqueModel,
    recording: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> FittedLog:
    """Fit a prepared log under constraints.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `best_fit`.
    """
    (factors,) = channel_factors(model, base, [recording])
    return FittedLog(constraints, recording, factors, _fit(factors, constraints))


def thinned(recording: Recording, samples: int) -> Recording:
    """Return evenly spaced samples of a recording, about `samples` of them at most."""
    return spaced(recording, -(-len(recording) // samples))


def explained_by_friction(as_is: FittedLog, noise: float) -> bool:
    """Return whether a log is mostly friction, and fits: nothing else explains it."""
    return as_is.friction >= RUBS and as_is.misfit <= _usual_misfit(as_is, noise)


def _usual_misfit(as_is: FittedLog, noise: float) -> float:
    return max(_UNUSUAL, _WHITE * noise, _OF_FRICTION * as_is.friction)


def explanations(
    as_is: FittedLog, candidates: Sequence[Candidate], noise: float
) -> Explanations:
    """Fit the candidates that may explain a log, in the order of their bounds.

    Parameters
    ----------
    noise : float
        White noise of the torque, relative to it.

    Returns
    -------
    Explanations
        The floor is the log's own noise, with a margin: the larger of `noise` and the
        misfit of the best candidate in least squares without constraints, which
        includes the error of the friction model.
    """
    usual = _usual_misfit(as_is, noise)
    factors = [c.factors.joined() for c in candidates]
    bounds = [least_within(R, ()) for R in factors]
    own = [b for b, c in zip(bounds, candidates, strict=True) if c.cause.excuse != 2]
    least = min([as_is.factors.least_misfit(), *own])
    floor = min(max(_WHITE * noise, _BEYOND * least), _MOST)
    found: list[Explanation] = []
    half_spaces = half_spaces_at(as_is.factors, as_is.fit)
    for i in sorted(range(len(bounds)), key=bounds.__getitem__):
        candidate, wanted = candidates[i], as_is.misfit / candidates[i].cause.threshold
        best = min([e.misfit for e in found], default=np.inf)
        # Constraints only raise the misfit of least squares.
        if bounds[i] > min(wanted, _RIVAL * best):
            continue
        alike = _same_robots(as_is, candidate)
        if alike and _SURE * least_within(factors[i], half_spaces) > wanted:
            continue
        try:
            fit = _fit(candidate.factors, candidate.constraints, gap=1.0 - _SURE)
        except (InfeasibleError, SolverError):
            continue
        if alike:
            half_spaces += half_spaces_at(candidate.factors, fit)
        misfit = candidate.factors.relative(fit.misfit)
        if misfit <= wanted:
            found.append(Explanation(candidate.cause, misfit, as_is.misfit))
    return Explanations(tuple(sorted(found, key=lambda e: e.misfit)), floor, usual)


def _same_robots(as_is: FittedLog, candidate: Candidate) -> bool:
    """Return whether a candidate has the same constraints and base as the log."""
    return (
        candidate.factors.base is as_is.factors.base
        and candidate.constraints is as_is.constraints
    )


def corrected(as_is: FittedLog, corrections: Sequence[Correction]) -> list[Candidate]:
    """Return a candidate for each correction of channels.

    Corrections of the motion that a few samples exclude are left out, and exchanges of
    joints whose torque is friction: it is the same for all joints.
    """
    corrections = [c for c in corrections if not _of_friction(as_is, c)]
    torque = [c for c in corrections if c.fault.channels == "torque"]
    motion = [c for c in corrections if c.fault.channels != "torque"]
    changed = [(c, as_is.factors.changed(c.change.matrix)) for c in torque]
    return [
        Candidate(c.cause, factors, as_is.constraints)
        for c, factors in (*changed, *_moved(as_is, motion))
    ]


def _of_friction(as_is: FittedLog, correction: Correction) -> bool:
    """Return whether joints are exchanged altogether of which only bodies differ."""
    if (correction.fault.kind, correction.fault.channels) != ("channel order", "both"):
        return False
    return all(as_is.rubs(joint) for joint in correction.where.split(", "))


def _fit(
    factors: ChannelFactors,
    constraints: Sequence[Constraint],
    gap: float = GAP_TOLERANCE,
) -> BestFit:
    model, base = factors.model, factors.base
    return best_fit(model, factors.regression(), constraints, base=base, gap=gap)


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """Few samples of a log, on which changes of its motion are tried first.

    Filtered rows need all samples of a log, for each change.  Rows of the few samples
    alone do not contain the filter's rounding of friction's edges; the error of this is
    computed for the unchanged log and subtracted.  Changes that remain possible are
    fitted with filtered rows.

    Parameters
    ----------
    few : Recording
        Not filtered any more.
    as_is : float
        Least misfit of the log as it is, at few samples, its rows filtered.
    missed : float
        Square of the misfit that rows of samples add.
    """

    few: Recording
    as_is: float
    missed: float

    @classmethod
    def of(cls, log: FittedLog) -> "Screen":
        """Return the samples of a log on which changes are tried."""
        model, base = log.factors.model, log.factors.base
        few = thinned(log.recording, _SCREENED)
        bare = of_samples(few)
        filtered, coarse = (least_misfits(model, base, [one])[0] for one in (few, bare))
        return cls(bare, filtered, max(coarse**2 - filtered**2, 0.0))

    def least_misfits(
        self,
        model: TorqueModel,
        base: BaseParameters,
        logs: Sequence[Recording],
        drives: Sequence[Recording | None] | None = None,
    ) -> list[float]:
        """Return the least misfits of samples, less the error of their rows.

        For the parameters see `channel_factors`.
        """
        found = np.square(least_misfits(model, base, logs, drives=drives))
        return [float(np.sqrt(max(each - self.missed, 0.0))) for each in found]


def _moved(
    as_is: FittedLog, corrections: Sequence[Correction]
) -> list[tuple[Correction, ChannelFactors]]:
    """Return corrections of the motion that a few samples do not exclude."""
    model, base = as_is.factors.model, as_is.factors.base
    screen = as_is.screen
    logs = [c.applied(screen.few) for c in corrections]
    drives = _drives(screen.few, corrections)
    tried = screen.least_misfits(model, base, logs, drives)
    # Constraints are assumed to cost the same with few samples as with all.
    of_all = as_is.factors.least_misfit()
    fewer = screen.as_is / of_all if of_all > 0.0 else 1.0
    allowed = _MARGIN * fewer * as_is.misfit
    left = [
        c
        for c, misfit in zip(corrections, tried, strict=True)
        if misfit * c.fault.threshold <= allowed
    ]
    whole = [altered(as_is.recording, c.applied) for c in left]
    drives = _drives(as_is.recording, left)
    factors = channel_factors(model, base, whole, drives=drives)
    return list(zip(left, factors, strict=True))


def _drives(
    log: Recording, corrections: Sequence[Correction]
) -> list[Recording | None]:
    """Return the motions of the drive columns, if they are not those of the bodies.

    The velocity scales of friction fit the log as it is.  Scaling a position by nearly
    one would change these scales, and could fit the friction of a joint by that alone.
    """
    return [log if c.cause.excuse == LOOKS_ALIKE else None for c in corrections]


def explanation_finding(explanation: Explanation) -> LogFinding:
    """Report a cause, with the misfit with and without its correction."""
    c = explanation.cause
    return LogFinding(
        c.kind,
        "fault",
        c.where,
        f"{c.statement}, {explanation.misfit:.1%} instead of {explanation.as_is:.1%} "
        "of each joint's torque is unexplained by a physically consistent robot with "
        "the datasheet's values (root mean square over joints)",
        c.advice,
        explanation.score,
        size=c.size,
    )


def _better(explanation: Explanation) -> str:
    return f"{explanation.cause.statement} the misfit would be {explanation.misfit:.1%}"


def unexplained_findings(as_is: FittedLog, found: Explanations) -> list[LogFinding]:
    """Report a log that no robot with the datasheet's values explains."""
    usual = found.usual
    rivals = any(e.misfit <= found.floor and e.cause.excuse != 2 for e in found.tried)
    if not rivals and (as_is.misfit <= usual or as_is.least_likely <= usual):
        return []
    best, *others = found.tried[:_SHOWN] or (None,)
    said = "" if best is None else f"{_better(best)} instead of {as_is.misfit:.1%}; "
    better = [_better(e) for e in others if e is not None]
    return [
        LogFinding(
            "model does not explain",
            "fault" if as_is.misfit > _BAD else "warning",
            "all joints",
            f"{said}no robot with the datasheet's values explains the log as it is: "
            f"misfit {as_is.misfit:.1%} of each joint's torque (root mean square over "
            f"joints), {as_is.factors.least_misfit():.1%} by least squares without "
            "constraints"
            + "".join(f"; {text}" for text in better)
            + ("" if best is None else "; the cause is not proven"),
            ("" if best is None else f"try this first: {best.cause.advice}. Else ")
            + "check that model and log belong together: load, springs and couplings, "
            "base, units, delays, masses; look at the residuals of each joint",
            max(1.0, as_is.misfit / usual),
        )
    ]
