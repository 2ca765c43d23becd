"""Columns and arrays whose names say nothing, and arrays that are wider than the robot.

Such columns are found by their numbers, as those of a file without a header: a block
of one column for each joint is a velocity if it is the rate of change of another one,
which is a position.  The user states what is proposed.
"""

import shlex
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_names import (
    DOUBTFUL,
    NumberedColumns,
    doubt,
    name_patterns,
    numbered_columns,
    with_joint,
)
from consistent_id.recordings.column_words import (
    CHANNELS,
    MEASURED,
    channel_of,
    is_torque_command,
    may_be_effort,
    may_be_of_unit,
    says_nothing,
    says_reading,
    words,
)
from consistent_id.recordings.log_formats import has_no_arrays
from consistent_id.recordings.readers.named_arrays import read_parts
from consistent_id.recordings.readers.recording_file import reader_of
from consistent_id.recordings.readers.units import clock_columns, is_time, rate_of
from consistent_id.recordings.readers.used_rows import UsedRows
from consistent_id.recordings.unnamed_columns import (
    ALIKE,
    clock_column,
    column_layout,
    is_clock,
    normalised,
    readable,
)

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

    @property
    def pattern(self) -> str:
        """The name as a pattern."""
        if isinstance(self.name, NumberedColumns):
            return self.name.pattern
        return self.name

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
    flat = has_no_arrays(log, names)
    runs = [r for r in numbered_columns(names) if flat and _may_be_one(r.pattern)]
    of_runs = {n: [r for r in runs if len(r) == n][:_MOST_BLOCKS] for n in numbers}
    wanted = [name for name in names if _may_be_one(name) and not is_time(name)]
    if flat:
        every = (run for several in of_runs.values() for run in several)
        wanted = [run.name(place) for run in every for place in range(len(run))]
    try:
        clock = known.get("time") or clock_column(log, names, in_file=True)
        read = readable(log, [*wanted, *({clock} & {*names})])
        time = _times(log, clock, read)
    except RecordingError:  # another error says it
        return None
    read.pop(clock, None)
    for joints in numbers:
        blocks = list(_of_runs(of_runs[joints], read))
        if not flat:
            blocks = list(_of_arrays(read, joints, len(time), clock))[:_MOST_BLOCKS]
        if found := _channels(time, blocks, joints, known):
            return found
    return None


