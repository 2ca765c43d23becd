"""The regression, and the estimate, from recordings of any size.

Each log is compressed window by window, by one process or many, where the problem
allows it; logs that need it are read whole, if they are small enough.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import Executor, single_threaded, tree_reduced
from consistent_id._support.progress import counted, stages
from consistent_id.errors import NotExcitedError, ProblemError, RecordingError
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.judgement import judge
from consistent_id.estimation.method import Method
from consistent_id.estimation.torque_error import TorqueError, stacked_of_kinds
from consistent_id.fleet.log_survey import survey
from consistent_id.fleet.windows import (
    KeptRows,
    KeptWindows,
    kept_rows,
    middle_rows,
    prepared_stretches,
)
from consistent_id.problems.file import DataTable, PreparationTable, RecordingTable
from consistent_id.problems.log_entries import columns_of, require_rows, rows_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.robot_preparation import drift_of
from consistent_id.recordings.log_formats import LOG_FORMATS, log_format
from consistent_id.recordings.readers.bag import spooled_states
from consistent_id.recordings.readers.recording_file import (
    LogRows,
    RowSource,
    does_not_fit,
)
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import base_parameters
from consistent_id.regression.correlated_noise import SHOWN
from consistent_id.regression.motion_arrays import whole_counts
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, build_regression, with_noise
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.regression.row_structure import NoisyRows

_WHOLE_METHODS = ("smoother", "fourier")

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
    in memory, with enough samples on either side for the transients of filters and
    splines.  A first pass reads only the times; speeds, if the file asks for
    ``trim_standstill`` or ``least_speed``, take another one.

    Bags are decoded once, into a temporary file of about the same size.

    A log that cannot be read piece by piece is read as a whole, if it fits into memory,
    one after another, and a warning says why: NPZ and older MATLAB files, tracks,
    gains, bases that float, wrench sensors, ``least_joint_speed``,
    ``most_joint_speed``, delays that are estimated, the methods ``smoother`` and
    ``fourier``.

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
        If the file states settings that need all recordings together: gains or a
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
    counts = np.zeros(len(problem.model.torque_joints), dtype=np.intp)
    with counted(len(tasks), "parts of the logs", progress) as count:

        def regressions() -> Iterator[Regression]:
            for found in executor.map(compressed, tasks):
                seen.append(replace(found, regression=None))
                count(len(seen))
                if found.regression is not None:
                    if found.stood_for is None:
                        counts[:] += found.regression.counts
                    yield found.regression

        whole = tree_reduced(regressions(), Regression.__add__)
    if whole is None:
        raise NotExcitedError(f"problem {problem.name!r}: no sample is used")
    middles, samples, left = list[NoisyRows](), list[int](), iter(seen)
    model = problem.model
    for part in parts:
        own = list(islice(left, len(part.tasks)))
        rows = [count for one in own for count in one.counts]
        if isinstance(part, WholeLog):
            found = (middle for one in own for middle in one.middles)
            middles += [motion_of(model, middle, None) for middle in found]
            samples += rows
        elif any(rows):
            middles.append(middle_rows(model, part, rows))
            samples.append(sum(rows))
            # Windows are rounded together, as the recording is that they are of.
            windows = [one.stood_for for one in own if one.stood_for is not None]
            counts[:] += whole_counts(np.sum(windows, axis=0))
    whole = replace(whole, counts=tuple(counts.tolist()))
    return with_noise(model, whole, middles, samples)


@dataclass(frozen=True, eq=False)
class Compressed:
    """The regression of some windows, if any sample counts, and each one's samples.

    Parameters
    ----------
    regression : Regression, optional
    counts : tuple of int
        Counts of each window; of a log that was read as a whole, of each of its
        recordings.
    middles : tuple of Recording
        Middles of the latter, see `with_noise_of`.
    stood_for : ndarray, shape (joints,), optional
        Samples that the windows' rows stand for, see `Motion.stood_for`.
    """

    regression: Regression | None
    counts: tuple[int, ...]
    middles: tuple[Recording, ...] = ()
    stood_for: Vector | None = None


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
    stood_for = np.zeros(len(model.torque_joints))

    def regressions() -> Iterator[Regression]:
        for part in windows.recordings():
            if part is None:
                counts.append(0)
                continue
            motion = motion_of(model, part, None)
            counts.append(len(motion.q))
            stood_for[:] += motion.stood_for()
            yield build_regression(model, part, noise=False)

    regression = tree_reduced(regressions(), Regression.__add__)
    return Compressed(regression, tuple(counts), stood_for=stood_for)


def _compressed_whole(model: TorqueModel, log: WholeLog) -> Compressed:
    problem = log.problem
    parts = problem.training if log.role == "training" else problem.validation
    middles, counts = [], []
    for part in parts:
        motion = motion_of(model, part, None)
        counts.append(len(motion.q))
        start = max((counts[-1] - SHOWN) // 2, 0)
        rows = slice(start, start + SHOWN)
        places = motion.places
        middles.append(part.samples(rows if places is None else places[rows]))
    regression = build_regression(model, parts, noise=False)
    return Compressed(regression, tuple(counts), tuple(middles))


@dataclass(frozen=True, eq=False)
class _StreamedLog:
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
            yield from _kept(_StreamedLog(log, entry, data.preparation), executor)


def _rows_of(
    problem: Problem, data: DataTable, entry: RecordingTable, spool: Path
) -> RowSource:
    """Return the source of a log's rows; bags are decoded into a file."""
    path, joints = problem.log_file(entry.file), problem.model.robot.joint_names
    columns, gain = columns_of(data, path), data.torque_gain
    if log_format(path).holds == "joint states":
        states = spooled_states(path, joints, columns, spool, topic=data.topic)
        return replace(states, torque_gain=gain)
    return LogRows(path, joints, columns, gain, tuple(entry.omit))


