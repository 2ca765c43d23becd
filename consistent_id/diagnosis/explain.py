"""Physical consistency as a detector: the correction that makes a log possible.

A physically consistent robot with the datasheet's masses and friction that dissipates
cannot explain a log with a torque reversed or two channels exchanged.  Corrections are
compared by the misfit of the constrained fit.  Least squares bounds it from below, so
few corrections need a cone programme: those are fitted in the order of their bounds,
until no bound is left that could win.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
)
from consistent_id.diagnosis.channel_factors import ChannelFactors, channel_factors
from consistent_id.diagnosis.corrections import Correction
from consistent_id.diagnosis.findings import Finding
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel

SAMPLES = 1500
"""Samples that are looked at, at the most; more make it slower, not surer."""

_SCREENED = 300  # samples on which corrections of the motion are tried first
_MARGIN = 1.1  # by which so few samples may overstate a misfit


@dataclass(frozen=True, slots=True, eq=False)
class FittedLog:
    """A prepared log, and the constrained robot that fits it best.

    Parameters
    ----------
    constraints : sequence of Constraint
    recording : Recording
        Prepared, of the robot's joints.
    factors : ChannelFactors
    fit : BestFit
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


@dataclass(frozen=True, slots=True)
class Explanation:
    """A correction, and the misfits with it and as it is, relative to the torque."""

    correction: Correction
    misfit: float
    as_is: float

    @property
    def score(self) -> float:
        """How far the misfits' ratio is beyond the correction's threshold."""
        ratio = self.as_is / max(self.misfit, 1e-12)
        return ratio / self.correction.fault.threshold


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


def best_explanation(
    as_is: FittedLog, corrections: Sequence[Correction]
) -> Explanation | None:
    """Return the correction that explains the log far better than it is, if any does.

    One at a time: others that rival the best are part of the same fault.
    """
    torque, motion = (
        [c for c in corrections if c.fault.channels == channels]
        for channels in ("torque", "motion")
    )
    candidates = [
        *((c, as_is.factors.changed(c.change.matrix)) for c in torque),
        *_moved(as_is, motion),
    ]
    bounds = [Explanation(c, f.least_misfit(), as_is.misfit) for c, f in candidates]
    best: Explanation | None = None
    for i in sorted(range(len(bounds)), key=lambda i: -bounds[i].score):
        least = 1.0 if best is None else best.score
        if bounds[i].score < least:
            break  # nor do constraints allow what least squares does not reach
        correction, factors = candidates[i]
        try:
            fit = _fit(factors, as_is.constraints)
        except SolverError:
            continue
        found = Explanation(correction, factors.relative(fit.misfit), as_is.misfit)
        best = found if found.score >= least else best
    return best


def _fit(factors: ChannelFactors, constraints: Sequence[Constraint]) -> BestFit:
    model, base = factors.model, factors.base
    return best_fit(model, factors.regression(), constraints, base=base)


def _moved(
    as_is: FittedLog, corrections: Sequence[Correction]
) -> list[tuple[Correction, ChannelFactors]]:
    """Return corrections of the motion that a few samples do not rule out."""
    model, base = as_is.factors.model, as_is.factors.base
    few = thinned(as_is.recording, _SCREENED)
    logs = [few, *(c.applied(few) for c in corrections)]
    of_few = [factors.least_misfit() for factors in channel_factors(model, base, logs)]
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
    factors = channel_factors(model, base, whole)
    return list(zip(left, factors, strict=True))


def explanation_finding(explanation: Explanation) -> Finding:
    """Report a correction, with what is unexplained with it and without."""
    c = explanation.correction
    return Finding(
        c.fault.kind,
        "fault",
        c.where,
        f"{c.statement}, a physically consistent robot with the datasheet's values "
        f"leaves {explanation.misfit:.1%} of the torque unexplained; as it is, "
        f"{explanation.as_is:.1%}",
        c.advice,
        explanation.score,
    )
