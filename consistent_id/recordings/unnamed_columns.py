"""The clock of a log, and the possible channels of columns without names.

A clock is found by its name; else by its numbers, which rise in steps of about one
length.  Columns that follow each other are a block, one for each joint; a block is a
velocity if it is the rate of change of another, which is a position.  Nothing in
numbers distinguishes a torque from a current or a command: the first other block is
proposed, and the rest are named.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.column_names import shown
from consistent_id.recordings.column_words import channel_of, words
from consistent_id.recordings.own_names import mapping_advice, mapping_option
from consistent_id.recordings.readers.named_arrays import upright
from consistent_id.recordings.readers.recording_file import read_whole, reader_of
from consistent_id.recordings.readers.units import (
    RATE,
    clock_columns,
    is_time,
    named_clocks,
    rate_of,
    split_clock,
)
from consistent_id.recordings.time_stamps import unit_option

_COUNTERS = {"seq", "index", "idx", "frame", "count", "counter", "sample", "samples"}
_COUNTERS |= {"id", "nr", "no", "row", "unnamed", "episode"}  # rise evenly, too
_MOST_READ = 50  # columns that may be a clock
_OF_NAMES = {"joint", "joints", "motor", "actuator", "dof", "name", "names"}
_CLOCKS = {"time", "timestamp", "timestamps", "stamp", "clock", "t", "ts", "zeit"}
_CLOCKS |= {"times", "stamps", "tout"}
_SPANS = _CLOCKS | {"duration", "elapsed", "millis", "ms", "seconds"}
_STEPS = {"dt", "timestep", "step", "ts", "period"}  # of single numbers
_RATES = {"fs", "fps", "rate", "hz", "freq", "frequency"}
_MOSTLY = 0.9  # share of steps that do not go back
_UNEVEN = 20.0  # longest step over the median one, of a clock
_REPEATED = 4  # most rows with one stamp
ALIKE = 0.9  # least correlation of a velocity with the position's rate of change
_COPY = 0.98  # of a command of position with the position
_FEWEST = 20  # rows that correlations need
_SMOOTH = 5  # samples over which a rate of change is taken
_MOST_ROWS = 20_000  # that correlations take, spread over the log
_MOST_BLOCKS = 400  # that are compared with each other


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """The first columns, from 1, of the blocks of a table; None if there is none.

    Parameters
    ----------
    others : tuple of int
        First columns of blocks that may be the torque instead.
    """

    joints: int
    time: int | None
    position: int | None = None
    velocity: int | None = None
    torque: int | None = None
    others: tuple[int, ...] = ()

    def without_clock(self) -> "ColumnLayout":
        """Return the layout of the table without the first column, a clock."""

        def less(first: int | None) -> int | None:
            return None if first is None else first - 1

        places = less(self.position), less(self.velocity), less(self.torque)
        others = tuple(first - 1 for first in self.others)
        return ColumnLayout(self.joints, None, *places, others)

    def block(self, first: int) -> str:
        """Return the pattern of a block."""
        return f"column{{{first}..{first + self.joints - 1}}}"


def without_names(
    log: Path,
    names: Sequence[str],
    joints: Sequence[str],
    known: Mapping[str, str],
    rows: Mapping[int, Sequence[Sequence[str]]] | None = None,
) -> RecordingError:
    """Return an error that proposes what the columns of a headerless file are.

    Parameters
    ----------
    known : mapping of str to str
        Columns by channel that are stated already.
    rows : mapping of int to sequence of sequence of str, optional
        See `guess_columns`: the file may have fewer joints than the robot.
    """
    read = read_whole(log, names)
    table = np.column_stack([read[n] for n in names])
    rate = rate_of(known.get("time", ""))
    layout = _likely_layout(table, len(joints), rate, rows)
    said = (
        f"{log} has no header: its {len(names)} columns are called {names[0]} to "
        f"{names[-1]}"
    )
    if layout.time is None and rate is None:
        return RecordingError(
            f"{said}, and none of them rises like a clock. Add a column of times [s] "
            "and a header, such as time,q1,q2,tau1,tau2; or, if samples are evenly "
            f"spaced, state their rate: --time {RATE} (such as 1000Hz)",
            options=f"--time {RATE}",
        )
    options = layout_options(layout, tuple(known))
    clock = f"the clock is {known.get('time')}"
    if layout.time is not None:
        clock = f"column{layout.time} rises like a clock"
    if not options:
        return RecordingError(
            f"{said}. {clock[0].upper()}{clock[1:]}; the others are not position and "
            f"torque of {shown(joints)}. Name them: --time, --position, --torque, with "
            "a range such as column{2..7}"
        )
    whose = "the joints in the robot's order"
    if layout.joints < len(joints):
        moved = joints[: layout.joints] if rows is None else rows[layout.joints][0]
        rest = [joint for joint in joints if joint not in moved]
        options = f"--lock {shlex.join(rest)} {options}"
        whose = f"{shown(moved)} in the robot's order, the other joints at rest"
    velocity = " (a velocity is the rate of change of its position)"
    others = ", ".join(map(layout.block, layout.others))
    more = f"; {others} may be it as well" if others else ""
    return RecordingError(
        f"{said}. From their numbers{velocity if layout.velocity else ''}, {whose}, "
        f"with the first other block as the torque{more}: {options}",
        options=options,
    )


def _likely_layout(
    table: Matrix,
    joints: int,
    rate: float | None,
    rows: Mapping[int, Sequence[Sequence[str]]] | None,
) -> ColumnLayout:
    """Return the layout of so many joints, or of fewer if only they fit the columns.

    They fit if a velocity is found and blocks fill the table.
    """
    if rate is not None:
        table = np.column_stack([np.arange(len(table)) / rate, table])
    fewer = range(joints - 1, 1, -1) if rows is None else sorted(rows)[::-1]
    found = None
    for number in [joints, *(n for n in fewer if 1 < n < joints)]:
        layout = column_layout(table, number)
        found = found or layout
        first = layout.time or 0
        if layout.velocity and (table.shape[1] - first) % number == 0:
            found = layout
            break
    found = found or column_layout(table, joints)
    return found if rate is None else found.without_clock()


def column_layout(values: Matrix, joints: int) -> ColumnLayout:
    """Return the channels that the columns of a table may be.

    Parameters
    ----------
    values : ndarray, shape (rows, columns)
    joints : int

    Examples
    --------
    >>> t = np.arange(0, 2, 0.01)
    >>> table = np.column_stack([t, np.sin(3 * t), 3 * np.cos(3 * t), np.cos(t) ** 2])
    >>> column_layout(table, 1)
    ColumnLayout(joints=1, time=1, position=2, velocity=3, torque=4, others=())
    """
    time = next((k for k in range(values.shape[1]) if is_clock(values[:, k])), None)
    if time is None or len(values) < _FEWEST:
        return ColumnLayout(joints, None if time is None else time + 1)
    starts = range(time + 1, values.shape[1] - joints + 1, joints)
    moving = [s for s in starts if np.ptp(values[:, s : s + joints], axis=0).any()]
    if not moving:
        return ColumnLayout(joints, time + 1)
    moving = moving[:_MOST_BLOCKS]
    blocks = np.hstack([values[:, s : s + joints] for s in moving])
    every = -(-len(blocks) // _MOST_ROWS)
    rates = _rates(blocks, values[:, time])[::every]
    blocks = blocks[::every]
    motion = _motion(_correlations(rates, blocks, joints))
    alike = _correlations(blocks, blocks, joints)[list(motion)].max(axis=0)
    torques = [
        first + 1
        for k, first in enumerate(moving)
        if k not in motion and alike[k] < _COPY
    ]
    return ColumnLayout(
        joints,
        time + 1,
        moving[motion[0]] + 1,
        moving[motion[1]] + 1 if len(motion) > 1 else None,
        next(iter(torques), None),
        tuple(torques[1:]),
    )


def is_clock(column: Vector) -> bool:
    """Return whether a column rises in steps of about one length; stamps may repeat."""
    steps = np.diff(column)
    rising = steps[steps > 0.0]
    if _REPEATED * len(rising) < len(steps) or not np.isfinite(column).all():
        return False
    if not len(rising) or steps.min() < 0.0:
        return False
    return bool(rising.max() <= _UNEVEN * np.median(rising))


def _first_of_array(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the first column of the only array of many, if it rises like a clock."""
    wide = {n: v for n, v in arrays.items() if np.ndim(v) == 2 and min(v.shape) > 1}
    for name, array in wide.items() if len(wide) == len(arrays) == 1 else ():
        values = upright(array)
        if values.shape[0] > values.shape[1] and values.dtype.kind in "iuf":
            column = values[:, 0].astype(np.float64)
            return f"{name}[0:1]" if is_clock(column) else ""
    return ""


