"""Parameters of a servo that logs can show, and where they are searched.

If the duty is logged, it shows the firmware's gain and deadband directly.

Torque at full duty and the inertia of rotor and gears are scales.  With a geared servo
and a light link they may be many times those of the link alone, so they are searched by
their logarithms, as is the Stribeck velocity, and viscous and Coulomb friction, which
may be zero, by their roots.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.errors import NotExcitedError, RecordingError
from consistent_id.robot.model import RobotModel
from consistent_id.rollout.servo_log import ServoLog
from consistent_id.rollout.servo_motion import Pieces

UNITS: Mapping[str, str] = {
    "stall": "N m",
    "back_emf": "N m s/rad",
    "viscous": "N m s/rad",
    "armature": "kg m^2",
    "coulomb": "N m",
    "stribeck": "N m",
    "stribeck_velocity": "rad/s",
    "motor_load": "N m/N m",
    "outer_load": "N m/N m",
    "motor_load_stribeck": "N m/N m",
    "outer_load_stribeck": "N m/N m",
    "motor_square": "N m/(N m)^2",
    "outer_square": "N m/(N m)^2",
    "stribeck_power": "1",
    "heat": "1/K",
    "delay": "s",
    "zero": "rad",
}
"""Units of parameters."""

TORQUES = ("stall", "back_emf", "viscous", "armature", "coulomb", "stribeck")
"""Parameters in proportion to the scale of torques, which only known bodies show."""

_LARGEST = {"stall", "viscous", "armature", "coulomb"}  # of them

LATENCY = 1e-3
"""Most time of each of the lags of a firmware that no log shows [s]."""

_SATURATED = 0.98  # of full duty
_ENOUGH = 2000  # samples for the law of a duty
_GOAL_LAGS = np.arange(0.0, 0.0405, 1e-3)  # s
_POSITION_LAGS = np.arange(-6e-3, 6.5e-3, 1e-3)  # s: of readings, beside the duty's
_PER_LAG = 5.0  # 1/s: by which a lag has to explain the duty better
_MOVES = 5e-3  # rad: a joint that covers less in every log does not move
_WARM = 5.0  # K: least difference of temperature from which its effect is fitted
BORDER = 0.02
"""Share of the box: nearer, the search ended at its border."""

_SCALES = ("stall", "armature", "stribeck_velocity")  # searched by their logarithms
_SQUARES = ("viscous", "coulomb")  # by their roots: they may be zero, and large
_MIDDLE = {"zero": 0.5, "heat": 0.5} | dict.fromkeys(_SCALES, 0.5)


@dataclass(frozen=True, slots=True)
class SearchBox:
    """Ranges in which parameters are searched, mapped to a unit cube.

    Parameters
    ----------
    limits : mapping of str to (float, float)
    """

    limits: Mapping[str, tuple[float, float]]

    def start(self, names: Sequence[str]) -> Vector:
        """Return the start of the search in the unit cube."""
        return np.array([_MIDDLE.get(name, 0.25) for name in names])

    def values(self, names: Sequence[str], sets: Matrix) -> dict[str, Vector]:
        """Return parameters of points of the unit cube, shape (sets, parameters)."""
        found = {}
        for name, share in zip(names, sets.T, strict=True):
            low, high = self.limits[name]
            if name in _SCALES:
                found[name] = low * (high / low) ** share
            elif name in _SQUARES:
                found[name] = low + share**2 * (high - low)
            else:
                found[name] = low + share * (high - low)
        return found

    def borders(self, names: Sequence[str], point: Vector) -> tuple[str, ...]:
        """Return the parameters at a border that is not a physical one.

        The least armature is as good as none.
        """
        return tuple(
            name
            for name, share in zip(names, point, strict=True)
            if share > 1.0 - BORDER
            or (share < BORDER and name != "armature" and self.limits[name][0] != 0.0)
        )

    def unknown(self, names: Sequence[str], point: Vector) -> BoolArray:
        """Return which parameters are not known, shape (parameters,).

        They are those at a border, and all of `TORQUES` where `scale_unknown`.
        """
        borders = self.borders(names, point)
        scale = scale_unknown(borders)
        return np.array(
            [
                share < BORDER or name in borders or (scale and name in TORQUES)
                for name, share in zip(names, point, strict=True)
            ]
        )


def scale_unknown(borders: Sequence[str]) -> bool:
    """Return whether the search went to borders along the scale of torques."""
    return not _LARGEST.isdisjoint(borders)


def names_shown(logs: Sequence[ServoLog], joint: int) -> tuple[str, ...]:
    """Return the parameters that logs can show, but for friction's form."""
    names = ["stall", "viscous", "armature", "coulomb", "delay", "zero"]
    if any(log.enabled is not None and not log.enabled[:, joint].all() for log in logs):
        names.insert(1, "back_emf")  # else it is part of viscous friction
    warm = [log.temperature[joint] for log in logs if log.temperature is not None]
    warm = [value for value in warm if np.isfinite(value)]
    if len(warm) > 1 and np.ptp(warm) >= _WARM:
        names.append("heat")
    return tuple(names)


