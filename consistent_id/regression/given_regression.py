"""The JSON file of a regression: all that estimators need, without the recordings."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.files import MEBIBYTE, read_input, write_atomically
from consistent_id.errors import ProblemError
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.regression import Regression
from consistent_id.robot.parameters import ParameterLayout

FORMAT = "consistent_id regression 1"
_LARGEST = 256 * MEBIBYTE  # bytes; an arm with seven joints has about 1 MB

_Rows = list[list[float]]


class _NoiseRecord(msgspec.Struct, forbid_unknown_fields=True):
    """See `CorrelatedNoise`."""

    effective: list[float]
    scores: list[_Rows]
    blocks: float = 1.0
    freedom: list[float] | None = None  # None in files of earlier releases


class _RegressionRecord(msgspec.Struct, forbid_unknown_fields=True):
    """See `Regression`."""

    format: str
    fingerprint: str
    links: tuple[str, ...]
    drive: tuple[tuple[str, str], ...]
    drive_units: tuple[str, ...]
    joints: tuple[str, ...]
    counts: tuple[int, ...]
    sigma: list[float]
    peaks: list[float]
    factors: list[_Rows]
    noise: _NoiseRecord | None
    digest: str = ""  # of the file's mark


def save_regression(regression: Regression, path: str | Path) -> Path:
    """Write a regression to a JSON file, and return its path.

    Numbers come back to the last bit.  A loaded regression can be added to others of
    the same torque model, weighted anew, and estimated from; the recordings are not
    needed any more.

    Parameters
    ----------
    regression : Regression
    path : str or Path

    Raises
    ------
    ProblemError
        If the file cannot be written.
    """
    noise, layout = regression.noise, regression.layout
    record = _RegressionRecord(
        format=FORMAT,
        fingerprint=regression.fingerprint,
        links=layout.links,
        drive=layout.drive,
        drive_units=layout.drive_units,
        joints=regression.joints,
        counts=regression.counts,
        sigma=regression.sigma.tolist(),
        peaks=regression.peaks.tolist(),
        factors=[factor.tolist() for factor in regression.factors],
        noise=None
        if noise is None
        else _NoiseRecord(
            noise.effective.tolist(),
            [N.tolist() for N in noise.scores],
            noise.beyond,
            noise.freedom.tolist(),
        ),
    )
    # Formatted, the file has the blank by which those of this package are known.
    content = msgspec.json.format(msgspec.json.encode(record), indent=0)
    return write_atomically(path, content)


def load_regression(path: str | Path) -> Regression:
    """Read a regression that `save_regression` has written.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    ProblemError
        If the file cannot be read, or its content does not fit together.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import consistent_id as ci
    >>> model = ci.TorqueModel(ci.from_modified_dh("arm", [ci.DHRow(0, 0)]))
    >>> rng = np.random.default_rng(0)
    >>> log = ci.Recording(("joint1",), np.arange(9.0), *rng.normal(size=(4, 9, 1)))
    >>> from consistent_id.regression import load_regression, save_regression
    >>> regression = ci.build_regression(model, log)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = save_regression(regression, f"{folder}/a")
    ...     (load_regression(file) + load_regression(file)).counts
    (18,)
    """
    path = Path(path)
    content = read_input(path, ProblemError, _LARGEST)
    try:
        record = msgspec.json.decode(content, type=_RegressionRecord)
    except (msgspec.DecodeError, RecursionError) as cause:
        raise ProblemError(
            f"{path}: not a regression: {cause} ($ is the file)"
        ) from None
    if record.format != FORMAT:
        raise ProblemError(f"{path}: its format is {record.format!r}, not {FORMAT!r}")
    try:
        return _regression(record)
    except ProblemError as cause:
        raise ProblemError(f"{path}: {cause}; save it again") from None


def _regression(record: _RegressionRecord) -> Regression:
    layout = ParameterLayout(record.links, record.drive, record.drive_units)
    width = len(layout)
    return Regression(
        layout=layout,
        joints=record.joints,
        factors=tuple(_matrix(rows, width + 1, "factors") for rows in record.factors),
        counts=record.counts,
        sigma=np.array(record.sigma),
        fingerprint=record.fingerprint,
        noise=None if record.noise is None else _noise(record, record.noise, width),
        peaks=np.array(record.peaks),
    )


def _noise(
    record: _RegressionRecord, noise: _NoiseRecord, width: int
) -> CorrelatedNoise:
    n = len(record.joints)
    effective = np.array(noise.effective)
    freedom = effective if noise.freedom is None else np.array(noise.freedom)
    sizes = {len(effective), len(noise.scores), len(freedom)}
    if sizes != {n} or not ((effective > 0) & (freedom > 0)).all():
        raise ProblemError(
            f"noise of {' and '.join(map(str, sorted(sizes)))} joints, expected "
            f"positive numbers of {n}"
        )
    scores = tuple(_matrix(rows, width, "scores") for rows in noise.scores)
    return CorrelatedNoise(effective, scores, freedom, noise.blocks)


def _matrix(rows: _Rows, width: int, what: str) -> Array:
    """Return rows of equal length as a matrix; there may be none."""
    lengths: set[Any] = {len(row) for row in rows} - {width}
    if lengths:
        raise ProblemError(
            f"{what}: a row of {lengths.pop()} numbers, expected {width}"
        )
    return np.array(rows, dtype=np.float64).reshape(-1, width)
