"""Rows of a log that may be larger than memory: read in windows, in ascending order."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.array_parts import parts_of, stored_names
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.named_arrays import (
    Arrays,
    recording_of,
    vector_of,
)
from consistent_id.recordings.readers.recording_file import reader_of, wanted_of
from consistent_id.recordings.readers.units import factors
from consistent_id.recordings.recording import Recording


class RowSource(Protocol):
    """What rows of a log are read from."""

    @property
    def path(self) -> Path:
        """The log."""

    def times(self) -> Iterator[Vector]:
        """Yield the times of all rows, some at a time [s]."""

    def windows(self, rows: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield the recording of each range of rows, ``first <= row < last``.

        Neither the first nor the last rows of the ranges may decrease.
        """


@dataclass(frozen=True)
class LogRows:
    """A log on disk, and what is to be read of it.

    Parameters
    ----------
    path : Path
        Of a format that `LogFormat.streams`.
    torque_gain : array_like, shape () or (joints,)
    omit : tuple of int
        Rows that are left out, counted from 1; other rows are counted without them.
    """

    path: Path
    joints: tuple[str, ...]
    columns: Columns
    torque_gain: ArrayLike = 1.0
    omit: tuple[int, ...] = ()

    def times(self) -> Iterator[Vector]:
        """Yield the times of all rows, some at a time [s]."""
        name = self.columns.time
        units = wanted_of(self.path, self.columns, self.joints).units
        (unit,) = set(factors(units, "time", self.joints[:1]).tolist())
        for arrays in self._batches([name], 0):
            yield vector_of(arrays, name, str(self.path)) * unit

    def windows(self, rows: Iterable[tuple[int, int]]) -> Iterator[Recording]:
        """Yield the recording of each range of rows, ``first <= row < last``.

        Neither the first nor the last rows of the ranges may decrease.
        """
        want = wanted_of(self.path, self.columns, self.joints)
        held: deque[Arrays] = deque()
        batches: Iterator[Arrays] | None = None
        begin = end = 0
        for first, last in rows:
            if batches is None:
                batches, begin, end = self._batches(want.names, first), first, first
            while held and begin + _rows(held[0]) <= first:
                begin += _rows(held.popleft())
            while end < last and (batch := next(batches, None)) is not None:
                if end + _rows(batch) > first:
                    held.append(batch)
                else:
                    begin += _rows(batch)
                end += _rows(batch)
            part = slice(first - begin, last - begin)
            arrays = {
                name: np.concatenate([batch[name] for batch in held])[part]
                for name in want.names
            }
            yield recording_of(
                arrays,
                want,
                where=str(self.path),
                name=self.path.name,
                torque_gain=self.torque_gain,
            )

    def _batches(self, names: list[str], first: int) -> Iterator[Arrays]:
        """Yield the named arrays from a row on, without the rows to omit."""
        at = first
        omitted = np.array(sorted(row - 1 for row in self.omit), dtype=int)
        for row in omitted:
            at += row <= at
        stored = stored_names(names)
        for batch in reader_of(self.path).read_batches(self.path, stored, at):
            arrays = parts_of(batch, names, self.path)
            rows = _rows(arrays)
            if len(omitted):
                keep = ~np.isin(np.arange(at, at + rows), omitted)
                arrays = {name: values[keep] for name, values in arrays.items()}
            at += rows
            if _rows(arrays):
                yield arrays
        if len(omitted) and omitted[-1] >= at:
            raise RecordingError(
                f"{self.path}: omit names row {omitted[-1] + 1}, but there are {at}, "
                "counted from 1"
            )


def _rows(arrays: Arrays) -> int:
    return len(next(iter(arrays.values())))
