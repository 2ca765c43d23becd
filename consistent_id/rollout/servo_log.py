"""Logs of servos: position and goal, perhaps duty, supply voltage and temperature.

A hobby servo measures no torque.  Its firmware drives the motor with a duty cycle that
is proportional to the position error; Dynamixel calls it PWM, Feetech load.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    checked,
    freeze,
    frozen,
)
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.named_arrays import read_parts
from consistent_id.recordings.readers.recording_file import reader_of
from consistent_id.recordings.readers.units import (
    KNOWN,
    standard_unit,
    unit_of_a_name,
)
from consistent_id.recordings.readers.used_rows import UsedRows
from consistent_id.recordings.time_stamps import unit_option
from consistent_id.robot.parameters import require_known
from consistent_id.rollout.servo_columns import ROLES, role_columns

UNITS: Mapping[str, float] = {
    "rad": 1.0,
    "deg": np.pi / 180.0,
    "ticks": 2.0 * np.pi / 4096.0,
}
"""Units of positions, in radians; ticks are those of 12 bits a turn."""

_FULL = (1.0, 100.0, 885.0, 1000.0, 1023.0)  # usual numbers for full duty
_MOST_ANGLE = 4.0 * np.pi  # rad: servos that turn further are seldom logged in rad
_GAP = 5.0  # usual periods without a sample, after which a new piece begins
_LEAST = 20  # samples of a piece
_MIDDLE = 2048.0  # ticks of half a turn
_PERIODS = (0.5e-3, 0.5)  # s: usual periods of a servo's log lie between
_AT_LIMIT = 3  # samples at the largest duty, if it is the limit
_GROWN = 1.1  # of the error that the duty answers: more, and the duty is at its limit


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ServoLog:
    """A piece of a log of servos without gaps, on its own uneven clock.

    Parameters
    ----------
    time : array_like, shape (samples,), [s]
    position, goal : array_like, shape (samples, joints), [rad]
    duty : array_like, shape (samples, joints), optional
        Share of full duty, -1 to 1; NaN where it is not known.
    volts : float, optional, [V]
        Median of the supply.
    temperature : array_like, shape (joints,), optional, [deg C]
        Mean over the piece; NaN for joints without a temperature.
    enabled : array_like of bool, shape (samples, joints), optional
        Whether the motor is driven; by default always.
    """

    name: str
    joints: tuple[str, ...]
    time: Vector
    position: Matrix
    goal: Matrix
    duty: Matrix | None = None
    volts: float | None = None
    temperature: Vector | None = None
    enabled: Matrix | None = None

    def __post_init__(self) -> None:
        time = frozen(self.time, (None,), f"{self.name}: time", RecordingError)
        if len(time) < _LEAST or not (np.diff(time) > 0.0).all():
            raise RecordingError(
                f"{self.name}: {len(time)} samples, expected {_LEAST} or more, at "
                "times that increase"
            )
        freeze(self, time=time - time[0])
        low, high = _PERIODS
        if not low <= self.period <= high:
            option = unit_option(time).replace("--units time=", "--times ")
            raise RecordingError(
                f"{self.name}: the median time between samples is {self.period:.4g} s, "
                f"expected {low:g} to {high:g} s; are the times in milliseconds or "
                "nanoseconds? Convert them to seconds"
                + (f", or {option}" if option else ""),
                options=option,
            )
        if self.volts is not None and not 0.0 < self.volts < np.inf:
            raise RecordingError(
                f"{self.name}: the supply is {self.volts} V, expected a positive "
                "number, or None"
            )
        shape = (len(time), len(self.joints))
        for channel in ("position", "goal", "duty", "enabled"):
            values, finite = getattr(self, channel), channel != "duty"
            if values is not None:
                what = f"{self.name}: {channel}"
                kept = frozen(values, shape, what, RecordingError, finite)
                freeze(self, **{channel: kept})

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))


def supply_of(log: ServoLog, nominal: float | None) -> float:
    """Return a log's supply over the nominal one; 1 if either is not known."""
    return 1.0 if nominal is None or log.volts is None else log.volts / nominal


