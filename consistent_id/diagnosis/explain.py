"""Physical consistency as a detector: the correction that makes a log possible.

A robot made of bodies, with the datasheet's masses and friction that dissipates,
cannot explain a log with a torque reversed or two channels exchanged.  Each correction
is tried, the constrained fit is computed again, and the misfits are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id.base import BaseParameters
from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
)
from consistent_id.diagnosis.corrections import Correction
from consistent_id.diagnosis.findings import Finding
from consistent_id.errors import ConsistentIdError
from consistent_id.estimators.best_fit import best_fit
from consistent_id.recording import Recording
from consistent_id.regression import build_regression
from consistent_id.regressor import TorqueModel

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
class Explained:
    """A correction and the misfit with it, relative to the torque."""

    correction: Correction
    misfit: float


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
    step = max(len(recording) // SAMPLES, 1)
    regression = build_regression(model, recording.samples(slice(None, None, step)))
    weighted = regression.weighted(np.maximum(regression.torque_rms, 1e-12))
    fit = best_fit(model, weighted, constraints, base=base)
    return fit.misfit / float(np.sqrt(sum(regression.counts)))


def explanation_findings(
    model: TorqueModel,
    recording: Recording,
    corrections: Sequence[Correction],
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
) -> list[Finding]:
    """Report the correction that explains the log far better than it is.

    One at a time: the best correction is reported; others that rival it are part of
    the same fault.
    """
    as_is = unexplained(model, prepare(recording), constraints, base)
    explained = []
    for correction in corrections:
        try:
            better = prepare(correction.undo(recording))
            misfit = unexplained(model, better, constraints, base)
        except ConsistentIdError:
            continue  # what cannot even be prepared explains nothing
        explained.append(Explained(correction, misfit))
    if not explained:
        return []
    best = min(explained, key=lambda e: e.misfit / _threshold(e))
    ratio = as_is / max(best.misfit, 1e-12)
    if ratio < THRESHOLDS[best.correction.kind]:
        return []
    c = best.correction
    return [
        Finding(
            c.kind,
            "fault",
            c.where,
            f"{c.statement}, bodies of the datasheet leave {best.misfit:.1%} of the "
            f"torque unexplained; as it is, {as_is:.1%}",
            c.advice,
            ratio / THRESHOLDS[c.kind],
        )
    ]


def _threshold(explained: Explained) -> float:
    return 1.0 / THRESHOLDS[explained.correction.kind]
