"""An estimate's values for people and programs: rows of tables, and its JSON file.

`Estimate.to_dict` writes the file; here is its schema.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import msgspec
import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.extras import pandas
from consistent_id._support.files import LARGEST_MODEL, read_input
from consistent_id._support.tables import Table
from consistent_id.constraints.cones.certificate import Certificate, OptimumVerdict
from consistent_id.errors import ProblemError
from consistent_id.estimation.determination import SMALL, origin_text
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.method import FittedSpan
from consistent_id.estimation.verdict import Verdict, Word
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import NORMAL, width_text
from consistent_id.robot.parameters import ParameterLayout

if TYPE_CHECKING:
    from pandas import DataFrame

FORMAT = "consistent_id estimate 1"

_OPTIMA = get_args(OptimumVerdict)

ERRORS = (
    "standard error: for noise as correlated as the residuals, and the prior's bias; "
    "uncertainty (--uncertainty) also includes the scatter between recordings; - where "
    "the data do not determine the parameter"
)
"""A description of `Estimate.parameter_errors`, for people."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedValues:
    """Values with their errors, as far as these are known.

    Parameters
    ----------
    values : ndarray, shape (parameters,)
    errors : ndarray, shape (parameters,), optional
        Standard errors, not finite where the data do not determine a value.
    quantiles : ndarray, shape (parameters,), optional
        Standard errors either way of a 95 % interval; by default those of a normal
        distribution.
    """

    values: Vector
    errors: Vector | None
    quantiles: Vector | None

    @property
    def half_intervals(self) -> Vector | None:
        """Half of the 95 % intervals."""
        if self.errors is None:
            return None
        quantiles = NORMAL if self.quantiles is None else self.quantiles
        return np.asarray(self.errors * quantiles)

    @property
    def error_texts(self) -> tuple[str, ...]:
        """Errors for people: a dash where there is none."""
        if self.errors is None:
            return ("-",) * len(self.values)
        return tuple(f"{e:.2g}" if np.isfinite(e) else "-" for e in self.errors)

    def origin_texts(self, origins: tuple[str, ...]) -> tuple[str, ...]:
        """Return origins for people: small where the data do not determine a value."""
        errors, quantiles = self.errors, self.quantiles
        if errors is None:
            return origins
        quantiles = np.full(len(errors), NORMAL) if quantiles is None else quantiles
        each = zip(origins, self.values, errors, quantiles, strict=True)
        return tuple(origin_text(o, x, e, q) for o, x, e, q in each)

    @property
    def width_notes(self) -> tuple[str, ...]:
        """How wide intervals are, if they are wider than those of known errors."""
        if self.errors is None or self.quantiles is None:
            return ()
        known = np.isfinite(self.errors) & (self.errors > 0.0)
        text = width_text(self.quantiles[known])
        return (text,) if text else ()

    def records(self) -> Iterator[dict[str, float | None]]:
        """Yield each value with its standard error and half of its interval."""
        unknown, half = np.full(len(self.values), np.nan), self.half_intervals
        errors = unknown if self.errors is None else self.errors
        half = unknown if half is None else half
        for value, error, width in zip(self.values, errors, half, strict=True):
            yield {
                "value": float(value),
                "standard_error": finite_or_none(error),
                "half_interval": finite_or_none(width),
            }


def error_notes(found: EstimatedValues, origin_texts: Iterable[str]) -> tuple[str, ...]:
    """Return the meaning of errors, and of the words in texts of origins."""
    small = any(text.startswith("small") for text in origin_texts)
    return (ERRORS, *found.width_notes, *([SMALL] if small else []))


def parameter_table(
    title: str,
    found: EstimatedValues,
    layout: ParameterLayout,
    origins: tuple[str, ...],
    notes: tuple[str, ...],
) -> Table:
    """Return a table of standard parameters."""
    columns = ("parameter", "value", "standard error", "unit", "determined by")
    texts = (f"{value:.6g}" for value in found.values)
    sources = found.origin_texts(origins)
    each = (layout.names, texts, found.error_texts, layout.units, sources)
    return Table(title, columns, tuple(zip(*each, strict=True)), notes)


def base_table(
    title: str, found: EstimatedValues, base: BaseParameters, notes: tuple[str, ...]
) -> Table:
    """Return a table of base parameters with errors."""
    columns = ("base parameter, led by", "value", "standard error", "unit")
    units = [base.layout.units[i] for i in base.independent]
    errors = np.zeros(0) if found.errors is None else found.errors
    rows = tuple(
        (name, f"{value:.6g}", f"{error:.2g}", unit)
        for name, value, error, unit in zip(
            base.names, found.values, errors, units, strict=True
        )
    )
    return Table(title, columns, rows, notes)


