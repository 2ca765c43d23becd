"""Physical consistency as a detector: the correction that makes a log possible.

A robot made of bodies, with the datasheet's masses and friction that dissipates,
cannot explain a log with a torque reversed or two channels exchanged.  Each correction
is tried, the constrained fit is computed again, and the misfits are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
)
from consistent_id.diagnosis.corrections import Correction
from consistent_id.diagnosis.findings import Finding
from consistent_id.errors import ConsistentIdError
from consistent_id.estimation.best_fit import best_fit
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression, build_regression, triangle
from consistent_id.regression.regressor import TorqueModel

Prepare = Callable[[Recording], Recording]

SAMPLES = 1500
"""Samples that are looked at; more make it slower, not surer."""

THRESHOLDS = {
    "torque sign": 1.15,
    "channel order": 1.15,
    "torque unit": 2.0,
    "degrees": 1.5,
    "offset zero": 1.15,
}
"""Ratio of misfits, as it is over corrected, from which on a fault is reported."""


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
        return ratio / THRESHOLDS[self.correction.kind]


def datasheet_constraints(model: TorqueModel) -> tuple[Constraint, ...]:
    """Return bodies, signs, and the masses that the datasheet has."""
    known = any(link.datasheet.mass is not None for link in model.robot.links)
    masses = (FixedMasses(),) if known else ()
    return (PhysicalConsistency(), *masses, NonNegativeDrive())


def unexplained(
    model: TorqueModel,
    recording: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> float:
    """Return the constrained misfit, each joint relative to its own torque.

    Root of the mean over joints of the squared residual over the squared torque.
    """
    return _constrained(model, _weighted(model, recording), constraints, base)


def _weighted(model: TorqueModel, recording: Recording) -> Regression:
    step = max(len(recording) // SAMPLES, 1)
    regression = build_regression(model, recording.samples(slice(None, None, step)))
    return regression.weighted(np.maximum(regression.torque_rms, 1e-12))


def _constrained(
    model: TorqueModel,
    weighted: Regression,
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> float:
    fit = best_fit(model, weighted, constraints, base=base)
    return fit.misfit / float(np.sqrt(sum(weighted.counts)))


def _unconstrained(weighted: Regression, base: BaseParameters) -> float:
    """Return the misfit of least squares, below which no constraint leads."""
    R = weighted.stacked()[:, [*base.independent, -1]]
    corner = triangle(np.array(R, order="F"))
    least = abs(corner[-1, -1]) if len(corner) == R.shape[1] else 0.0
    return float(least / np.sqrt(sum(weighted.counts)))


def best_explanation(
    model: TorqueModel,
    recording: Recording,
    corrections: Sequence[Correction],
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
) -> Explanation | None:
    """Return the correction that explains the log far better than it is, if any does.

    One at a time: others that rival the best are part of the same fault.
    """
    as_is = unexplained(model, prepare(recording), constraints, base)
    explained = []
    for correction in corrections:
        try:
            rows = _weighted(model, prepare(correction.undo(recording)))
            needed = as_is / THRESHOLDS[correction.kind]
            if _unconstrained(rows, base) > needed:
                continue  # nor do bodies explain what least squares does not
            misfit = _constrained(model, rows, constraints, base)
        except ConsistentIdError:
            continue  # what cannot even be prepared explains nothing
        explained.append(Explanation(correction, misfit, as_is))
    best = max(explained, key=lambda e: e.score, default=None)
    return best if best is not None and best.score >= 1.0 else None


def explanation_finding(explained: Explanation) -> Finding:
    """Report a correction, with what is unexplained with it and without."""
    c = explained.correction
    return Finding(
        c.kind,
        "fault",
        c.where,
        f"{c.statement}, bodies of the datasheet leave {explained.misfit:.1%} of the "
        f"torque unexplained; as it is, {explained.as_is:.1%}",
        c.advice,
        explained.score,
    )
