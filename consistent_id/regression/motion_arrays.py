"""A recording's arrays in a torque model's order of joints, and rows along them.

Where the torque is low-passed, the same filter ``F`` is applied to the rows.  Samples
that do not count are set to zero before it (``M``), and five rows are kept in a period
of the cut-off (``S``): ``S F M Y x = S F M tau``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
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
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.recordings.recording import Recording, TorqueFilter
from consistent_id.recordings.signals.filtered_rows import (
    RowFilter,
    around,
    places_of_rows,
    require_filter,
    require_unchanged,
    row_filter,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.regression.row_structure import row_structure
from consistent_id.regression.rows.contact_maps import (
    ContactMixing,
    mixing_of,
    unknown_rows,
)
from consistent_id.regression.rows.generalised_forces import measured_forces, state_of

PIECE = 4 * CHUNK
"""Samples that one worker compresses before factors are merged."""

_KEPT = 2**26
"""Bytes of a recording's filtered rows that are kept for the next pass over it: those
of a robot on its feet, 15 s at 30 Hz, are a little fewer.
"""

_ALL_KEPT = 3 * _KEPT  # the same of all recordings at a time

_WORKERS = 2
_FILLING = Lock()  # else workers that need the same rows would all compute them

_LITTLE = 0.05
"""Share of a filtered row's weight that must come from samples that count."""


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
    weights that is on samples that count.
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
        structure = row_structure(model, mixed=self.mixed)
        Y = np.empty((len(structure), len(model.layout), len(self.q)))
        bare = self._replace(weights=None)
        for part, blocks in bare.rows(model, [kept for kept, _ in structure]):
            for row, block, (_, expand) in zip(Y, blocks, structure, strict=True):
                row[:, part] = expand.T @ block[:, :-1].T
        return Y

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
        with _FILLING:
            every = _kept_blocks(model, self, tuple(c.tobytes() for c in kept))
        samples = len(self.kept[run])
        yield slice(0, samples), [np.array(own[run], order="F") for own in every]

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


@kept_with(1, most=6, room=_ALL_KEPT, size=lambda rows: sum(b.nbytes for b in rows))
def _kept_blocks(
    model: TorqueModel, rows: FilteredRows, columns: tuple[bytes, ...]
) -> list[Matrix]:
    """Return all filtered rows of a recording, for one pass after another."""
    return rows.filled(model, [np.frombuffer(c, dtype=np.intp) for c in columns])


def motion_of(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    """Return a recording's rows as a model wants them.

    Where its torque is filtered, the rows are filtered alike, and `RowFilter.step`
    says how many of them are kept.

    Parameters
    ----------
    weights : ndarray, shape (samples, torque joints), optional
        Factors of rows; what has the weight 0 is set to zero before the filter.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing, or the motion of a base that floats; or if
        the recording was changed after its torque had been filtered.
    """
    if recording.torque_filter is None:
        return every_sample(model, recording, weights)
    if weights is None:
        return _filtered_motion(model, recording)
    return _with_filter(model, recording, weights)


@kept_with(1, most=8)
def _filtered_motion(model: TorqueModel, recording: Recording) -> Motion:
    """Return the same rows each time: a study takes many passes over few recordings."""
    return _with_filter(model, recording, None)


def _with_filter(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    require_unchanged(recording)
    behind, by = require_filter(recording), row_filter(recording)
    places = places_of_rows(behind, by.step)
    if not len(places):
        places = np.array([len(behind.kept) // 2])
    kept = behind.kept[places]
    along = every_sample(model, behind.source, _marks(behind, weights, model))
    rows = FilteredRows(along, by, kept)
    marks = along.weights
    return Motion(
        along.q[kept],
        along.dq[kept],
        along.ddq[kept],
        torque=rows.through(along.torque),
        weights=_of_rows(weights, places),
        base=None if along.base is None else along.base.samples(kept),
        peaks=along.peaks,
        shares=None if along.shares is None else by.shares(along.shares, kept),
        known=None if marks is None else by.shares(marks, kept),
        places=places,
        filtered=rows,
    )


def _of_rows(weights: Array | None, places: IntArray) -> Array | None:
    """Return weights after the filter: what had none is in rows of zero already."""
    if weights is None or np.isin(weights, (0.0, 1.0)).all():
        return None
    rows: Array = weights[places]
    return np.where(rows == 0.0, 1.0, rows)


def _marks(
    behind: TorqueFilter, weights: Array | None, model: TorqueModel
) -> Array | None:
    """Return 0 where samples before the filter do not count, 1 elsewhere."""
    if behind.left_out is None and (weights is None or weights.all()):
        return None
    marks = np.ones((len(behind.source), len(model.torque_joints)))
    if behind.left_out is not None:
        marks[behind.left_out] = 0.0
    if weights is not None:
        for column, own in zip(marks.T, weights.T, strict=True):
            column[around(behind, own == 0.0)] = 0.0
    return marks


def every_sample(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    """Return the rows of a recording whose torque is as it was recorded."""
    if model.robot.floating:
        tau, base = measured_forces(model, recording), recording.base
    else:
        tau, base = recording.of(model.torque_joints).torque, None
    q, dq, ddq = state_of(model, recording)
    if dq is None or ddq is None or tau is None:
        given = {"velocity": dq, "acceleration": ddq, "torque": tau}
        missing = [name for name, values in given.items() if values is None]
        raise RecordingError(
            f"{recording.name} has no {' and no '.join(missing)}; velocity and "
            "acceleration come from signals.differentiated(recording)"
        )
    unknown = unknown_rows(model, recording)
    if unknown is not None:
        weights = np.where(unknown, 0.0, 1.0 if weights is None else weights)
    motion = Motion(q, dq, ddq, tau, weights, base)
    mixing = mixing_of(model, recording)
    if mixing is None:
        return motion
    if weights is not None and not weights.all():
        left_out = weights == 0.0
        if unknown is None or not np.array_equal(left_out, unknown):
            mixing = replace(mixing, unknown=left_out, held=None).holding()
    return motion._replace(
        torque=mixing.mixed(tau),
        mixing=mixing,
        peaks=abs(tau).max(axis=0),
        shares=mixing.shares,
    )