def box_of(logs: Sequence[ServoLog], joint: int, pieces: Pieces) -> SearchBox:
    """Return the ranges of a search, by the size of torque and speed."""
    speeds, carried, duties = [], [], []
    for log in logs:
        change = abs(np.diff(log.position[:, joint])) / np.diff(log.time)
        speeds.append(np.convolve(change, np.ones(9) / 9.0, mode="same"))
        if log.duty is not None:
            duties.append(abs(log.duty[:, joint]))
    for piece, q in enumerate(pieces.measured):
        still = pieces.still[:, piece].mean(axis=0)
        terms = (1.0 + 0.0 * q, np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q))
        carried.append(abs(sum(a * b for a, b in zip(still, terms, strict=True))))
    speed = max(float(np.quantile(np.concatenate(speeds), 0.99)), 0.1)
    inertia = float(pieces.inertia.mean())
    torque = float(np.quantile(np.concatenate(carried), 0.95))
    torque = max(torque, 5.0 * inertia * speed, 1e-4)
    duty = float(np.quantile(np.concatenate(duties), 0.95)) if duties else 0.5
    full = torque / max(duty, 0.02)
    return SearchBox(
        {
            "stall": (0.1 * full, 20.0 * full),
            "back_emf": (0.0, 3.0 * full / speed),
            "viscous": (0.0, 15.0 * full / speed),
            "armature": (0.01 * inertia, 300.0 * inertia),
            "coulomb": (0.0, 1.5 * full),
            "stribeck": (0.0, 0.3 * full),
            "stribeck_velocity": (0.002 * speed, 0.5 * speed),
            "motor_load": (0.0, 0.7),
            "outer_load": (0.0, 0.7),
            "motor_load_stribeck": (0.0, 0.7),
            "outer_load_stribeck": (0.0, 0.7),
            "motor_square": (0.0, 0.3 / full),
            "outer_square": (0.0, 0.3 / full),
            "stribeck_power": (0.5, 3.0),
            "heat": (-0.01, 0.03),
            "delay": (0.0, 0.04),
            "zero": (-0.3, 0.3),
        }
    )


class DutyLaw(NamedTuple):
    """The firmware's law ``duty = gain max(abs(goal - q) - deadband, 0)`` with a sign.

    Parameters
    ----------
    gain : float, [1/rad]
    deadband : float, [rad]
    misfit : float
        Root-mean-square error of the duty.
    """

    gain: float
    deadband: float
    misfit: float


