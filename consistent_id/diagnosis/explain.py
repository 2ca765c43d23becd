"""Physical consistency as a detector: the correction that makes a log possible.

A physically consistent robot with the datasheet's masses and friction that dissipates
cannot explain a log with a torque reversed or two channels exchanged.  Corrections are
compared by the misfit of the constrained fit.  Least squares bounds it from below, so
few corrections need a cone programme: those are fitted in the order of their bounds,
until no bound is left that could win.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
    cuts_at,
    least_within,
)
from consistent_id.diagnosis.corrections import LOOKS_ALIKE, Cause, Correction
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.regressor import TorqueModel

SAMPLES = 1500
"""Samples that are looked at, at the most; more make it slower, not surer."""

_SCREENED = 300  # samples on which corrections of the motion are tried first
_MARGIN = 1.1  # by which so few samples may overstate a misfit
_WHITE = 3.0  # times the white noise: filters leave less, edges of friction more
_BEYOND = 1.5  # times least squares: clean logs have 1.0 to 1.1, here and in robots
_MOST = 0.12  # of the torque: misfit that explains nothing, least squares or not
_SURE = 0.999  # of a bound on a misfit: what fits are not exact to
_RIVAL = 1.25  # ratio of misfits within which two causes explain a log alike
_CLEARLY = 2.0  # ratio beyond which other masses explain a log better than a fault
_MIRRORED = ("torque sign", "position sign")  # one and the same at the last joint
LOAD = "load"
"""Kind of a load that the model does not have."""
_NESTED = {LOAD, "masses or gain"}  # the first is one of the second, and says more
_UNUSUAL = 0.06  # of the torque: clean logs without noise leave 0.5 to 3 %
# Of friction, that laws with constant coefficients miss: of a UR10e's recordings up to
# 0.15, as drives warm up, and as gears mesh.
_OF_FRICTION = 0.15
_RUBS = 0.9  # share of friction beside which bodies tell no cause from another
_BAD = 0.3  # of the torque: misfit of which no good comes
_SHOWN = 3  # candidates that are worth mention
_STRETCHES = 20  # of a log, whose misfits scatter
_LIKELY = 2.0  # standard errors of a misfit within which it may be another


@dataclass(frozen=True, slots=True, eq=False)
class FittedLog:
    """A prepared log, and the constrained robot that fits it best.

    Parameters
    ----------
    recording : Recording
        Prepared, of the robot's joints.
    """

    constraints: Sequence[Constraint]
    recording: Recording
    factors: ChannelFactors
    fit: BestFit

    @property
    def misfit(self) -> float:
        """What is unexplained, each joint relative to its own torque.

        Root of the mean over joints of the squared residual over the squared torque.
        """
        return self.factors.relative(self.fit.misfit)

    @property
    def least_likely(self) -> float:
        """Lower end of the misfit's confidence interval, by how stretches scatter.

        Of a short log, one edge of friction more or less makes a difference.
        """
        model, log = self.factors.model, self.recording
        motion = motion_of(model, log, None)
        left = motion.torque - model.predict(
            self.fit.parameters, motion.q, motion.dq, motion.ddq
        )
        sizes = np.maximum(np.mean(motion.torque**2, axis=0), 1e-300)
        squares = np.mean(left**2 / sizes, axis=1)
        of_each = [part.mean() for part in np.array_split(squares, _STRETCHES)]
        error = np.std(of_each, ddof=1) / np.sqrt(_STRETCHES)
        return float(np.sqrt(max(squares.mean() - _LIKELY * error, 0.0)))

    @property
    def friction(self) -> float:
        """Friction of the best robot over the torque, one at the most.

        Root of the mean over joints of the squares, as in `misfit`.
        """
        factors, base = self.factors, self.factors.base
        model, x = factors.model, self.fit.parameters
        rubs = np.zeros(len(x))
        for joint, drive in zip(model.robot.joint_names, model.terms, strict=True):
            for term in drive.terms:
                if term.friction and term.nonnegative:
                    rubs[[model.layout.index(f"{joint}.{n}") for n in term.names]] = 1.0
        part = np.append(base.projection @ (rubs * x), 0.0)
        share = float(np.linalg.norm(factors.joined() @ part))
        return min(share, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A cause, and the log as it would be without it.

    Parameters
    ----------
    factors : ChannelFactors
        Of the corrected log, or of a model that has what the log's robot has.
    """

    cause: Cause
    factors: ChannelFactors
    constraints: Sequence[Constraint]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A cause, and the misfits without it and as it is, relative to the torque."""

    cause: Cause
    misfit: float
    as_is: float

    @property
    def score(self) -> float:
        """How far the misfits' ratio is beyond the cause's threshold."""
        ratio = self.as_is / max(self.misfit, 1e-12)
        return ratio / self.cause.threshold


@dataclass(frozen=True, slots=True)
class Explanations:
    """What explains a log: candidates that were fitted, the best first.

    Parameters
    ----------
    tried : tuple of Explanation
        Those that leave less unexplained than their thresholds ask for.
    floor : float
        Misfit, relative to the torque, below which a log counts as explained.
    usual : float
        Misfit that clean logs have, by which a cause that stands in for others is
        judged.
    """

    tried: tuple[Explanation, ...]
    floor: float
    usual: float

    @property
    def explained(self) -> list[Explanation]:
        """Those that leave no more than a log counts as explained with."""
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

        Of causes that explain it about as well, none is known to be the one, unless
        they are of one kind.  Nor is one of which much more stays unexplained than of
        others.
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
    """Return physical consistency, signs, and the masses that the datasheet has."""
    known = any(link.datasheet.mass is not None for link in model.robot.links)
    masses = (FixedMasses(),) if known else ()
    return (PhysicalConsistency(), *masses, NonNegativeDrive())


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
    """Return every so many-th sample, `samples` of them or fewer."""
    return recording.samples(slice(None, None, -(-len(recording) // samples)))


def explanations(
    as_is: FittedLog, candidates: Sequence[Candidate], noise: float
) -> Explanations:
    """Fit the candidates that may explain a log, the most promising first.

    Parameters
    ----------
    noise : float
        White noise of the torque, relative to it.

    Returns
    -------
    Explanations
        The floor is the log's own noise: the larger of `noise` and what least squares,
        free of all constraints, leaves of the best candidate, each with a margin; what
        a model of friction that is not quite right leaves is in the second one.
    """
    usual = max(_UNUSUAL, _WHITE * noise, _OF_FRICTION * as_is.friction)
    if as_is.friction >= _RUBS and as_is.misfit <= usual:
        candidates = ()
    factors = [c.factors.joined() for c in candidates]
    bounds = [least_within(R, ()) for R in factors]
    own = [b for b, c in zip(bounds, candidates, strict=True) if c.cause.excuse != 2]
    least = min([as_is.factors.least_misfit(), *own])
    floor = min(max(_WHITE * noise, _BEYOND * least), _MOST)
    found: list[Explanation] = []
    cuts = cuts_at(as_is.factors, as_is.fit)
    for i in sorted(range(len(bounds)), key=bounds.__getitem__):
        candidate, wanted = candidates[i], as_is.misfit / candidates[i].cause.threshold
        best = min([e.misfit for e in found], default=np.inf)
        # Nor do constraints allow what least squares does not reach.
        if bounds[i] > min(wanted, _RIVAL * best):
            continue
        alike = _same_robots(as_is, candidate)
        if alike and _SURE * least_within(factors[i], cuts) > wanted:
            continue
        try:
            fit = _fit(candidate.factors, candidate.constraints, gap=1.0 - _SURE)
        except (InfeasibleError, SolverError):
            continue
        if alike:
            cuts += cuts_at(candidate.factors, fit)
        misfit = candidate.factors.relative(fit.misfit)
        if misfit <= wanted:
            found.append(Explanation(candidate.cause, misfit, as_is.misfit))
    return Explanations(tuple(sorted(found, key=lambda e: e.misfit)), floor, usual)


def _same_robots(as_is: FittedLog, candidate: Candidate) -> bool:
    """Return whether the same robots are possible for a candidate as for the log."""
    return (
        candidate.factors.base is as_is.factors.base
        and candidate.constraints is as_is.constraints
    )


def corrected(as_is: FittedLog, corrections: Sequence[Correction]) -> list[Candidate]:
    """Return the candidates that corrections of channels are.

    Corrections of the motion that a few samples rule out are left out.
    """
    torque = [c for c in corrections if c.fault.channels == "torque"]
    motion = [c for c in corrections if c.fault.channels != "torque"]
    changed = [(c, as_is.factors.changed(c.change.matrix)) for c in torque]
    return [
        Candidate(c.cause, factors, as_is.constraints)
        for c, factors in (*changed, *_moved(as_is, motion))
    ]


def _fit(
    factors: ChannelFactors,
    constraints: Sequence[Constraint],
    gap: float = GAP_TOLERANCE,
) -> BestFit:
    model, base = factors.model, factors.base
    return best_fit(model, factors.regression(), constraints, base=base, gap=gap)


def _moved(
    as_is: FittedLog, corrections: Sequence[Correction]
) -> list[tuple[Correction, ChannelFactors]]:
    """Return corrections of the motion that a few samples do not rule out."""
    model, base = as_is.factors.model, as_is.factors.base
    few = thinned(as_is.recording, _SCREENED)
    logs = [few, *(c.applied(few) for c in corrections)]
    drives = [None, *_drives(few, corrections)]
    tried = channel_factors(model, base, logs, drives=drives)
    of_few = [factors.least_misfit() for factors in tried]
    # What constraints cost is taken to be the same for few samples as for all.
    of_all = as_is.factors.least_misfit()
    fewer = of_few[0] / of_all if of_all > 0.0 else 1.0
    allowed = _MARGIN * fewer * as_is.misfit
    left = [
        c
        for c, misfit in zip(corrections, of_few[1:], strict=True)
        if misfit * c.fault.threshold <= allowed
    ]
    whole = [c.applied(as_is.recording) for c in left]
    drives = _drives(as_is.recording, left)
    factors = channel_factors(model, base, whole, drives=drives)
    return list(zip(left, factors, strict=True))


def _drives(
    log: Recording, corrections: Sequence[Correction]
) -> list[Recording | None]:
    """Return the motions of which corrected logs have the drives' columns, if others.

    The widths of friction's edges are those that fit the log as it is: a scale near one
    of one position would change a width with it, and so fit the edges of a joint of
    which it says nothing else.
    """
    return [log if c.cause.excuse == LOOKS_ALIKE else None for c in corrections]


def explanation_finding(explanation: Explanation) -> LogFinding:
    """Report a cause, with what is unexplained without it and as it is."""
    c = explanation.cause
    return LogFinding(
        c.kind,
        "fault",
        c.where,
        f"{c.statement}, a physically consistent robot with the datasheet's values "
        f"leaves {explanation.misfit:.1%} of each joint's torque unexplained (root "
        f"mean square over joints); as it is, {explanation.as_is:.1%}",
        c.advice,
        explanation.score,
    )


def unexplained_findings(as_is: FittedLog, found: Explanations) -> list[LogFinding]:
    """Report a log that no robot of the datasheet explains, with the candidates."""
    usual = found.usual
    rivals = any(e.misfit <= found.floor and e.cause.excuse != 2 for e in found.tried)
    if not rivals and (as_is.misfit <= usual or as_is.least_likely <= usual):
        return []
    better = [
        f"{e.cause.statement} the misfit would be {e.misfit:.1%}"
        for e in found.tried[:_SHOWN]
    ]
    return [
        LogFinding(
            "model does not explain",
            "fault" if as_is.misfit > _BAD else "warning",
            "all joints",
            "no robot with the datasheet's values explains the log: "
            f"misfit {as_is.misfit:.1%} of each joint's torque (root mean square over "
            f"joints), {as_is.factors.least_misfit():.1%} by least squares without "
            "constraints"
            + (f"; {'; '.join(better)}, which proves no cause" if better else ""),
            "check that model and log are of one robot: load, springs and couplings, "
            "base, units, delays, masses; see the residuals joint by joint",
            max(1.0, as_is.misfit / usual),
        )
    ]
