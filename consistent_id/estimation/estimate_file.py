"""The JSON file of an estimate: what is written, read back through a schema."""

import json
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import msgspec
import numpy as np

from consistent_id._support.inputs import LARGEST_MODEL, read_input
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.errors import ProblemError
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.verdict import Verdict, Word
from consistent_id.regression.regressor import TorqueModel

if TYPE_CHECKING:
    from consistent_id.estimation.estimate import Estimate

FORMAT = "consistent_id estimate 1"


class ParameterRecord(msgspec.Struct):
    """One parameter."""

    value: float
    origin: str


class CertificateRecord(msgspec.Struct):
    """The verdict, and the figures behind it."""

    verdict: str
    reason: str
    figures: dict[str, float | None]

    @property
    def known_figures(self) -> dict[str, float]:
        """The figures, NaN where the file has none."""
        return {k: nan if v is None else v for k, v in self.figures.items()}


class JointRecord(msgspec.Struct):
    """How well the torque of one joint is explained; see `Fit`."""

    torque: float | None
    misfits: float | None
    shares: float | None
    slopes: float | None
    explained: float | None
    expected: float | None
    efforts: float | None
    moving: float | None = None
    holding: float | None = None


class FitRecord(msgspec.Struct):
    """How well the training data are explained; see `Fit`."""

    misfit: float | None
    floor: float | None
    excess: float | None
    drive_share: float | None
    joints: dict[str, JointRecord]
    correlation: float | None = None
    spare: float | None = None
    guessed: float | None = None


class ReasonRecord(msgspec.Struct):
    """One reason for the verdict; see `Reason`."""

    kind: str
    word: Word
    statement: str
    advice: str


class EstimateRecord(msgspec.Struct):
    """What an estimate is made of again; the file holds more, for people."""

    format: str
    method: str
    certificate: CertificateRecord
    parameters: dict[str, ParameterRecord]
    undetermined: list[str]
    sigma: dict[str, float]
    notes: list[str]
    seconds: float
    fit: FitRecord | None = None
    accepted: list[str] = []
    verdict: Word = "use with care"
    reasons: list[ReasonRecord] = []
    held_out_error: float | None = None

    def fit_value(self) -> Fit | None:
        """Return the fit, if the file has one."""
        fit = self.fit
        return None if fit is None else Fit.from_dict(msgspec.to_builtins(fit))

    def verdict_value(self) -> Verdict | None:
        """Return the verdict, if the file has one with the fit behind it."""
        if self.fit is None:
            return None
        return Verdict.from_dict(msgspec.to_builtins(self))


def estimate_record(estimate: "Estimate") -> dict[str, Any]:
    """Return everything of an estimate but the model as plain numbers and text."""
    layout, base = estimate.model.layout, estimate.base
    errors = estimate.standard_errors
    errors = np.full(len(base), np.nan) if errors is None else errors
    return {
        "format": FORMAT,
        "robot": estimate.model.robot.name,
        "method": estimate.method,
        **estimate.verdict.to_dict(),
        "certificate": {
            "verdict": estimate.certificate.verdict,
            "reason": estimate.certificate.reason,
            "figures": {
                name: _finite(value)
                for name, value in estimate.certificate.figures.items()
            },
        },
        "parameters": {
            name: {"value": float(value), "unit": unit, "origin": origin}
            for name, value, unit, origin in zip(
                layout.names,
                estimate.parameters,
                layout.units,
                estimate.origins,
                strict=True,
            )
        },
        "base_parameters": [
            {
                "name": name,
                "value": float(value),
                "standard_error": _finite(error),
                "grouping": grouping,
            }
            for name, value, error, grouping in zip(
                base.names, estimate.base_values, errors, base.groupings, strict=True
            )
        ],
        "undetermined": list(estimate.undetermined),
        "sigma": dict(
            zip(estimate.model.torque_joints, estimate.sigma.tolist(), strict=True)
        ),
        "notes": list(estimate.notes),
        "seconds": estimate.seconds,
        "fit": None if estimate.fit is None else estimate.fit.to_dict(),
    }


def known_of_file(path: Path, model: TorqueModel) -> dict[str, Any]:
    """Return the fields of an estimate of a model, as a file states them.

    Raises
    ------
    ProblemError
        If the file is not an estimate of this model.
    """
    from consistent_id.estimation.estimate import Certificate

    record = read_estimate(path)
    certificate = record.certificate
    known = certificate.verdict in get_args(OptimumVerdict)
    if record.format != FORMAT or not known:
        raise ProblemError(f"{path}: not an estimate in the form {FORMAT!r}")
    if tuple(record.parameters) != model.layout.names or set(record.sigma) != set(
        model.torque_joints
    ):
        raise ProblemError(
            f"{path}: its parameters are not those of robot "
            f"{model.robot.name!r} with these drive terms"
        )
    return {
        "method": record.method,
        "parameters": np.array([entry.value for entry in record.parameters.values()]),
        "base_covariance": None,
        "origins": tuple(entry.origin for entry in record.parameters.values()),
        "undetermined": tuple(record.undetermined),
        "sigma": np.array([record.sigma[j] for j in model.torque_joints]),
        "certificate": Certificate(
            cast(OptimumVerdict, certificate.verdict),
            certificate.reason,
            certificate.known_figures,
        ),
        "notes": tuple(record.notes),
        "seconds": record.seconds,
        "fit": record.fit_value(),
        "accepted": tuple(record.accepted),
        "judged": record.verdict_value(),
    }


def read_estimate(path: Path) -> EstimateRecord:
    """Return what a file states.

    Raises
    ------
    ProblemError
        If it is no estimate of this form; with the path of the faulty key.
    """
    content = read_input(path, ProblemError, LARGEST_MODEL)
    try:
        known: Any = json.loads(content)  # which knows infinity, as msgspec does not
    except (ValueError, RecursionError) as cause:
        raise ProblemError(f"{path}: not JSON: {cause}") from None
    try:
        return msgspec.convert(known, type=EstimateRecord)
    except msgspec.ValidationError as cause:
        raise ProblemError(
            f"{path}: not an estimate: {cause} ($ is the file)"
        ) from None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