def _kept(source: _StreamedLog, executor: Executor) -> Iterator[KeptRows]:
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


@single_threaded
def stream_estimate(
    problem: Problem, *, executor: str | Executor = "serial", progress: bool = False
) -> Estimate:
    """Estimate all parameters under a problem's constraints, window by window.

    The estimate is the weighted constrained one of the training recordings.  It is
    judged by its own fit and by the validation recordings, which are streamed too.
    Steps that need recordings as a whole are left out: the log is not checked for
    faults, and other methods are not compared.

    Parameters
    ----------
    problem : Problem
        See `stream_regression`.
    executor : str or Executor
        Where windows are compressed.
    progress : bool
        Say on the standard error how far it is.

    Returns
    -------
    Estimate
        With its verdict; the first note has the error on held-out torque.

    Raises
    ------
    ProblemError, RecordingError
        See `stream_regression`.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    model = problem.model
    regression = stream_regression(problem, executor=executor, progress=progress)
    base = base_parameters(model)
    estimate = constrained_least_squares(
        model,
        regression.weighted(joint_noise(model, regression, base=base)),
        constraints=problem.constraints,
        prior=problem.prior,
        base=base,
        method=Method.WEIGHTED_CONSTRAINED,
    )
    data, errors = problem.table.data, []
    if data is not None and any(e.role == "validation" for e in data.recordings):
        unseen = stream_regression(
            problem, role="validation", executor=executor, progress=progress
        )
        errors.append(_error(estimate, unseen))
    evidence = replace(estimate.evidence(), held_out=tuple(errors))
    seen = ", ".join(f"{error.stacked:.2%} (all joints)" for error in errors)
    note = f"error on held-out recordings: {seen or 'unknown, there are none'}"
    notes = (f"{note}; the log itself was not checked for faults", *estimate.notes)
    return replace(estimate, notes=notes, judged=judge(evidence))


def _error(estimate: Estimate, regression: Regression) -> TorqueError:
    """Return the prediction error on what a regression was made of."""
    counts, size = np.array(regression.counts), regression.torque_rms
    rms = regression.residual_rms(estimate.parameters)
    stacked = stacked_of_kinds(estimate.model, counts * rms**2, counts * size**2)
    relative = rms / np.where(size > 0.0, size, np.nan)
    # Friction at rest is not known sample by sample, so it is included in the error.
    return TorqueError("all held-out logs", rms, relative, size, stacked, rms, stacked)


def obstacle(problem: Problem) -> str:
    """Return why recordings cannot be read one after another; empty if they can."""
    data = problem.table.data
    if data is None:
        return f"problem {problem.name!r} has no recordings"
    if data.preparation.least_joint_speed == "estimated":
        return (
            "[data.preparation]: a least_joint_speed that is estimated needs all "
            "recordings at once; give the speed that a part of the log shows "
            "(rest_speed)"
        )
    if data.preparation.contact_radius == "estimated":
        return (
            "[data.preparation]: a contact_radius that is estimated needs all "
            "recordings at once; state the radius of each contact"
        )
    if data.preparation.delays.get("torque") == "estimated":
        return (
            "[data.preparation]: a delay of torque that is estimated needs all "
            "recordings at once; give a number of seconds"
        )
    if drift_of(problem.table) != "none":
        return "[wrist_sensor]: drift needs all recordings at once"
    gains = data.gains
    for key in ("delay", "scale", "encoder_bias", "stiffness"):
        if gains is not None and getattr(gains, key) == "estimated":
            return (
                f"[data.gains]: a {key} that is estimated needs all recordings at "
                f"once; give the value that a part of the log shows (consistent-id "
                "identify of a file with that part)"
            )
    return ""


def reason_for_whole(problem: Problem, entry: RecordingTable) -> str:
    """Return why a log is read as a whole; empty if it is read piece by piece."""
    data = problem.table.data
    if data is not None and data.gains is not None:
        return "[data.gains]: torque is computed from the commands of a whole recording"
    if problem.arm is not None or problem.model.robot.floating:
        return "the motion of a base, or of a wrench sensor, is found from all of it"
    if data is not None and data.wraps == "undo":
        return "[data]: wraps are undone from the first sample on"
    if data is not None and (data.position_scale or data.position_offset):
        return "[data]: positions are scaled or shifted in whole recordings"
    if data is not None and data.coupled:
        return "[data]: joints that are coupled are read from whole recordings"
    if data is not None and data.duplicates != "refuse":
        return "[data]: duplicates are left out of whole recordings"
    if data is not None and data.missing != "refuse":
        return "[data]: rows with missing values are left out of whole recordings"
    if entry.tracks:
        return "tracks are joined with whole recordings"
    path = problem.log_file(entry.file)
    known = log_format(path)
    if known.holds == "joint states":
        if data is not None and columns_of(data, path).beside.names:
            return "topics beside the joint states are read as a whole"
        if entry.omit:
            return "omit counts rows, which messages do not have"
    elif not known.in_pieces(path):
        names = ", ".join(known.name for known in LOG_FORMATS if known.streams)
        return f"piece by piece are read {names} (of version 7.3) and bags"
    return "" if data is None else _of_preparation(data.preparation)


def _of_preparation(table: PreparationTable) -> str:
    where = "[data.preparation]"
    if table.method in _WHOLE_METHODS:
        return (
            f'{where}: method = "{table.method}" needs a whole recording at once; '
            '"butterworth" and "savitzky-golay" do not'
        )
    if table.least_joint_speed is not None:
        return (
            f"{where}: least_joint_speed needs a whole recording at once; "
            "least_speed does not"
        )
    if table.most_joint_speed is not None:
        return f"{where}: most_joint_speed needs a whole recording at once"
    if "estimated" in table.delays.values():
        return f"{where}: a delay is estimated from a whole recording; seconds are not"
    return ""


def require_room(problem: Problem, entry: RecordingTable, reason: str) -> None:
    """Refuse a log that does not fit into memory as a whole.

    Raises
    ------
    RecordingError
        With the reason why it would have to be.
    """
    if lacking := does_not_fit(problem.log_file(entry.file)):
        raise RecordingError(
            f"{lacking}: {reason}. Convert it, or divide it into logs that fit; they "
            "are read one after another"
        )
