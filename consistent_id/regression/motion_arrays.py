"""A recording's arrays in a torque model's order of joints, and rows along them.

Where the torque is low-passed, the same filter ``F`` is applied to the rows.  Samples
that do not count are set to zero before it (``M``), and five rows are kept in a period
of the cut-off (``S``): ``S F M Y x = S F M tau``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from threading import Lock
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    chunks,
)
from consistent_id._support.caches import kept_with
from consistent_id._support.executors import worker_threads
from consistent_id.recordings.beside import BaseMotion
from consistent_id.recordings.signals.filtered_rows import (
    RowFilter,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.regression.row_structure import row_structure
from consistent_id.regression.rows.contact_maps import (
    ContactMixing,
)

PIECE = 4 * CHUNK
"""Samples that one worker compresses before factors are merged."""

_KEPT = 2**28
"""Bytes of a recording's filtered rows that are kept for the next pass over it: those
of a quadruped on its feet are just below, 90 s with a cut-off of 30 Hz.
"""

_ALL_KEPT = 2 * _KEPT  # the same of all recordings at a time

_SMALL = 2**24
"""Bytes of rows, at most, that are kept for recordings of equal motion: with another
torque, such as with a delay or without springs, rows are the same.
"""

_WORKERS = 2
_FILLING = Lock()  # else workers that need the same rows would all compute them

_LITTLE = 0.05
"""Share of a filtered row's weight that must come from samples that count."""


class RowColumns(NamedTuple):
    """The columns of one row of a model; all others are zero.

    Parameters
    ----------
    places : ndarray of int, shape (columns,)
        Ascending.
    values : ndarray, shape (columns, samples)
    """

    places: IntArray
    values: Matrix


