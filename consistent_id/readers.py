"""Recordings from CSV and Parquet files, by the names of their columns."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Formatter

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._arrays import Array, Matrix, frozen
from consistent_id.errors import RecordingError
from consistent_id.parameters import did_you_mean
from consistent_id.recording import Recording


@dataclass(frozen=True, slots=True)
class Columns:
    """How a file names its columns.

    ``{joint}`` stands for a joint's name and ``{number}`` for its place among the
    joints, counted from 1.  None: the file has no such channel.

    Examples
    --------
    >>> Columns(position="q{number}").position.format(joint="elbow", number=3)
    'q3'
    """

    time: str = "time"
    position: str = "q_{joint}"
    velocity: str | None = None
    acceleration: str | None = None
    torque: str | None = None


def read_recording(
    path: str | Path,
    joints: Sequence[str],
    columns: Columns | None = None,
    *,
    torque_gain: ArrayLike = 1.0,
) -> Recording:
    """Read a recording from a ``.csv`` or ``.parquet`` file.

    Parameters
    ----------
    path : str or Path
    joints : sequence of str
        Names of the joints to read.
    columns : Columns
        Names of the columns, in SI units (s, rad, m, N m, N).
    torque_gain : array_like, shape () or (joints,)
        Factor from the torque column to torque, such as a drive's N m per ampere.

    Raises
    ------
    RecordingError
        If the file, a column or a value is missing or faulty; with file, row, column.
    """
    path, columns = Path(path), columns or Columns()
    if not joints:
        raise RecordingError(f"{path}: no joint to read; name at least one")
    patterns = {
        channel: getattr(columns, channel)
        for channel in ("position", "velocity", "acceleration", "torque")
        if getattr(columns, channel) is not None
    }
    wanted = {channel: _expand(p, joints) for channel, p in patterns.items()}
    names = [columns.time, *(name for group in wanted.values() for name in group)]
    table = _read_table(path, names)
    channels: dict[str, Matrix] = {
        channel: np.column_stack([table[name] for name in group])
        for channel, group in wanted.items()
    }
    if "torque" in channels:
        shape = (len(joints),) if np.ndim(torque_gain) else ()
        gain = frozen(torque_gain, shape, "torque_gain", RecordingError)
        channels["torque"] = channels["torque"] * gain
    return Recording(tuple(joints), table[columns.time], name=path.name, **channels)


def _expand(pattern: str, joints: Sequence[str]) -> list[str]:
    try:
        fields = {field for _, field, _, _ in Formatter().parse(pattern)}
    except ValueError:
        fields = {pattern}
    if not fields <= {None, "joint", "number"}:
        raise RecordingError(
            f"column pattern {pattern!r}: only {{joint}} and {{number}} can stand in it"
        )
    try:
        names = [pattern.format(joint=j, number=i) for i, j in enumerate(joints, 1)]
    except ValueError as cause:
        raise RecordingError(
            f"column pattern {pattern!r}: only {{joint}} and {{number}} can stand in "
            f"it ({cause})"
        ) from None
    if len(set(names)) != len(names):
        raise RecordingError(
            f"column pattern {pattern!r} gives one name for several joints; "
            "put {joint} or {number} in it"
        )
    return names


def _read_table(path: Path, names: Sequence[str]) -> dict[str, Array]:
    readers = {".csv": _read_csv, ".parquet": _read_parquet}
    if path.suffix.lower() not in readers:
        raise RecordingError(
            f"{path}: cannot read {path.suffix or 'files without an ending'}, "
            f"expected {' or '.join(readers)}"
        )
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    return readers[path.suffix.lower()](path, list(dict.fromkeys(names)))


def _read_csv(path: Path, names: Sequence[str]) -> dict[str, Array]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        lines = csv.reader(file, skipinitialspace=True)
        try:
            header = [name.strip() for name in next(lines, [])]
            _require(path, names, header)
            places = [header.index(name) for name in names]
            rows = [
                _numbers(path, lines.line_num, line, header, places)
                for line in lines
                if line
            ]
        except (csv.Error, UnicodeDecodeError) as cause:
            raise RecordingError(f"{path}: not readable as CSV: {cause}") from None
    if not rows:
        raise RecordingError(f"{path}: no row below the header")
    return dict(zip(names, np.array(rows).T, strict=True))


def _numbers(
    path: Path, row: int, line: list[str], header: list[str], places: list[int]
) -> list[float]:
    if len(line) != len(header):
        raise RecordingError(
            f"{path}, row {row}: {len(line)} fields, the header has {len(header)}"
        )
    values = []
    for place in places:
        text = line[place]
        try:
            if "_" in text or not text.isascii():
                raise ValueError  # Python's float() would take them
            values.append(float(text))
        except ValueError:
            raise RecordingError(
                f"{path}, row {row}, column {header[place]!r}: {text!r} is not "
                "a number. Only one header row is allowed, and '.' marks decimals"
            ) from None
    return values


def _read_parquet(path: Path, names: Sequence[str]) -> dict[str, Array]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise RecordingError(
            f"{path}: reading Parquet needs pyarrow; "
            "pip install 'consistent-id[parquet]'"
        ) from None
    try:
        _require(path, names, pq.read_schema(path).names)
        table = pq.read_table(path, columns=list(names))
    except (pa.ArrowException, OSError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None
    columns = {}
    for name in names:
        kind = table[name].type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            raise RecordingError(
                f"{path}: column {name!r} holds {kind}, expected numbers in SI units"
            )
        columns[name] = table[name].to_numpy().astype(np.float64)
    return columns


def _require(path: Path, names: Sequence[str], header: Sequence[str]) -> None:
    for name in names:
        if name not in header:
            near = did_you_mean(name, header)
            raise RecordingError(f"{path}: no column {name!r}; {near}")
        if list(header).count(name) > 1:
            raise RecordingError(f"{path}: column {name!r} stands there twice")