def with_position(log: ServoLog, joint: int, position: Vector) -> ServoLog:
    """Return a log with other positions of a joint, shape (samples,), [rad]."""
    positions = log.position.copy()
    positions[:, joint] = position
    return replace(log, position=positions)


def encoded(position: Vector, like: Vector, rng: np.random.Generator) -> Vector:
    """Return positions as an encoder reads them, its steps at random places [rad].

    Parameters
    ----------
    like : ndarray, shape (samples,), [rad]
        Readings of the encoder: the least distance between two of them is its step.
    """
    steps = np.diff(np.unique(np.round(like, 9)))
    step = float(steps.min()) if len(steps) else 0.0
    if step <= 0.0:
        return position
    place = rng.uniform()
    return step * (np.round(position / step + place) - place)


def read_servo_logs(
    paths: Iterable[str | Path],
    joints: Sequence[str],
    *,
    columns: Mapping[str, str] | None = None,
    units: str = "rad",
    zero: ArrayLike | None = None,
    times: str | None = None,
    full_duty: float | None = None,
) -> tuple[ServoLog, ...]:
    """Read logs of servos, each in pieces without gaps.

    Parameters
    ----------
    joints : sequence of str
        Joints of the robot.  With several, a column's name has the joint's name, or its
        number from 1; one supply or temperature may be that of all.
    columns : mapping of str to str, optional
        Columns of ``time``, ``position``, ``goal``, ``duty``, ``volts``,
        ``temperature``, ``enabled``; ``{joint}`` stands for a joint's name.  By default
        they are found by their words.
    units : {"rad", "deg", "ticks"}
        Units of positions and goals.
    zero : array_like, shape () or (joints,), optional
        Positions in the log, in its unit, at which the robot's are zero: one, or one
        for each joint.  By default zero; it has to be stated for ticks that are all
        positive, whose zero usually is in the middle, 2048.
    times : str, optional
        Unit of the time, such as ``ms`` or ``100ns``; by default that in the column's
        name, else s.
    full_duty : float, optional
        The number that stands for full duty; by default the largest one if it
        stays while the position error grows, else the next of 1, 100, 885, 1000 and
        1023.

    Raises
    ------
    RecordingError
        If an option has another value, a file cannot be read, or lacks a position or a
        goal.
    """
    return read_servo_sets(
        paths,
        (),
        joints,
        columns=columns,
        units=units,
        zero=zero,
        times=times,
        full_duty=full_duty,
    ).training


class ServoSets(NamedTuple):
    """Logs to learn from, and logs that are simulated only."""

    training: tuple[ServoLog, ...]
    validation: tuple[ServoLog, ...]


def read_servo_sets(
    training: Iterable[str | Path],
    validation: Iterable[str | Path],
    joints: Sequence[str],
    *,
    columns: Mapping[str, str] | None = None,
    units: str = "rad",
    zero: ArrayLike | None = None,
    times: str | None = None,
    full_duty: float | None = None,
) -> ServoSets:
    """Read logs to learn from and logs for validation; see `read_servo_logs`.

    A log is named after its file, with its folder if another file has the same name.
    By default the number for full duty is that of the training logs.

    Raises
    ------
    RecordingError
        As `read_servo_logs`, or if a file is given twice.
    """
    times = _checked_options(joints, columns or {}, units, times, full_duty)
    sets = [[Path(path) for path in paths] for paths in (training, validation)]
    names = _log_names([file for files in sets for file in files])
    raw = [
        [_read(file, joints, columns or {}, times) for file in files] for files in sets
    ]
    for files, given in zip(sets, raw, strict=True):
        for file, arrays in zip(files, given, strict=True):
            offset = _zero(names[file], arrays, units, zero, len(joints))
            for channel in ("position", "goal"):
                arrays[channel] = arrays[channel] - offset
    full = full_duty
    for each in raw:
        full = _full_duty(each) if full is None else full
    scale = 1.0 if full is None else full

    def made(
        files: Sequence[Path], given: Sequence[Mapping[str, Array]]
    ) -> tuple[ServoLog, ...]:
        return tuple(
            log
            for file, arrays in zip(files, given, strict=True)
            for log in _pieces(names[file], arrays, tuple(joints), UNITS[units], scale)
        )

    return ServoSets(made(sets[0], raw[0]), made(sets[1], raw[1]))


