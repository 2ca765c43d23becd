"""The regression of a problem's recordings, however large they are."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np

from consistent_id._support.executors import Executor, tree_reduced
from consistent_id._support.progress import counted, stages
from consistent_id.errors import NotExcitedError, ProblemError, RecordingError
from consistent_id.problems.file import DataTable, PreparationTable, RecordingTable
from consistent_id.problems.log_entries import columns_of, require_rows, rows_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.streaming.kept_rows import KeptRows, KeptWindows, kept_rows
from consistent_id.problems.streaming.obstacle import (
    obstacle,
    reason_for_whole,
    require_room,
)
from consistent_id.problems.streaming.stretches import survey
from consistent_id.problems.streaming.windows import prepared_stretches
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.log_rows import LogRows, RowSource
from consistent_id.recordings.readers.spooled_states import spooled_states
from consistent_id.recordings.recording import Recording, joined_in_time
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.recorded_noise import SHOWN, with_noise
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_filter import RowFilter

_log = logging.getLogger(__name__)


def stream_regression(
    problem: Problem,
    *,
    role: str = "training",
    executor: str | Executor = "serial",
    progress: bool = False,
) -> Regression:
    """Compress the recordings of a problem file window by window.

    The regression is that of ``build_regression(problem.model, problem.training)`` to
    rounding, but memory does not grow with the recordings: a window of each channel is
    held, with as many samples on either side as filters and splines take to forget
    where they began.  A first pass reads the times alone; speeds, if the file asks for
    ``trim_standstill`` or ``least_speed``, take another one.

    Bags are decoded once, into a temporary file of about the same size.

    A log that cannot be read piece by piece is read as a whole, if it fits into memory,
    one after another, and a warning says why: NPZ and older MATLAB files, tracks,
    gains, bases that float, wrench sensors, ``least_joint_speed``, delays that are
    estimated, the methods ``smoother`` and ``fourier``.

    Parameters
    ----------
    problem : Problem
        With recordings in CSV, Parquet, Feather, HDF5, MATLAB 7.3 or bags of joint
        states to be streamed.
    role : {"training", "validation"}
    executor : str or Executor
        ``"serial"``, ``"processes"`` or ``"processes:4"``, ``"dask"`` or
        ``"dask:tcp://host:port"``; the result is the same to the last bit on one kind
        of processor.
    progress : bool
        Say on the standard error how far it is.

    Returns
    -------
    Regression
        It can be saved (`save_regression`), merged, weighted and estimated from.

    Raises
    ------
    ProblemError
        If the file asks for what takes all recordings together: gains or a
        ``least_joint_speed`` that are estimated.
    RecordingError
        If a log cannot be read, or its clock has gaps; if it has to be read as a whole,
        and does not fit into memory.
    NotExcitedError
        If there is nothing to learn from.

    See Also
    --------
    save_regression, build_regression
    """
    executor = Executor.named(executor)
    with TemporaryDirectory(prefix="consistent-id-", dir=executor.place) as folder:
        spool = Path(folder)
        return _streamed(problem, role, executor, spool, progress)


def _streamed(
    problem: Problem, role: str, executor: Executor, spool: Path, progress: bool
) -> Regression:
    """Compress what is streamed; bags are decoded into a folder."""
    with stages(1, progress) as begin:
        begin(f"looking through the {role} logs of {problem.name}")
        parts = list(_parts(problem, role, executor, spool))
    tasks = [(problem.model, task) for part in parts for task in part.tasks]
    seen: list[Compressed] = []  # without regressions
    with counted(len(tasks), "parts of the logs", progress) as count:

        def regressions() -> Iterator[Regression]:
            for found in executor.map(compressed, tasks):
                seen.append(replace(found, regression=None))
                count(len(seen))
                if found.regression is not None:
                    yield found.regression

        whole = tree_reduced(regressions(), Regression.__add__)
    if whole is None:
        raise NotExcitedError(f"problem {problem.name!r}: no sample counts")
    middles, samples, left = list[Recording](), list[int](), iter(seen)
    for part in parts:
        own = list(islice(left, len(part.tasks)))
        counts = [count for one in own for count in one.counts]
        if isinstance(part, WholeLog):
            middles += [middle for one in own for middle in one.middles]
            samples += counts
        elif any(counts):
            middles.append(_middle(part, counts))
            samples.append(sum(counts))
    motions = [motion_of(problem.model, middle, None) for middle in middles]
    every = [range(len(middle)) for middle in middles]
    return with_noise(problem.model, whole, motions, every, RowFilter(), samples)


@dataclass(frozen=True, eq=False)
class Compressed:
    """The regression of some windows, if any sample counts, and each one's samples.

    Parameters
    ----------
    regression : Regression, optional
    counts : tuple of int
        Of each window; of a log that was read as a whole, of each of its recordings.
    middles : tuple of Recording
        Of the latter, see `with_noise_of`.
    """

    regression: Regression | None
    counts: tuple[int, ...]
    middles: tuple[Recording, ...] = ()


@dataclass(frozen=True, eq=False)
class WholeLog:
    """A log that is read as a whole: the problem with this one alone."""

    problem: Problem
    role: str

    @property
    def tasks(self) -> list["WholeLog"]:
        """The log itself."""
        return [self]


def compressed(task: tuple[TorqueModel, KeptWindows | WholeLog]) -> Compressed:
    """Compress some windows, one at a time; or a log as a whole."""
    model, windows = task
    if isinstance(windows, WholeLog):
        return _compressed_whole(model, windows)
    counts: list[int] = []

    def regressions() -> Iterator[Regression]:
        for part, counts_in in windows.recordings():
            counts.append(int(counts_in.sum()))
            if counts[-1]:
                weights = np.repeat(counts_in[:, None], len(model.torque_joints), 1)
                rows = None if counts_in.all() else [weights.astype(np.float64)]
                yield build_regression(model, part, row_weights=rows, noise=False)

    return Compressed(tree_reduced(regressions(), Regression.__add__), tuple(counts))


def _compressed_whole(model: TorqueModel, log: WholeLog) -> Compressed:
    problem = log.problem
    parts = problem.training if log.role == "training" else problem.validation
    middles = []
    for part in parts:
        start = max((len(part) - SHOWN) // 2, 0)
        middles.append(part.samples(slice(start, start + SHOWN)))
    regression = build_regression(model, parts, noise=False)
    return Compressed(regression, tuple(map(len, parts)), tuple(middles))


@dataclass(frozen=True, eq=False)
class _Source:
    """A log, what its entry says of it, and how it is prepared."""

    log: RowSource
    entry: RecordingTable
    table: PreparationTable


def _parts(
    problem: Problem, role: str, executor: Executor, spool: Path
) -> Iterator[KeptRows | WholeLog]:
    """Yield the parts of the logs of a role: what counts, or logs as a whole."""
    data = problem.table.data
    reason = obstacle(problem)
    if reason or data is None:
        raise ProblemError(f"the recordings cannot be streamed: {reason}")
    for number, entry in enumerate(data.recordings):
        if entry.role != role:
            continue
        reason = reason_for_whole(problem, entry)
        if reason:
            require_room(problem, entry, reason)
            _log.warning("%s: read as a whole: %s", entry.file, reason)
            alone = msgspec.structs.replace(data, recordings=(entry,))
            table = msgspec.structs.replace(problem.table, data=alone)
            yield WholeLog(replace(problem, table=table), role)
        else:
            log = _rows_of(problem, data, entry, spool / f"{number}.rows")
            yield from _kept(_Source(log, entry, data.preparation), executor)


def _rows_of(
    problem: Problem, data: DataTable, entry: RecordingTable, spool: Path
) -> RowSource:
    """Return what rows of a log are read from; bags are decoded into a file."""
    path, joints = problem.log_file(entry.file), problem.model.robot.joint_names
    columns, gain = columns_of(data, path), data.torque_gain
    if log_format(path).holds == "joint states":
        return spooled_states(
            path, joints, columns, spool, torque_gain=gain, topic=data.topic
        )
    return LogRows(path, joints, columns, gain, tuple(entry.omit))


def _kept(source: _Source, executor: Executor) -> Iterator[KeptRows]:
    """Yield what counts of a log, stretch by stretch."""
    log, entry, table = source.log, source.entry, source.table
    ends = rows_of(entry)
    seen = survey(log, table, () if ends is None else ends)
    require_rows(log.path.name, entry, seen.rows)
    stretches = seen.stretches
    if ends is not None:
        stretches = tuple(s for s in stretches if s.rows_between(*ends) >= 2)
        if not stretches:
            raise RecordingError(
                f"{log.path.name}: rows {ends[0] + 1} to {ends[1] + 1} lie in gaps of "
                "the log, or in parts that are too short"
            )
    for whole in prepared_stretches(log, stretches, table):
        first, last = whole.lead, whole.stretch.samples
        if ends is not None:
            begin, end = ((row, seen.times[row]) for row in ends)
            first = max(first, whole.stretch.sample_at(*begin, after=False))
            last = whole.stretch.sample_at(*end, after=True)
        yield kept_rows(whole, first, last, executor)


def _middle(rows: KeptRows, counts: Sequence[int]) -> Recording:
    """Return the samples in the middle, by which correlated noise is known.

    Parameters
    ----------
    counts : sequence of int
        Samples that count in each window.
    """
    ends = np.cumsum(counts)
    shown = min(int(ends[-1]), SHOWN)
    start = (int(ends[-1]) - shown) // 2
    first = int(np.searchsorted(ends, start, side="right"))
    last = int(np.searchsorted(ends, start + shown))
    windows = KeptWindows(rows, tuple(rows.cuts[first : last + 1]))
    parts, counted = zip(*windows.recordings(), strict=True)
    places = np.flatnonzero(np.concatenate(counted))
    start -= int(ends[first]) - counts[first]
    return joined_in_time(parts).samples(places[start : start + shown])
