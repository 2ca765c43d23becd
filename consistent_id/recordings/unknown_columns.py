"""Columns and arrays whose names say nothing, and arrays that are wider than the robot.

Such columns are found by their numbers, as those of a file without a header: a block
of one column for each joint is a velocity if it is the rate of change of another one,
which is a position.  The user states what is proposed.
"""

import shlex
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_names import NumberedColumns, numbered_columns
from consistent_id.recordings.column_words import CHANNELS, channel_of, says_nothing
from consistent_id.recordings.log_formats import has_no_arrays
from consistent_id.recordings.readers.named_arrays import read_parts
from consistent_id.recordings.readers.recording_file import reader_of
from consistent_id.recordings.readers.units import clock_columns, is_time, rate_of
from consistent_id.recordings.readers.used_rows import UsedRows
from consistent_id.recordings.unnamed_columns import clock_column, column_layout

_MOST_BLOCKS = 40  # that are compared
_FEWEST = 20  # rows


class UnknownColumns(NamedTuple):
    """The channels that columns may be: options, and a sentence with them.

    Parameters
    ----------
    joints : int
        The joints of each block.
    """

    joints: int
    options: str
    sentence: str


class _Block(NamedTuple):
    """Columns or a part of an array, one for each joint."""

    name: str | NumberedColumns
    values: Matrix

    def option(self, channel: str) -> str:
        if isinstance(self.name, NumberedColumns):
            return self.name.option(channel)
        return f"--{channel} {shlex.quote(self.name)}"


def unknown_columns(
    log: Path, names: Sequence[str], numbers: Sequence[int], known: Mapping[str, str]
) -> UnknownColumns | None:
    """Return what the unknown columns of a log may be; None if numbers do not say it.

    Parameters
    ----------
    numbers : sequence of int
        Numbers of joints that the log may have, the likeliest first.
    known : mapping of str to str
        Columns by channel that are stated.
    """
    try:
        time = _times(log, names, known)
        for joints in numbers:
            every = _blocks(log, names, joints, len(time), known.get("time", ""))
            blocks = list(every)[:_MOST_BLOCKS]
            if found := _channels(time, blocks, joints, known):
                return found
    except RecordingError:  # such as empty cells: another error says it
        return None
    return None


def _times(log: Path, names: Sequence[str], known: Mapping[str, str]) -> np.ndarray:
    """Return the clock, or the numbers of the samples if a rate stands for it."""
    clock = known.get("time") or clock_column(log, names, in_file=True)
    columns = clock_columns(clock)
    if rate_of(clock) is None and len(columns) == 1:
        read = read_parts(reader_of(log), log, columns, UsedRows())
        return np.asarray(read[clock], dtype=np.float64).reshape(-1)
    likely = [name for name in names if not is_time(name)]
    read = reader_of(log).read_arrays(log, likely)
    sizes = [max(np.shape(values), default=0) for values in read.values()]
    return np.arange(max(sizes, default=0))


def _blocks(
    log: Path, names: Sequence[str], joints: int, samples: int, clock: str
) -> Iterator[_Block]:
    """Yield columns of a channel, and those without a known word, for each joint."""
    if has_no_arrays(log, names):
        for run in numbered_columns(names):
            if len(run) == joints and _may_be_one(run.pattern):
                each = [run.name(place) for place in range(joints)]
                read = reader_of(log).read_arrays(log, each)
                yield _Block(run, np.column_stack([read[name] for name in each]))
        return
    likely = [name for name in names if _may_be_one(name) and not is_time(name)]
    read = reader_of(log).read_arrays(log, likely)
    for name, values in read.items():
        array = np.squeeze(np.asarray(values))
        if (
            array.ndim != 2
            or samples not in array.shape
            or array.dtype.kind not in "fi"
        ):
            continue
        upright = array if len(array) == samples else array.T
        width, begin = upright.shape[1], int(clock == f"{name}[0:1]")
        if (width - begin) % joints:
            continue
        for first in range(begin, width, joints):
            part = f"[{first}:{first + joints}]" if width > joints else ""
            yield _Block(f"{name}{part}", upright[:, first : first + joints])


def _may_be_one(name: str) -> bool:
    return says_nothing(name) or channel_of(name) in CHANNELS


