"""The schema of an estimate's JSON file; `Estimate.to_dict` writes it."""

import json
from math import nan
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np

from consistent_id._support.files import LARGEST_MODEL, read_input
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.errors import ProblemError
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.verdict import Verdict, Word
from consistent_id.regression.regressor import TorqueModel

FORMAT = "consistent_id estimate 1"

_OPTIMA = get_args(OptimumVerdict)


class ParameterRecord(msgspec.Struct):
    """One parameter."""

    value: float
    origin: str
    standard_error: float | None = None
    half_interval: float | None = None


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
    """The explained part of one joint's torque; see `Fit`."""

    torque: float | None
    misfits: float | None
    shares: float | None
    slopes: float | None
    explained: float | None
    expected: float | None
    efforts: float | None
    moving: float | None = None
    holding: float | None = None
    prior_errors: float | None = None


class FitRecord(msgspec.Struct):
    """The explained part of the training data; see `Fit`."""

    misfit: float | None
    floor: float | None
    excess: float | None
    drive_share: float | None
    joints: dict[str, JointRecord]
    correlation: float | None = None
    spare: float | None = None
    guessed: float | None = None
    friction_share: float | None = None


class ReasonRecord(msgspec.Struct):
    """One reason for the verdict; see `Reason`."""

    kind: str
    word: Word
    statement: str
    advice: str
    factor: str = ""
    size: str = ""


class SpanRecord(msgspec.Struct):
    """A recording that the estimate was fitted to; see `FittedSpan`."""

    recording: str
    start: float
    stop: float


class EstimateRecord(msgspec.Struct):
    """The fields that are read; the file contains more, for people."""

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
    fitted_to: list[SpanRecord] = []
    held_out_recordings: list[str] = []

    def fit_value(self) -> Fit | None:
        """Return the fit, if the file has one."""
        fit = self.fit
        return None if fit is None else Fit.from_dict(msgspec.to_builtins(fit))

    def verdict_value(self) -> Verdict | None:
        """Return the verdict, if the file has one with the fit behind it."""
        if self.fit is None:
            return None
        return Verdict.from_dict(msgspec.to_builtins(self))


def read_estimate(path: Path, model: TorqueModel) -> EstimateRecord:
    """Return a model's estimate as a file states it.

    Raises
    ------
    ProblemError
        If it is not an estimate of this form (the message has the path of the faulty
        key), or has other parameters.
    """
    content = read_input(path, ProblemError, LARGEST_MODEL)
    try:
        known: Any = json.loads(content)  # which accepts infinity; msgspec does not
    except (ValueError, RecursionError) as cause:
        raise ProblemError(f"{path}: not JSON: {cause}") from None
    try:
        record = msgspec.convert(known, type=EstimateRecord)
    except msgspec.ValidationError as cause:
        raise ProblemError(
            f"{path}: not an estimate: {cause} ($ is the file)"
        ) from None
    if record.format != FORMAT or record.certificate.verdict not in _OPTIMA:
        raise ProblemError(f"{path}: not an estimate in the form {FORMAT!r}")
    same = tuple(record.parameters) == model.layout.names
    if not same or set(record.sigma) != set(model.torque_joints):
        raise ProblemError(
            f"{path}: its parameters are not those of robot "
            f"{model.robot.name!r} with these drive terms"
        )
    return record


def finite_or_none(value: float) -> float | None:
    """Return a figure for the file: None where it is not finite."""
    return float(value) if np.isfinite(value) else None
