"""The regression of a problem's recordings, however large they are."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.executors import Executor, tree_reduced
from consistent_id.errors import NotExcitedError, ProblemError, RecordingError
from consistent_id.problems.file import PreparationTable, RecordingTable
from consistent_id.problems.log_entries import columns_of, require_rows, rows_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.streaming.kept_rows import KeptRows, KeptWindows, kept_rows
from consistent_id.problems.streaming.obstacle import obstacle
from consistent_id.problems.streaming.stretches import survey
from consistent_id.problems.streaming.windows import prepared_stretches
from consistent_id.recordings.readers.log_rows import LogRows
from consistent_id.recordings.recording import Recording, joined_in_time
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.recorded_noise import SHOWN, with_noise
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_filter import RowFilter


def stream_regression(
    problem: Problem,
    *,
    role: str = "training",
    executor: str | Executor = "serial",
) -> Regression:
    """Compress the recordings of a problem file window by window.

    The regression is that of ``build_regression(problem.model, problem.training)`` to
    rounding, but memory does not grow with the recordings: a window of each channel is
    held, with as many samples on either side as filters and splines take to forget
    where they began.  A first pass reads the times alone; speeds, if the file asks for
    ``trim_standstill`` or ``least_speed``, take another one.

    Parameters
    ----------
    problem : Problem
        With recordings in CSV, Parquet, Feather, HDF5 or MATLAB 7.3.
    role : {"training", "validation"}
    executor : str or Executor
        ``"serial"``, ``"processes"`` or ``"processes:4"``, ``"dask"`` or
        ``"dask:tcp://host:port"``; the result is the same to the last bit on one kind
        of processor.

    Returns
    -------
    Regression
        It can be saved (`save_regression`), merged, weighted and estimated from.

    Raises
    ------
    ProblemError
        If the file asks for what takes a whole recording at once: a delay that is
        estimated, tracks, gains, the methods ``smoother`` and ``fourier``, bags.
    RecordingError
        If a log cannot be read, or its clock has gaps.
    NotExcitedError
        If there is nothing to learn from.

    See Also
    --------
    save_regression, build_regression
    """
    executor = Executor.named(executor)
    kept = [
        rows for source in _sources(problem, role) for rows in _kept(source, executor)
    ]
    tasks = [(problem.model, task) for rows in kept for task in rows.tasks]
    counts: list[int] = []  # of each window

    def regressions() -> Iterator[Regression]:
        for found in executor.map(compressed, tasks):
            counts.extend(found.counts)
            if found.regression is not None:
                yield found.regression

    whole = tree_reduced(regressions(), Regression.__add__)
    if whole is None:
        raise NotExcitedError(f"problem {problem.name!r}: no sample counts")
    middles, samples, before = [], [], 0
    for rows in kept:
        own = counts[before : before + len(rows.cuts)]
        before += len(own)
        if any(own):
            middles.append(_middle(rows, own))
            samples.append(sum(own))
    motions = [motion_of(problem.model, middle, None) for middle in middles]
    every = [range(len(middle)) for middle in middles]
    return with_noise(problem.model, whole, motions, every, RowFilter(), samples)


@dataclass(frozen=True, eq=False)
class Compressed:
    """The regression of some windows, if any sample counts, and each one's samples."""

    regression: Regression | None
    counts: tuple[int, ...]


def compressed(task: tuple[TorqueModel, KeptWindows]) -> Compressed:
    """Compress some windows, one at a time."""
    model, windows = task
    counts: list[int] = []

    def regressions() -> Iterator[Regression]:
        for part, counted in windows.recordings():
            counts.append(int(counted.sum()))
            if counts[-1]:
                weights = np.repeat(counted[:, None], len(model.torque_joints), axis=1)
                rows = None if counted.all() else [weights.astype(np.float64)]
                yield build_regression(model, part, row_weights=rows, noise=False)

    return Compressed(tree_reduced(regressions(), Regression.__add__), tuple(counts))


@dataclass(frozen=True, eq=False)
class _Source:
    """A log, what its entry says of it, and how it is prepared."""

    log: LogRows
    entry: RecordingTable
    table: PreparationTable


def _sources(problem: Problem, role: str) -> Iterator[_Source]:
    """Yield the logs of a role."""
    data = problem.table.data
    reason = obstacle(problem, role)
    if reason or data is None:
        raise ProblemError(f"the recordings cannot be streamed: {reason}")
    for entry in data.recordings:
        if entry.role == role:
            path = problem.log_file(entry.file)
            log = LogRows(
                path,
                problem.model.robot.joint_names,
                columns_of(data, path),
                data.torque_gain,
                tuple(entry.omit),
            )
            yield _Source(log, entry, data.preparation)


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
