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

from consistent_id._support.arrays import Matrix
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
    model : TorqueModel
    constraints : sequence of Constraint
    base : BaseParameters
    recording : Recording
        Prepared, of the robot's joints.
    factors : ChannelFactors
    fit : BestFit
    """

    model: TorqueModel
    constraints: Sequence[Constraint]
    base: BaseParameters
    recording: Recording
    factors: ChannelFactors
    fit: BestFit

    @property
    def misfit(self) -> float:
        """What is unexplained, each joint relative to its own torque.

        Root of the mean over joints of the squared residual over the squared torque.
        """
        return _relative(self.fit, self.factors)


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
    fit = best_fit(model, factors.regression(), constraints, base=base)
    return FittedLog(model, constraints, base, recording, factors, fit)


def thinned(recording: Recording, samples: int) -> Recording:
    """Return every so many-th sample, `samples` of them or fewer."""
    return recording.samples(slice(None, None, -(-len(recording) // samples)))


def best_explanation(
    as_is: FittedLog, corrections: Sequence[Correction]
) -> Explanation | None:
    """Return the correction that explains the log far better than it is, if any does.

    One at a time: others that rival the best are part of the same fault.
    """
    candidates = [_Candidate(c, as_is.factors) for c in corrections if not c.moves]
    candidates += _moved(as_is, [c for c in corrections if c.moves])
    bounds = [
        Explanation(c.correction, c.least_misfit, as_is.misfit) for c in candidates
    ]
    best: Explanation | None = None
    for i in sorted(range(len(bounds)), key=lambda i: -bounds[i].score):
        if bounds[i].score < (1.0 if best is None else best.score):
            break  # nor do constraints allow what least squares does not reach
        try:
            misfit = candidates[i].constrained_misfit(as_is)
        except SolverError:
            continue
        found = Explanation(candidates[i].correction, misfit, as_is.misfit)
        if found.score >= (1.0 if best is None else best.score):
            best = found
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A correction, and the factors of the motion that it leaves."""

    correction: Correction
    factors: ChannelFactors

    @property
    def least_misfit(self) -> float:
        return self.factors.least_misfit(self._change())

    def constrained_misfit(self, log: FittedLog) -> float:
        regression = self.factors.regression(self._change())
        fit = best_fit(log.model, regression, log.constraints, base=log.base)
        return _relative(fit, self.factors)

    def _change(self) -> Matrix | None:
        """Return what becomes of the channels of the torque joints."""
        if self.correction.moves:
            return None
        model = self.factors.model
        places = [model.robot.joint_names.index(name) for name in model.torque_joints]
        return self.correction.change.matrix[np.ix_(places, places)]


def _moved(as_is: FittedLog, corrections: Sequence[Correction]) -> list[_Candidate]:
    """Return corrections of the motion that a few samples do not rule out."""
    few = thinned(as_is.recording, _SCREENED)
    logs = [few, *(c.applied(few) for c in corrections)]
    of_few = [
        factors.least_misfit()
        for factors in channel_factors(as_is.model, as_is.base, logs)
    ]
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
    factors = channel_factors(as_is.model, as_is.base, whole)
    return [_Candidate(*pair) for pair in zip(left, factors, strict=True)]


def _relative(fit: BestFit, factors: ChannelFactors) -> float:
    return fit.misfit / float(np.sqrt(factors.samples * len(factors.factors)))


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