def readable(log: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the columns that can be read; those with empty cells may not matter."""
    if not names:
        return {}
    try:
        return read_whole(log, names)
    except RecordingError:
        half = len(names) // 2
        parts = (names[:half], names[half:]) if half else ()
        return {n: v for part in parts for n, v in readable(log, part).items()}


def _counts(column: Vector) -> bool:
    """Return whether a column counts rows, which says nothing of the time."""
    return bool((np.diff(column) == 1.0).all())


def layout_options(layout: ColumnLayout, known: Sequence[str] = ()) -> str:
    """Return the options that name the columns, filled in; empty if a channel is open.

    Parameters
    ----------
    known : sequence of str
        Channels whose columns are stated already.
    """
    found = {
        "time": None if layout.time is None else f"column{layout.time}",
        **{
            channel: None if first is None else layout.block(first)
            for channel, first in (
                ("position", layout.position),
                ("velocity", layout.velocity),
                ("torque", layout.torque),
            )
        },
    }
    needed = {"time", "position", "torque"} - set(known)
    if any(found[channel] is None for channel in needed):
        return ""
    return " ".join(
        f"--{channel} {shlex.quote(name)}"  # shells expand braces
        for channel, name in found.items()
        if name is not None and channel not in known
    )


def _motion(alike: Matrix) -> tuple[int, ...]:
    """Return the block of the position, and that of the velocity if there is one.

    The pair that fits best; if the first of it is itself the rate of change of a block
    before it, the pair is one of velocity and acceleration.

    Parameters
    ----------
    alike : ndarray, shape (blocks, blocks)
        Correlations of the rate of change of one block with another block.
    """
    alike = np.where(np.eye(len(alike), dtype=bool), -1.0, alike)
    likely = np.flatnonzero(alike > alike.max() - 1e-3)
    position, velocity = divmod(int(likely[0]), len(alike))
    if alike[position, velocity] < ALIKE:
        return (0,)
    while (before := np.flatnonzero(alike[:position, position] >= ALIKE)).size:
        position, velocity = int(before[0]), position
    return position, velocity


def _rates(block: Matrix, time: Vector) -> Matrix:
    """Return rates of change over a few samples, of rows with a step of time."""
    width = min(_SMOOTH, len(time) - 1)
    steps = np.maximum(time[width:] - time[:-width], np.finfo(float).tiny)
    slope = (block[width:] - block[:-width]) / steps[:, None]
    lead = width // 2
    return np.pad(slope, ((lead, width - lead), (0, 0)), mode="edge")


def _correlations(one: Matrix, other: Matrix, joints: int) -> Matrix:
    """Return correlations of blocks, the median over joints that move.

    Returns
    -------
    ndarray, shape (blocks, blocks)
        Correlation of each block of one with each of the other; zero if nothing moves
        in both.
    """
    a, b = normalised(one), normalised(other)
    found = np.stack([a[:, j::joints].T @ b[:, j::joints] for j in range(joints)])
    moves = np.stack(
        [
            np.outer(a[:, j::joints].any(axis=0), b[:, j::joints].any(axis=0))
            for j in range(joints)
        ]
    )
    moves |= ~moves.any(axis=0)
    return np.asarray(np.nanmedian(np.where(moves, found, np.nan), axis=0))


def normalised(columns: Matrix) -> Matrix:
    """Return columns of length one about their means; zero where nothing moves."""
    centred = columns - columns.mean(axis=0)
    scale = np.linalg.norm(centred, axis=0)
    moves = np.isfinite(scale) & (scale > 0.0)
    return np.where(moves, centred, 0.0) / np.where(moves, scale, 1.0)


def array_order(
    log: Path, names: Sequence[str], joints: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the joints of a log's arrays in the order of its array of joints' names.

    As they are, if the log has no such array of text.

    Raises
    ------
    RecordingError
        If it names other joints; with the option that maps them.
    """
    for name, found in _lists_of_names(log, names):
        if len(joints) < 2 or len(found) != len(joints):
            continue
        if set(found) != set(joints):
            raise RecordingError(
                f"{log}: {name} names other joints.{mapping_advice(found, joints)}",
                options=mapping_option(found, joints),
            )
        return found
    return joints


def listed_joints(
    log: Path, names: Sequence[str], joints: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of a log's array of names that has some of the joints."""
    lists = _lists_of_names(log, names) if len(joints) > 1 else ()
    return next((found for _, found in lists if set(found) & set(joints)), ())


def _lists_of_names(
    log: Path, names: Sequence[str]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the arrays of text that may name the joints of a log's arrays."""
    reader = reader_of(log)
    labels = getattr(reader, "labels", None)
    for name in names:
        said = words(name.replace("/", ".").rpartition(".")[2])
        if not {"name", "names"} & said or not said <= _OF_NAMES:
            continue
        if labels is not None:
            found = tuple(labels(log, name))
        else:
            text = np.asarray(reader.read_arrays(log, [name])[name])
            found = tuple(map(str, text.reshape(-1))) if text.dtype.kind == "U" else ()
        if len(set(found)) == len(found) > 0:
            yield name, found


def clock_column(log: Path, names: Sequence[str], *, in_file: bool) -> str:
    """Return the name of the clock; else the only like it whose numbers rise evenly.

    Of several names the shortest whose numbers rise.  Names in minutes, hours or days,
    such as ``t_min``, may be of another thing: they count if no other name does.
    """
    split = split_clock(names)
    found = named_clocks(names)
    if in_file and len(found) > 1:
        found = _rising(log, found) or found
    shortest = min(found, key=len, default="")
    usual = any(map(is_time, found))  # else it may be of another thing
    if usual and (split is None or shortest not in clock_columns(split)):
        return shortest
    if split is not None:
        return split
    clocks = [name for name in names if words(name) & _CLOCKS]
    read = readable(log, clocks if in_file else ())
    columns = {name: np.asarray(values).reshape(-1) for name, values in read.items()}
    rising = [n for n, c in columns.items() if c.dtype.kind in "iuf" and is_clock(c)]
    if len(rising) == 1:
        return rising[0]
    if shortest and not clocks and (not in_file or _rising(log, found)):
        return shortest
    raise _without_clock(log, names, in_file=in_file)


def _rising(log: Path, names: Sequence[str]) -> list[str]:
    """Return the columns that rise; those without numbers, too: they may be dates."""
    read = {name: np.asarray(values) for name, values in readable(log, names).items()}
    return [n for n, c in read.items() if c.dtype.kind not in "iuf" or rises(c)]


def rises(column: np.ndarray) -> bool:
    """Return whether numbers end above their beginning, and most do not go back.

    Gaps, repeated stamps and a few rows in disorder are allowed, unlike by `is_clock`.
    """
    flat = np.asarray(column).reshape(-1)
    if flat.dtype.kind not in "iuf":
        return False
    known = flat[~np.isnan(flat)]
    if len(known) < 2 or known[-1] <= known[0]:
        return False
    return bool((np.diff(known) >= 0.0).mean() > _MOSTLY)


def _without_clock(log: Path, names: Sequence[str], *, in_file: bool) -> RecordingError:
    """Return an error that proposes columns that rise like a clock, or a rate."""
    said = f"{log}: no column is named time, t or timestamp; the log has {shown(names)}"
    clocks = [name for name in names if words(name) & _CLOCKS]
    plain = [n for n in names if not channel_of(n) and not words(n) & _COUNTERS]
    likely = list(dict.fromkeys([*clocks, *plain]))[:_MOST_READ] if in_file else []
    read = readable(log, likely)
    if first := _first_of_array(read):
        options = f"--time {shlex.quote(first)}"
        return RecordingError(
            f"{said}. {first}: numbers that rise evenly. If these are the clock: "
            f"{options}",
            options=options,
        )
    columns = {name: np.asarray(values).reshape(-1) for name, values in read.items()}
    rising = [n for n, c in columns.items() if c.dtype.kind in "iuf" and is_clock(c)]
    counted = [n for n in rising if _counts(columns[n]) and not words(n) & _SPANS]
    rising = [name for name in rising if name not in counted]
    if counted and not rising:
        return RecordingError(
            f"{said}. {counted[0]} counts up by 1 from row to row: rows, or "
            f"milliseconds at 1000 Hz. State the rate of samples: --time {RATE}",
            options=f"--time {RATE}",
        )
    if rising:
        unit = unit_option(columns[rising[0]].astype(np.float64))
        options = f"--time {shlex.quote(rising[0])} {unit}".strip()
        which = f"{rising[0]} is" if len(rising) > 1 else "it is"
        return RecordingError(
            f"{said}. {', '.join(rising)}: numbers that rise evenly. If {which} the "
            f"clock: {options}",
            options=options,
        )
    if rate := _stated_rate(log, names if in_file else ()):
        return RecordingError(f"{said}. {rate}", options=rate.rpartition(": ")[2])
    return RecordingError(
        f"{said}. Name it: --time NAME; or, if it has none and its samples are evenly "
        f"spaced, state their rate: --time {RATE} (such as 1000Hz)",
        options=f"--time {RATE}",
    )


def _stated_rate(log: Path, names: Sequence[str]) -> str:
    """Return a sentence on the only single number that is a step or a rate; or none.

    Simulators write such a number in place of a clock: ``dt``, ``fs``.
    """
    said = {name: words(name.replace("/", ".").rpartition(".")[2]) for name in names}
    likely = [name for name in names if said[name] & (_STEPS | _RATES)]
    read = {n: np.asarray(v) for n, v in readable(log, likely).items()}
    single = {n: float(v.item()) for n, v in read.items() if _is_one_number(v)}
    known = {n: v for n, v in single.items() if np.isfinite(v) and v > 0.0}
    if len(known) != 1:
        return ""
    ((name, value),) = known.items()
    rate, kind = value, "rate of samples in Hz"
    if said[name] & _STEPS:
        rate, kind = 1.0 / value, "step between samples in s"
    return f"If {name}, which is {value:g}, is the {kind}: --time {rate:.9g}Hz"


def _is_one_number(values: np.ndarray) -> bool:
    return values.size == 1 and values.dtype.kind in "iuf"
