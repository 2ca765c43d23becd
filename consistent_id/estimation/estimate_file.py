"""The JSON file of an estimate, read back through a schema."""

import json
from pathlib import Path
from typing import Any

import msgspec

from consistent_id._support.inputs import LARGEST_MODEL, read_input
from consistent_id.errors import ProblemError

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