def _channels(
    time: np.ndarray, blocks: Sequence[_Block], joints: int, known: Mapping[str, str]
) -> UnknownColumns | None:
    """Return the channels of blocks, one after another in a table."""
    blocks = [block for block in blocks if np.isfinite(block.values).all()]
    if len(blocks) < 2 or len(time) < _FEWEST:
        return None
    layout = column_layout(np.column_stack([time, *(b.values for b in blocks)]), joints)
    if layout.position is None or layout.velocity is None or layout.torque is None:
        return None
    first = {
        channel: blocks[(place - 2) // joints]
        for channel in ("position", "velocity", "torque")
        if (place := getattr(layout, channel)) is not None
    }
    options = " ".join(
        block.option(channel)
        for channel, block in first.items()
        if channel not in known
    )
    others = [str(blocks[(place - 2) // joints].name) for place in layout.others]
    more = f"; {', '.join(others)} may be it as well" if others else ""
    position, velocity, torque = (str(block.name) for block in first.values())
    return UnknownColumns(
        joints,
        options,
        f" By their numbers, {velocity} is the rate of change of {position}, and "
        f"{torque} may be the torque{more}: {options}",
    )


def arrays_of_a_group(
    log: Path, names: Sequence[str], numbers: Sequence[int], known: Mapping[str, str]
) -> UnknownColumns | None:
    """Return the arrays of the first group that has a position and a torque.

    Of a file with a group for each run, or with numbers in names of arrays.
    """
    if has_no_arrays(log, names) or {*CHANNELS} & {*known}:
        return None
    groups: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for name in names:
        group, _, last = name.rpartition("/")
        if (channel := channel_of(last)) in CHANNELS:
            groups[group][channel].append(name)
    both = {g: c for g, c in groups.items() if {"position", "torque"} <= {*c}}
    for joints in numbers:
        for channels in both.values():
            every = [name for each in channels.values() for name in each]
            read = reader_of(log).read_arrays(log, every)
            fit = {
                channel: [n for n in each if np.shape(read[n])[1:] == (joints,)]
                for channel, each in channels.items()
            }
            if not (fit["position"] and fit["torque"]):
                continue
            options = " ".join(
                f"--{channel} {shlex.quote(min(fit[channel], key=len))}"
                for channel in CHANNELS
                if fit.get(channel)
            )
            more = f" The first of {len(both)} runs of this file" * (len(both) > 1)
            return UnknownColumns(joints, options, f"{more}: {options}")
    return None


def joints_of_wide(
    arrays: Mapping[str, Matrix], joints: int
) -> dict[str, tuple[int, int]]:
    """Return the first column and the end of each array's columns that are joints.

    Those that move, if they are neighbours and no more than the joints, in the torque
    before the motion, and as many from the end in all; else the first.

    Parameters
    ----------
    arrays : mapping of str to ndarray, shape (samples, width)
        By channel; widths may differ, as of MuJoCo's qpos and qvel.

    Examples
    --------
    >>> rows = np.array([[0.0, 1.0, 2.0, 0.0], [0.0, 2.0, 1.0, 0.0]])
    >>> joints_of_wide({"position": rows, "velocity": rows[:, 1:]}, 3)
    {'position': (1, 3), 'velocity': (0, 2)}
    """
    for _, values in sorted(arrays.items(), reverse=True):  # the torque goes first
        moving = np.flatnonzero(np.ptp(values, axis=0))
        if 0 < len(moving) <= joints and len(moving) == np.ptp(moving) + 1:
            behind = values.shape[1] - int(moving[-1]) - 1
            ends = {c: v.shape[1] - behind for c, v in arrays.items()}
            return {c: (end - len(moving), end) for c, end in ends.items()}
    return dict.fromkeys(arrays, (0, joints))


def joints_of_runs(
    log: Path, runs: Mapping[str, NumberedColumns], joints: int
) -> tuple[str, int]:
    """Return options for the columns of runs that are joints, and their number.

    Parameters
    ----------
    runs : mapping of str to NumberedColumns
        By channel, the position first; all of more columns than the joints.
    """
    position = runs["position"]
    each = [position.name(place) for place in range(len(position))]
    read = reader_of(log).read_arrays(log, each)
    table = np.column_stack([read[name] for name in each])
    first, end = joints_of_wide({"position": table}, joints)["position"]
    options = []
    for channel, run in runs.items():
        if len(run) == len(position):
            numbers = f"{{{run.number(first)}..{run.number(end - 1)}}}"
            pattern = shlex.quote(f"{run.before}{numbers}{run.after}")
            options.append(f"--{channel} {pattern}")
    return " ".join(options), end - first