def duty_law(log: ServoLog, joint: int) -> DutyLaw | None:
    """Return the law that a log's duty follows; None if the joint has no duty.

    The firmware has the goal later than the log, and the position is not read together
    with the duty; both lags are fitted with the law, or its gain would be too small.
    Samples without a duty are left out.

    Raises
    ------
    RecordingError
        If the duty does not follow the position error.
    """
    if log.duty is None:
        return None
    duty = log.duty[:, joint]
    if not np.isfinite(duty).any():
        return None
    used = abs(duty) < _SATURATED  # False for NaN
    if log.enabled is not None:
        used &= log.enabled[:, joint] > 0.5
    rows = np.flatnonzero(used)
    rows = rows[:: 1 + len(rows) // _ENOUGH]
    best = None
    if len(rows):
        time, goal = log.time[rows], log.goal[:, joint]
        held = np.searchsorted(log.time, time - _GOAL_LAGS[:, None] + 1e-9, "right")
        moving = _shifted(log.time, goal, time, _GOAL_LAGS)
        goals = np.concatenate([moving, goal[np.maximum(held - 1, 0)]])
        positions = _shifted(log.time, log.position[:, joint], time, _POSITION_LAGS)
        lags = np.add.outer(np.tile(_GOAL_LAGS, 2), 10.0 * abs(_POSITION_LAGS))
        errors = (goals[:, None] - positions[None]).reshape(-1, len(rows))
        best = _best_law(errors, duty[rows], 1.0 + _PER_LAG * lags.ravel())
    level = float(np.sqrt(np.mean(duty[used] ** 2))) if used.any() else 0.0
    if best is None or best.gain <= 0.0 or best.misfit > 0.5 * level:
        raise RecordingError(
            f"{log.name}: the duty of {log.joints[joint]} does not follow goal less "
            "position; check which columns they are (--columns) and their signs"
        )
    return best


def _shifted(time: Vector, values: Vector, at: Vector, lags: Vector) -> Matrix:
    """Return values each lag before some times, shape (lags, times)."""
    return np.array([np.interp(at - lag, time, values) for lag in lags])


def _best_law(errors: Matrix, duty: Vector, worth: Vector) -> DutyLaw | None:
    """Return the law of least misfit; None if no error of any lag moves the duty.

    Parameters
    ----------
    errors : ndarray, shape (lags, samples), [rad]
        Goal less position, as the firmware may have had them.
    worth : ndarray, shape (lags,)
        Factors of the misfit in the choice: of a single sinusoid, two lags together
        explain the duty with any gain, and the smallest are right.
    """
    best: DutyLaw | None = None
    for deadband in (0.0, *np.geomspace(1e-3, 0.1, 12).tolist()):
        beyond = np.sign(errors) * np.maximum(abs(errors) - deadband, 0.0)
        sizes = (beyond**2).sum(axis=1)
        if not (sizes > 0.0).all():
            break
        gains = beyond @ duty / sizes
        misfits = np.sqrt(np.mean((gains[:, None] * beyond - duty) ** 2, axis=1))
        least = int((worth * misfits).argmin())
        # A deadband is named only if it explains the duty clearly better.
        if best is None or misfits[least] < 0.8 * best.misfit:
            best = DutyLaw(float(gains[least]), deadband, float(misfits[least]))
    return best


def not_moved(robot: RobotModel, logs: Sequence[ServoLog]) -> dict[str, float]:
    """Return joints that do not move, and their median positions [rad]."""
    ranges = np.max([np.ptp(log.position, axis=0) for log in logs], axis=0)
    middle = np.median(np.concatenate([log.position for log in logs]), axis=0)
    found = {
        name: float(at)
        for name, covered, at in zip(robot.joint_names, ranges, middle, strict=True)
        if covered < _MOVES
    }
    if len(found) == len(robot):
        raise NotExcitedError(
            f"joint {', '.join(found)} of {robot.name} moves by less than "
            f"{1e3 * _MOVES:g} mrad in every training log, so its servo cannot be "
            "identified; record a motion of some tenths of a radian"
        )
    return found