def _times(log: Path, clock: str, read: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the clock, or the numbers of the samples if a rate stands for it."""
    columns = clock_columns(clock)
    if rate_of(clock) is None and len(columns) == 1:
        if clock not in read:  # a part of an array, or not readable
            read = read_parts(reader_of(log), log, columns, UsedRows())
        return np.asarray(read[clock], dtype=np.float64).reshape(-1)
    return np.arange(
        max((max(np.shape(v), default=0) for v in read.values()), default=0)
    )


def _of_runs(
    runs: Sequence[NumberedColumns], read: Mapping[str, np.ndarray]
) -> Iterator[_Block]:
    """Yield the numbered columns that could be read."""
    for run in runs:
        each = [run.name(place) for place in range(len(run))]
        if read.keys() >= set(each):
            yield _Block(run, np.column_stack([read[name] for name in each]))


def _of_arrays(
    read: Mapping[str, np.ndarray], joints: int, samples: int, clock: str
) -> Iterator[_Block]:
    """Yield arrays with a column for each joint, and such parts of wider ones."""
    for name, values in read.items():
        array = np.squeeze(np.asarray(values))
        if (
            array.ndim != 2
            or samples not in array.shape
            or array.dtype.kind not in "fi"
        ):
            continue
        rows = array if len(array) == samples else array.T
        width = rows.shape[1]
        begins = clock == f"{name}[0:1]" or is_clock(rows[:, 0])
        begin = int(begins and (width - 1) % joints == 0)
        if (width - begin) % joints:
            continue
        for first in range(begin, width, joints):
            part = f"[{first}:{first + joints}]" if width > joints else ""
            yield _Block(f"{name}{part}", rows[:, first : first + joints])


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
    likely = [blocks[(p - 2) // joints] for p in (layout.torque, *layout.others)]
    torques = [block for block in likely if may_be_effort(block.pattern)]
    if not torques:
        return None
    first = {
        "position": blocks[(layout.position - 2) // joints],
        "velocity": blocks[(layout.velocity - 2) // joints],
        "torque": torques[0],
    }
    options = " ".join(
        block.option(channel)
        for channel, block in first.items()
        if channel not in known
    )
    others = [str(block.name) for block in torques[1:]]
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
) -> dict[str, tuple[int, int] | None]:
    """Return the first column and the end of each array's columns that are joints.

    The drives' effort says how many joints there are: all of its columns, or those
    that move, if they are neighbours and no more than the joints; without such, those
    of the motion that move.  Other arrays have as many: those that move, or the same
    columns of an array as wide, or those whose rates of change are the velocity.  None
    if nothing of this says it; without any hint the first.

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
    moving = {channel: _moving(values) for channel, values in arrays.items()}
    efforts = {c: v for c, v in arrays.items() if c not in ("position", "velocity")}
    known = next((c for c in (*efforts, *arrays) if moving[c][1] <= joints), None)
    if known is None:
        alike = len({v.shape[1] for v in arrays.values()}) == 1
        return dict.fromkeys(arrays, (0, joints) if alike else None)
    width = arrays[known].shape[1]
    first, number = moving[known]
    if known in efforts and width <= joints:
        first, number = 0, width
    found: dict[str, tuple[int, int] | None] = {}
    for channel, values in arrays.items():
        start, own = moving[channel]
        if own == number:
            found[channel] = start, start + number
        elif values.shape[1] == number:
            found[channel] = 0, number
        else:
            same = values.shape[1] == width
            found[channel] = (first, first + number) if same else None
    if {"position", "velocity"} <= {*arrays}:
        for open_, other in (("position", "velocity"), ("velocity", "position")):
            if found[open_] is None and (part := found[other]) is not None:
                given = arrays[other][:, slice(*part)]
                found[open_] = _of_rates(arrays[open_], given, open_)
    return found


def _moving(values: Matrix) -> tuple[int, int]:
    """Return the first column that moves, and their number; if apart, of all."""
    moving = np.flatnonzero(np.ptp(values, axis=0))
    if not len(moving) or len(moving) != np.ptp(moving) + 1:
        return 0, values.shape[1]
    return int(moving[0]), len(moving)


def _of_rates(values: Matrix, given: Matrix, channel: str) -> tuple[int, int] | None:
    """Return the columns of positions whose rates are given velocities, or reversed."""
    position, velocity = (values, given) if channel == "position" else (given, values)
    rates, means = np.diff(position, axis=0), velocity[1:] + velocity[:-1]
    alike = normalised(rates).T @ normalised(means)
    alike = alike if channel == "position" else alike.T
    width, joints = alike.shape
    starts = range(width - joints + 1)
    each = [float(np.median(np.diag(alike[start:]))) for start in starts]
    best = int(np.argmax(each)) if each else 0
    return (best, best + joints) if each and each[best] >= ALIKE else None


def moving_part(log: Path, run: NumberedColumns, joints: int) -> tuple[int, int]:
    """Return the first place and the end of numbered columns that are joints.

    Those that move, if they are neighbours and no more than the joints; else the first.

    Raises
    ------
    RecordingError
        If they cannot be read.
    """
    each = [run.name(place) for place in range(len(run))]
    read = reader_of(log).read_arrays(log, each)
    first, number = _moving(np.column_stack([read[name] for name in each]))
    return (first, first + number) if number <= joints else (0, joints)


def of_unit(
    channel: str, names: Sequence[str], joints: Sequence[str]
) -> dict[str, str]:
    """Return columns that only a unit says to be of a channel, and options for them.

    Examples
    --------
    >>> of_unit("torque", ["t", "brake1_Nm", "brake2_Nm"], ["hip", "knee"])
    {'brake{1..2}_Nm': "--torque 'brake{number}_Nm'"}
    """
    return _for_each(partial(may_be_of_unit, channel), channel, names, joints)


def _for_each(
    fits: Callable[[str], bool],
    channel: str,
    names: Sequence[str],
    joints: Sequence[str],
) -> dict[str, str]:
    """Return columns, one for each joint, that fit, and options that read them.

    Without those whose words say that they are of something else.
    """
    runs = [run for run in numbered_columns(names) if len(run) == len(joints)]
    found = {run.pattern: (str(run), run.option(channel)) for run in runs}
    known = frozenset(names)
    of_runs = [{run.name(place) for place in range(len(run))} for run in runs]
    for text in dict.fromkeys(with_joint(name, joints) for name in names):
        each = {text.replace("{joint}", joint) for joint in joints}
        if text not in known and each <= known and each not in of_runs:
            found[text] = text, f"--{channel} {shlex.quote(text)}"
    of_it = (text for text in found if fits(text) and doubt(channel, text) < DOUBTFUL)
    return dict(found[text] for text in of_it)


def unread_velocity(names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return a note on columns in a unit of velocity that may be another speed."""
    return [
        f"{pattern} is not read: only its unit says a velocity, which may be that of "
        f"a motor or a fan; if it is the joints': {option}"
        for pattern, option in of_unit("velocity", names, joints).items()
    ]


def unread_speed(pattern: str) -> str:
    """Return a note on a velocity of something else than the joints."""
    return (
        f"{pattern} is not read: unlike the position's, its name says a speed of "
        "another thing, such as of motors before gears; if it is that of the joints: "
        f"--velocity {shlex.quote(pattern)}"
    )


def unread_array(name: str) -> str:
    """Return a note on an array of velocities that are not one for each joint."""
    return f"{name} is not read as the velocity: it has no column for each joint"


def torque_if(
    names: Sequence[str], joints: tuple[str, ...], *, placed: bool
) -> tuple[str, str] | None:
    """Return columns that are torque under a condition, and the option if it is one.

    Commands of torque; the only columns whose names say nothing, or only a reading,
    such as ``feedback``, beside positions that have a name of their own.

    Parameters
    ----------
    placed : bool
        Whether positions are stated.
    """
    positions = name_patterns("position", names, joints)
    placed = placed or any(not says_reading(p.text) for p in positions)

    def unknown(text: str) -> bool:
        read = placed and words(text) <= MEASURED
        return read or (says_nothing(text) and may_be_effort(text))

    found = list[tuple[str, str]]()
    for what, option in _for_each(is_torque_command, "torque", names, joints).items():
        said = "are commands of torque, not measured: if the drives follow them"
        found.append((f" {what} {said}: {option}", option))
    only = _for_each(unknown, "torque", names, joints)
    for what, option in only.items() if len(only) == 1 else ():
        said = "are as many as the joints: if they are torques or motor currents"
        of = f" Of the columns without a known word, only {what} {said}: {option}"
        found.append((of, option))
    if not found:
        return None
    return "".join(said for said, _ in found), found[0][1] if len(found) == 1 else ""
