"""A regression that is not built from recordings: given as arrays, or read from a file.

Whatever measured given rows: force plates under a person, a crane's load cell, a
satellite.  A file has all that estimators need, without the recordings.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, checked
from consistent_id._support.executors import single_threaded
from consistent_id._support.files import MEBIBYTE, read_input, write_atomically
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.linear import independent_columns
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout

FORMAT = "consistent_id regression 1"
_LARGEST = 256 * MEBIBYTE  # bytes; an arm with seven joints has about 1 MB

_Rows = list[list[float]]


@brief
class GivenRows(NamedTuple):
    """The input of estimators: a model, its regression and its base parameters.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
    base : BaseParameters
    """

    model: TorqueModel
    regression: Regression
    base: BaseParameters


@single_threaded
def given_rows(
    robot: RobotModel,
    rows: Sequence[str],
    regressor: ArrayLike,
    measured: ArrayLike,
    *,
    sigma: ArrayLike = 1.0,
) -> GivenRows:
    """Compress a given regressor: ``measured = regressor @ x`` for every sample.

    Parameters
    ----------
    robot : RobotModel
        Model whose bodies the columns belong to; `free_bodies` makes one.
    rows : sequence of str
        Names of the rows of a sample, such as ``("nx", "ny", "fz")``.
    regressor : array_like, shape (samples, rows, 10 links)
        Columns in this package's order: see `InertialParameters`.
    measured : array_like, shape (samples, rows)
    sigma : array_like, shape (rows,)
        Standard deviation of each row's noise.

    Returns
    -------
    GivenRows
        Its base parameters are those of the regressor: what other motions would show
        is not known.

    Raises
    ------
    ProblemError
        If a shape is wrong or a value is not finite.
    """
    model = TorqueModel(robot, torque_joints=tuple(rows))
    if robot.connected:
        raise ProblemError(
            f"robot {robot.name!r}: its links are connected, so its regressor follows "
            "from its motion; give bodies (free_bodies), or use build_regression"
        )
    Y = checked(regressor, (None, len(rows), len(model.layout)), "regressor")
    tau = checked(measured, (len(Y), len(rows)), "measured")
    whole = np.concatenate([Y, tau[:, :, None]], axis=2)
    regression = Regression(
        layout=model.layout,
        joints=model.torque_joints,
        factors=tuple(
            triangle(np.asfortranarray(whole[:, j])) for j in range(len(rows))
        ),
        counts=(len(Y),) * len(rows),
        sigma=np.broadcast_to(checked_sigma(sigma, len(rows)), (len(rows),)),
        fingerprint=model.fingerprint,
        peaks=abs(tau).max(axis=0),
    )
    split = independent_columns(regression.stacked()[:, :-1])
    base = BaseParameters(model.layout, *split, fingerprint=model.fingerprint)
    return GivenRows(model, regression, base)


def checked_sigma(sigma: ArrayLike, rows: int) -> np.ndarray:
    """Return one noise level for each row."""
    return checked(sigma, (rows,) if np.ndim(sigma) else (), "sigma")


class _NoiseRecord(msgspec.Struct, forbid_unknown_fields=True):
    """See `CorrelatedNoise`."""

    effective: list[float]
    scores: list[_Rows]
    blocks: float = 1.0
    freedom: list[float] | None = None  # None in files of earlier releases
    shared: list[_Rows] = []  # shapes; empty in files of earlier releases


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
            [N.tolist() for N in noise.shapes],
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
    if len(noise.shared) not in (0, n):
        raise ProblemError(
            f"shared errors of {len(noise.shared)} joints, expected {n} or none"
        )
    scores, shapes = (
        tuple(_matrix(rows, width, what) for rows in of_joints)
        for what, of_joints in (("scores", noise.scores), ("shared", noise.shared))
    )
    if len({len(rows) for rows in shapes}) > 1:
        raise ProblemError(
            f"shared errors: {' and '.join(str(len(rows)) for rows in shapes)} rows of "
            "the joints, expected the same number of all"
        )
    return CorrelatedNoise(effective, scores, freedom, noise.blocks, shapes)


def _matrix(rows: _Rows, width: int, what: str) -> Array:
    """Return rows of equal length as a matrix; there may be none."""
    lengths: set[Any] = {len(row) for row in rows} - {width}
    if lengths:
        raise ProblemError(
            f"{what}: a row of {lengths.pop()} numbers, expected {width}"
        )
    return np.array(rows, dtype=np.float64).reshape(-1, width)