def parameter_frame(
    found: EstimatedValues, layout: ParameterLayout, origins: Iterable[str]
) -> "DataFrame":
    """Return standard parameters as a data frame; see `Estimate.to_frame`."""
    errors, half = found.errors, found.half_intervals
    return pandas().DataFrame(
        {
            "value": found.values,
            "standard_error": np.nan if errors is None else errors,
            "half_interval": np.nan if half is None else half,
            "unit": list(layout.units),
            "determined_by": list(origins),
        },
        index=pandas().Index(layout.names, name="parameter"),
    )


def parameter_records(
    found: EstimatedValues, layout: ParameterLayout, origins: Iterable[str]
) -> dict[str, dict[str, Any]]:
    """Return standard parameters as plain numbers and text, by name."""
    each = zip(layout.names, found.records(), layout.units, origins, strict=True)
    return {
        name: {**record, "unit": unit, "origin": origin}
        for name, record, unit, origin in each
    }


def base_records(found: EstimatedValues, base: BaseParameters) -> list[dict[str, Any]]:
    """Return base parameters as plain numbers and text."""
    each = zip(base.names, found.records(), base.groupings, strict=True)
    return [
        {"name": name, **record, "grouping": grouping}
        for name, record, grouping in each
    ]


def certificate_record(certificate: Certificate) -> dict[str, Any]:
    """Return a certificate as plain numbers and text."""
    figures = {k: finite_or_none(v) for k, v in certificate.figures.items()}
    return {**asdict(certificate), "figures": figures}


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

    def value(self) -> Certificate:
        """Return the certificate; figures are NaN where the file has none."""
        figures = {k: nan if v is None else v for k, v in self.figures.items()}
        return Certificate(cast(OptimumVerdict, self.verdict), self.reason, figures)


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

    def values(self) -> EstimatedValues:
        """Return the standard parameters; errors and quantiles if the file has any."""
        entries = self.parameters.values()
        errors = np.array(
            [nan if e.standard_error is None else e.standard_error for e in entries]
        )
        half = np.array(
            [nan if e.half_interval is None else e.half_interval for e in entries]
        )
        stated = np.isfinite(half) & (errors > 0.0)
        quantiles = np.where(stated, half, NORMAL) / np.where(stated, errors, 1.0)
        return EstimatedValues(
            np.array([entry.value for entry in entries]),
            errors if np.isfinite(errors).any() else None,
            quantiles if stated.any() else None,
        )

    def spans(self) -> tuple[FittedSpan, ...]:
        """Return the spans of recordings that the estimate was fitted to."""
        return tuple(FittedSpan(s.recording, s.start, s.stop) for s in self.fitted_to)

    def fit_value(self) -> Fit | None:
        """Return the fit, if the file has one."""
        fit = self.fit
        return None if fit is None else Fit.from_dict(msgspec.to_builtins(fit))

    def verdict_value(self) -> Verdict | None:
        """Return the verdict, if the file has one with the fit behind it."""
        if self.fit is None:
            return None
        return Verdict.from_dict(msgspec.to_builtins(self))

    def fields(self, model: TorqueModel) -> dict[str, Any]:
        """Return the fields of a model's `Estimate` that the file has."""
        found = self.values()
        return {
            "method": self.method,
            "parameters": found.values,
            "origins": tuple(entry.origin for entry in self.parameters.values()),
            "undetermined": tuple(self.undetermined),
            "sigma": np.array([self.sigma[j] for j in model.torque_joints]),
            "certificate": self.certificate.value(),
            "notes": tuple(self.notes),
            "seconds": self.seconds,
            "fit": self.fit_value(),
            "accepted": tuple(self.accepted),
            "judged": self.verdict_value(),
            "fitted_to": self.spans(),
            "parameter_errors": found.errors,
            "parameter_quantiles": found.quantiles,
        }


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
        beside = path.parent / "problem.toml"
        remedy = f"; give the problem beside it, {beside}" if beside.exists() else ""
        raise ProblemError(
            f"{path}: its parameters are not those of robot "
            f"{model.robot.name!r} with these drive terms{remedy}"
        )
    return record


def finite_or_none(value: float) -> float | None:
    """Return a figure for the file: None where it is not finite."""
    return float(value) if np.isfinite(value) else None