def _checked_options(
    joints: Sequence[str],
    columns: Mapping[str, str],
    units: str,
    times: str | None,
    full_duty: float | None,
) -> str | None:
    """Refuse values that options do not have; return the unit of the time."""
    if not joints:
        raise RecordingError("no joint is given: name the joints of the servos")
    require_known([units], UNITS, "units: no unit", RecordingError)
    require_known(columns, ROLES, "columns: no role", RecordingError)
    if full_duty is not None:
        full = checked(full_duty, (), "full_duty", RecordingError)
        if full <= 0.0:
            raise RecordingError(f"full_duty is {full}, expected a positive number")
    return None if times is None else standard_unit("time", times)


def _zero(
    name: str,
    arrays: Mapping[str, Array],
    units: str,
    zero: ArrayLike | None,
    joints: int,
) -> Vector:
    """Return the positions in a log at which the robot's are zero, shape (joints,)."""
    position = arrays["position"]
    if zero is not None:
        given = checked(np.atleast_1d(zero), (None,), "zero", RecordingError)
        if len(given) not in (1, joints):
            raise RecordingError(
                f"zero has {len(given)} numbers, expected one, or one for each of "
                f"{joints} joints"
            )
        return np.broadcast_to(given, joints)
    least, most = float(np.nanmin(position)), float(np.nanmax(position))
    if units == "ticks" and least >= 0.0 and most >= _MIDDLE:
        raise RecordingError(
            f"{name}: ticks are {least:g} to {most:g}, none is negative, and where "
            "the robot's zero is must be known: usually in the middle, "
            f"--zero {_MIDDLE:g}; else --zero 0, or a number for each joint",
            options=f"--zero {_MIDDLE:g}",
        )
    return np.zeros(joints)


def _log_names(files: Sequence[Path]) -> dict[Path, str]:
    """Return a name of each file, and refuse one that is given twice."""
    places = [file.resolve() for file in files]
    for file, place in zip(files, places, strict=True):
        if places.count(place) > 1:
            raise RecordingError(
                f"{file} is given twice; a log is learnt from or validated, once"
            )
    short = [file.name for file in files]
    return {
        file: file.name if short.count(file.name) == 1 else file.as_posix()
        for file in files
    }


def _read(
    file: Path,
    joints: Sequence[str],
    stated: Mapping[str, str],
    times: str | None = None,
) -> dict[str, Array]:
    """Return the roles' arrays, each shape (samples, joints); of time (samples,)."""
    found = role_columns(file, joints, stated)
    wanted = list(dict.fromkeys(name for given in found.values() for name in given))
    rows = UsedRows(missing="omit")  # an empty cell is a value that is not known
    arrays = read_parts(reader_of(file), file, wanted, rows)
    samples = max(arrays[found["time"][0]].shape, default=0)
    vectors = {
        name: _vector(arrays[name], samples, f"{file}: {name}") for name in wanted
    }
    made = {
        role: np.column_stack([vectors[name] for name in given])
        for role, given in found.items()
        if given
    }
    return made | {"time": _in_seconds(found["time"][0], made["time"][:, 0], times)}


def _vector(values: Array, samples: int, where: str) -> Vector:
    """Return one number for each sample; flags are 1 and 0."""
    column = values.reshape(-1) if values.size == samples else values
    return checked(column, (samples,), where, RecordingError, finite=False)


def _in_seconds(name: str, time: Vector, stated: str | None) -> Vector:
    """Return times in seconds, of the stated unit, or of the one in their name."""
    return time * KNOWN["time"][stated or unit_of_a_name("time", name) or "s"]