class Motion(NamedTuple):
    """Rows of a recording in the model's order of joints, all arrays of one length.

    Torque and weights are those of the model's torque joints.  Where forces of contacts
    are not measured, `mixing` takes them out: the torque is what is left, `peaks` are
    those of the torque before, and `shares` are what is left of each row's squared
    noise.

    Where the torque is filtered, rows have to be computed from all samples before the
    filter (`along`), and not from `q`, `dq` and `ddq`, the motion at the samples that
    the rows stand for.  `places` are those samples in the recording, `run` is the run
    of all `filtered` rows that is meant, and `known` is the share of each row's squared
    weights that is on samples that count.  `shift` is `Recording.torque_shift`.
    """

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    weights: Array | None
    base: BaseMotion | None = None
    mixing: ContactMixing | None = None
    peaks: Vector | None = None
    shares: Array | None = None
    known: Array | None = None
    places: IntArray | None = None
    filtered: "FilteredRows | None" = None
    run: slice = slice(None)
    shift: Array | None = None

    @property
    def along(self) -> "Motion":
        """All samples from before the filter; these themselves, without one."""
        return self if self.filtered is None else self.filtered.along

    @property
    def mixed(self) -> bool:
        """Whether forces of contacts that are not measured are taken out."""
        return self.along.mixing is not None

    def through(self, values: Array, row: int | None = None) -> Array:
        """Return these rows of values along `along`, filtered.

        Samples that do not count are set to zero first.

        Parameters
        ----------
        values : ndarray, shape (samples of `along`, rows of the model)
        row : int, optional
            The row whose values they all are, if it is one: any number of columns.
        """
        if self.filtered is None:
            return values
        return self.filtered.through(values, self.run, row)

    def samples(self, start: int, stop: int) -> "Motion":
        """Return consecutive rows."""
        start, stop, _ = slice(start, stop).indices(len(self.q))
        part, run = slice(start, stop), slice(None)
        if self.filtered is not None:
            first = self.run.indices(len(self.filtered.kept))[0]
            run = slice(first + start, first + stop)
        return self._replace(
            q=self.q[part],
            dq=self.dq[part],
            ddq=self.ddq[part],
            torque=self.torque[part],
            weights=_part(self.weights, part),
            base=None if self.base is None else self.base.samples(part),
            mixing=None if self.mixing is None else self.mixing.samples(part),
            shares=_part(self.shares, part),
            known=_part(self.known, part),
            places=None if self.places is None else self.places[part],
            run=run,
            shift=_part(self.shift, part),
        )

    def counts(self) -> IntArray:
        """Return the number of samples of each torque that the rows stand for."""
        return whole_counts(self.stood_for())

    def stood_for(self) -> Vector:
        """Return the unrounded number of samples of torque that the rows stand for.

        It adds over runs of rows.
        """
        counted = self.counted
        size = self.shares if self.shares is not None else self.known
        if size is None:
            return np.asarray(np.count_nonzero(counted, axis=0), dtype=np.float64)
        return np.asarray(size.sum(axis=0, where=counted))

    @property
    def counted(self) -> BoolArray:
        """Whether each row counts, shape (samples, rows)."""
        there = np.ones(self.torque.shape, dtype=bool)
        if self.weights is not None:
            there &= self.weights != 0.0
        if self.known is not None:
            there &= self.known > _LITTLE
        elif self.shares is not None:
            there &= self.shares > 0.0
        return there

    def noise_lost(self) -> Vector:
        """Return the noise of each row before it was mixed, over what is left of it.

        The rest is in the other rows, whose noise is like this one's.
        """
        if self.shares is None:
            return np.ones(self.torque.shape[1])
        n = len(self.shares)
        whole = n if self.known is None else np.maximum(self.known.sum(axis=0), 1.0)
        left = np.maximum(self.shares.sum(axis=0) / whole, 1.0 / n)
        return np.asarray(1.0 / np.sqrt(left))

    def predicted(self, model: TorqueModel, x: Vector) -> Array:
        """Return the torque of parameters along the motion, as `torque` is given."""
        if self.filtered is not None:
            return self.filtered.predicted(model, x, self.run)
        whole = model.predict(x, self.q, self.dq, self.ddq, base=self.base)
        return whole if self.mixing is None else self.mixing.mixed(whole)

    def pieces(self) -> Iterator["Motion"]:
        """Yield runs of rows, each for one worker."""
        rows = PIECE
        if self.filtered is not None and len(self.filtered.kept) > 1:
            kept = self.filtered.kept
            step = (kept[-1] - kept[0]) / (len(kept) - 1)
            rows = max(int(max(PIECE, 32 * self.filtered.by.reach) / step), 1)
        for part in chunks(len(self.q), rows):
            yield self.samples(part.start, part.stop)

    def rows(
        self, model: TorqueModel, kept: Sequence[IntArray], size: int = CHUNK
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield ``(samples, rows)`` with torque in the last column, weights applied.

        Parameters
        ----------
        kept : sequence of ndarray
            Wanted columns of each torque joint.
        size : int
            Samples in a piece.

        Yields
        ------
        samples : slice
        rows : sequence of ndarray, each shape (samples, columns wanted + 1)
            In Fortran's order.  The arrays are reused, and may be destroyed.
        """
        found = self._blocks(model, kept, size)
        if self.filtered is not None:
            found = self.filtered.blocks(model, kept, self.run)
        for part, blocks in found:
            for j, block in enumerate(blocks):
                block[:, -1] = self.torque[part, j]
                if self.weights is not None:
                    block *= self.weights[part, j, None]
            yield part, blocks

    def shifted(self, row: int) -> Array | None:
        """Return the change of a row's torque by an error that all samples share.

        See `Recording.torque_shift`; weighted as `rows` are.
        """
        if self.shift is None:
            return None
        own = self.shift[:, row]
        return own if self.weights is None else own * self.weights[:, row]

    def drive_columns(self, terms: DriveTerms, joint: int, row: int) -> Matrix:
        """Return the columns that drive terms would add to a joint's row of `rows`.

        Parameters
        ----------
        terms : DriveTerms
            Terms that need no load.
        joint, row : int
            Places of the joint among the robot's, and of its torque among the rows.

        Returns
        -------
        ndarray, shape (samples, coefficients)
        """
        along = self.along
        q, dq, ddq = (part[:, joint] for part in (along.q, along.dq, along.ddq))
        columns = [np.broadcast_to(c, q.shape) for c in terms.columns(q, dq, ddq)]
        found = self.through(np.column_stack(columns), row)
        return found if self.weights is None else found * self.weights[:, row, None]

    def regressor(self, model: TorqueModel) -> Array:
        """Return all columns, shape (rows of the model, parameters, samples).

        Filtered like the torque; weights are not applied.
        """
        rows = self.row_columns(model)
        Y = np.zeros((len(rows), len(model.layout), len(self.q)))
        for all_columns, own in zip(Y, rows, strict=True):
            all_columns[own.places] = own.values
        return Y

    def row_columns(self, model: TorqueModel) -> list[RowColumns]:
        """Return the columns that each row of the model has, as `regressor`."""
        structure = row_structure(model, mixed=self.mixed)
        places = [np.flatnonzero(expand.any(axis=0)) for _, expand in structure]
        found = [np.empty((len(own), len(self.q))) for own in places]
        bare = self._replace(weights=None)
        for part, blocks in bare.rows(model, [kept for kept, _ in structure]):
            for values, own, block, (_, expand) in zip(
                found, places, blocks, structure, strict=True
            ):
                values[:, part] = expand[:, own].T @ block[:, :-1].T
        return [RowColumns(*own) for own in zip(places, found, strict=True)]

    def _blocks(
        self, model: TorqueModel, kept: Sequence[IntArray], size: int
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        state = self.q, self.dq, self.ddq
        if self.mixing is None:
            yield from model.kept_chunks(kept, *state, size=size, base=self.base)
            return
        wanted = np.unique(np.concatenate(kept))
        places = [np.searchsorted(wanted, columns) for columns in kept]
        for part, Y in model.chunks(*state, size=size, base=self.base):
            blocks = [np.empty((Y.shape[2], len(c) + 1), order="F") for c in kept]
            for few, maps in self.mixing.samples(part).chunks():
                rows = np.moveaxis(Y[:, wanted, few], 2, 0)
                mixed = maps @ np.ascontiguousarray(rows)
                for j, (block, columns) in enumerate(zip(blocks, places, strict=True)):
                    block[few, :-1] = mixed[:, j, columns]
            yield part, blocks


def whole_counts(stood_for: Vector) -> IntArray:
    """Return whole numbers of samples that rows stand for.

    A row of which contacts take almost all still is a row.
    """
    rounded = np.maximum(np.rint(stood_for), stood_for > 0.0)
    return np.asarray(rounded, dtype=np.intp)


def _part(values: Array | None, part: slice) -> Array | None:
    return None if values is None else values[part]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class FilteredRows:
    """All filtered rows of a recording.

    Parameters
    ----------
    along : Motion
        All samples from before the filter; weights of zero and one mark what counts.
    by : RowFilter
    kept : ndarray of int, shape (rows,)
        The samples that the rows stand for, ascending.
    """

    along: Motion
    by: RowFilter
    kept: IntArray

    def through(
        self, values: Array, run: slice = slice(None), row: int | None = None
    ) -> Matrix:
        """Return a run of filtered rows of values along all samples."""
        weights = self.along.weights
        if weights is not None:
            values = values * (weights if row is None else weights[:, row, None])
        return self.by(values, self.kept[run])

    def predicted(self, model: TorqueModel, x: Vector, run: slice) -> Matrix:
        """Return the filtered torque of parameters."""

        def torque(span: slice) -> Matrix:
            moved = self.along.samples(span.start, span.stop)
            found = moved.predicted(model, x)
            return found if moved.weights is None else moved.weights * found

        return self.by.of_spans(torque, self.kept[run], len(self.along.q))

    def blocks(
        self, model: TorqueModel, kept: Sequence[IntArray], run: slice
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield pieces of rows; see `Motion.rows`."""
        width = sum(len(columns) + 1 for columns in kept)
        if 8 * width * len(self.kept) > _KEPT:
            yield from self.computed(model, kept, run)
            return
        columns = tuple(c.tobytes() for c in kept)
        motion = self._motion() if 8 * width * len(self.kept) <= _SMALL else None
        with _FILLING:
            every = (
                _kept_blocks(model, self, columns)
                if motion is None
                else _equal_blocks(model, motion, columns)
            )
        samples = len(self.kept[run])
        yield slice(0, samples), [np.array(own[run], order="F") for own in every]

    def _motion(self) -> "_RowsOfMotion | None":
        """Return the key of equal motion; None where a base moves or contacts mix."""
        along = self.along
        if along.base is not None or along.mixing is not None:
            return None
        arrays = (along.q, along.dq, along.ddq, along.weights, self.kept)
        digest = blake2b(repr(self.by).encode())
        for values in arrays:
            digest.update(b"-" if values is None else str(values.shape).encode())
            if values is not None:
                digest.update(np.ascontiguousarray(values).data)
        return _RowsOfMotion(digest.digest(), self)

    def computed(
        self, model: TorqueModel, kept: Sequence[IntArray], run: slice
    ) -> Iterator[tuple[slice, list[Matrix]]]:
        """Yield pieces of rows, filtered now."""
        samples = self.kept[run]
        for rows, span in self.by.spans(samples, len(self.along.q)):
            yield rows, self._filtered(model, kept, samples[rows], span)

    def filled(self, model: TorqueModel, kept: Sequence[IntArray]) -> list[Matrix]:
        """Return all rows of each joint; runs of them are filtered side by side."""
        blocks = [np.empty((len(self.kept), len(c) + 1), order="F") for c in kept]

        def fill(piece: tuple[slice, slice]) -> None:
            rows, span = piece
            found = self._filtered(model, kept, self.kept[rows], span)
            for block, own in zip(blocks, found, strict=True):
                block[rows] = own

        with worker_threads(_WORKERS) as pool:
            for _ in pool.map(fill, self.by.spans(self.kept, len(self.along.q))):
                pass  # an error is raised here
        return blocks

    def _filtered(
        self,
        model: TorqueModel,
        kept: Sequence[IntArray],
        samples: IntArray,
        span: slice,
    ) -> list[Matrix]:
        """Return the rows of each joint at some samples, from a span around them."""
        moved = self.along.samples(span.start, span.stop)
        every = [np.empty((len(moved.q), len(c) + 1), order="F") for c in kept]
        for part, blocks in moved.rows(model, kept):
            for own, block in zip(every, blocks, strict=True):
                own[part] = block
        through, whole = self.by.part, len(self.along.q)
        return [np.asfortranarray(through(own, samples, span, whole)) for own in every]


@dataclass(frozen=True, slots=True)
class _RowsOfMotion:
    """Filtered rows, equal where motion, filter and kept samples are equal."""

    digest: bytes
    rows: FilteredRows = field(compare=False)


def _size(rows: Sequence[Matrix]) -> int:
    return sum(block.nbytes for block in rows)


@kept_with(None, most=8, room=4 * _SMALL, size=_size)
def _equal_blocks(
    model: TorqueModel, motion: _RowsOfMotion, columns: tuple[bytes, ...]
) -> list[Matrix]:
    """Return all filtered rows of a motion, whatever its torque is.

    The last column of each block is left for the torque.
    """
    return motion.rows.filled(model, [np.frombuffer(c, dtype=np.intp) for c in columns])


@kept_with(1, most=6, room=_ALL_KEPT, size=_size)
def _kept_blocks(
    model: TorqueModel, rows: FilteredRows, columns: tuple[bytes, ...]
) -> list[Matrix]:
    """Return all filtered rows of a recording, for one pass after another."""
    return rows.filled(model, [np.frombuffer(c, dtype=np.intp) for c in columns])