def _full_duty(raw: Sequence[Mapping[str, Array]]) -> float | None:
    """Return the number for full duty; None without a duty.

    A held load, too, gives the largest duty many times.  It is full duty only where
    the position error grows further and the duty does not.
    """
    with_duty = [arrays for arrays in raw if "duty" in arrays]
    sizes = [abs(arrays["duty"]) for arrays in with_duty]
    most = max((float(size[size >= 0.0].max(initial=0.0)) for size in sizes), default=0)
    if most <= 0.0:
        return None if not sizes else 1.0
    beyond = 0
    for arrays, size in zip(with_duty, sizes, strict=True):
        error = abs(arrays["goal"] - arrays["position"])
        for duty, apart in zip(size.T, error.T, strict=True):
            below = (duty > 0.2 * most) & (duty < 0.95 * most) & (apart > 0.0)
            if below.any():
                answered = most * float(np.median(apart[below] / duty[below]))
                beyond += int(((duty == most) & (apart > _GROWN * answered)).sum())
    if beyond >= _AT_LIMIT:
        return most
    return next((full for full in _FULL if full >= most), most)


def _pieces(
    name: str,
    arrays: Mapping[str, Array],
    joints: tuple[str, ...],
    unit: float,
    full: float,
) -> Iterable[ServoLog]:
    time = arrays["time"]
    good = np.isfinite(time)
    good &= np.isfinite(arrays["position"]).all(axis=1)
    good &= np.isfinite(arrays["goal"]).all(axis=1)
    good[good] = np.diff(np.maximum.accumulate(time[good]), prepend=-np.inf) > 0.0
    rows = np.flatnonzero(good)
    steps = np.diff(time[rows])
    usual = float(np.median(steps)) if len(steps) else 0.0
    parts = np.split(rows, np.flatnonzero(steps > _GAP * usual) + 1)
    kept = [part for part in parts if len(part) >= _LEAST]
    if not kept:
        raise RecordingError(
            f"{name}: {len(rows)} usable samples, expected {_LEAST} or more without a "
            "gap"
        )
    held = _held(arrays["enabled"]) if "enabled" in arrays else None
    for number, part in enumerate(kept, start=1):
        position = unit * arrays["position"][part]
        _require_radians(name, position)
        cut = {
            role: values[part]
            for role, values in arrays.items()
            if np.isfinite(values[part]).any()
        }
        yield ServoLog(
            name=name if len(kept) == 1 else f"{name}, part {number}",
            joints=joints,
            time=cut["time"],
            position=position,
            goal=unit * cut["goal"],
            duty=cut["duty"] / full if "duty" in cut else None,
            volts=float(np.nanmedian(cut["volts"])) if "volts" in cut else None,
            temperature=_means(cut["temperature"]) if "temperature" in cut else None,
            enabled=None if held is None else held[part],
        )


def _require_radians(name: str, position: Matrix) -> None:
    """Refuse positions that cover more than a servo's travel, with their unit."""
    if np.ptp(position) <= _MOST_ANGLE:
        return
    more, options = "", "--angles deg"
    if (position == np.round(position)).all():
        options = "--angles ticks"
        if position.min() >= 0.0:
            options = f"{options} --zero {_MIDDLE:g}"
            more = f" (whole numbers are ticks: {options})"
    raise RecordingError(
        f"{name}: position covers {np.ptp(position):.4g} rad, more than two "
        f"turns; if it is in degrees or ticks say --angles deg or --angles ticks{more}",
        options=options,
    )


def _means(values: Matrix) -> Vector:
    """Return means over known samples, shape (joints,); NaN where none is known."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _held(values: Matrix) -> Matrix | None:
    """Return values, each held until the next is known; None if there are none.

    The first known value is also that of the time before.  A column without any is
    one.
    """
    known = np.isfinite(values)
    if not known.any():
        return None
    values = np.where(known.any(axis=0), values, 1.0)
    rows = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(known, rows, 0), axis=0)
    first = known.argmax(axis=0)
    return np.take_along_axis(values, np.maximum(last, first), axis=0)
