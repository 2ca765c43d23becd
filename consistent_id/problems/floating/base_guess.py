"""How the base of a robot moves, found in a log: names, quaternion order, the unit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.problems.floating.hints import BaseHints
from consistent_id.problems.floating.mujoco_arrays import BaseFrame
from consistent_id.recordings.base_words import BaseNames, BaseRole
from consistent_id.recordings.column_patterns import shown
from consistent_id.recordings.quaternion_order import quaternion_order
from consistent_id.recordings.readers.beside_columns import (
    BaseColumns,
    Names,
    columns,
    names_of,
)
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

_ROLES: tuple[BaseRole, ...] = (
    "angular_velocity",
    "acceleration",
    "position",
    "orientation",
)
# m/s^2, median of what a unit on a robot that stands, walks or runs feels.  Without
# gravity it is a few m/s^2 at most, in units of g about one.
_FELT = 5.0, 20.0
_IN_G = 0.5, 2.0


@dataclass(frozen=True, slots=True)
class BaseGuess:
    """Columns of the base, and how they were found."""

    columns: BaseColumns
    notes: tuple[str, ...]


def chosen_names(
    found: Sequence[BaseNames], hints: BaseHints, log: Path, names: Sequence[str]
) -> BaseGuess:
    """Return which columns are of the base, the quaternion's order still open.

    Raises
    ------
    RecordingError
        If there is neither an inertial measurement unit nor a pose; with what to say.
    """
    said: dict[BaseRole, str] = {}
    taken: dict[str, Names | None] = {}
    orders = {_key(each.names): each.order for each in found}
    for role in _ROLES:
        mine = [each for each in found if each.role == role]
        given = getattr(hints, role)
        taken[role] = given if given or not mine else mine[0].names
        if given is None and mine:
            note = f"{role} of the base is taken from {mine[0]}"
            said[role] = note + (f", not from {mine[1]}" if len(mine) > 1 else "")
    unit = taken["angular_velocity"] and taken["acceleration"]
    if not unit and not (taken["position"] and taken["orientation"]):
        raise RecordingError(
            f"{log}: the base floats, but no columns of an inertial measurement unit "
            f"(gyro and accelerometer) nor of a pose are found; the log has "
            f"{shown(names) or 'no list of names'}. Say which: --angular-velocity "
            "gx,gy,gz --acceleration ax,ay,az, or --base-position x,y,z --orientation "
            "qw,qx,qy,qz; an array has one name. If the base stands still, leave "
            "--base floating out"
        )
    order = hints.order or orders.get(_key(taken["orientation"]))
    found_columns = BaseColumns(
        taken["angular_velocity"] if unit else None,
        taken["acceleration"] if unit else None,
        None if unit else taken["position"],
        taken["orientation"],
        order or "xyzw",
    )
    unused = ("position",) if unit else ("angular_velocity", "acceleration")
    notes = [note for role, note in said.items() if role not in unused]
    if order is not None and hints.order is None:
        notes.append(f"the quaternion is {order}, as its columns are named")
    return BaseGuess(found_columns, tuple(notes))


def _key(names: Names | None) -> tuple[str, ...]:
    return tuple(names_of(names))


def settled(
    guess: BaseGuess,
    arrays: dict[str, NDArray[Any]],
    time: Vector,
    robot: RobotModel,
    hints: BaseHints,
    *,
    frames: Mapping[str, BaseFrame],
    ordered: bool,
    where: str,
) -> BaseGuess:
    """Return the columns with the unit's place and the quaternion's order.

    Parameters
    ----------
    arrays : dict of str to ndarray
        Of the log, by name.
    time : ndarray, shape (samples,)
    frames : mapping of str to BaseFrame
        Sites on the base, beside the frames of `robot`.
    ordered : bool
        Whether the order of the quaternion is known already.

    Raises
    ------
    RecordingError
        If the data do not tell the order, or gravity is missing in what is felt.
    """
    found, notes = guess.columns, list(guess.notes)
    unit: dict[str, Matrix] = {}
    if found.angular_velocity is not None and found.acceleration is not None:
        rotation, place, note = _unit(robot, hints, frames)
        for role in ("angular_velocity", "acceleration"):
            raw = columns(arrays, getattr(found, role), (3,), len(time), where)
            unit[role] = raw @ rotation.T
        _require_gravity(unit["acceleration"], found, where)
        found = replace(found, imu_position=place)
        notes.append(note)
        if abs(rotation - np.eye(3)).max() > 1e-9:
            found = replace(found, imu_orientation=_quaternion(rotation, found.order))
    if found.orientation is None or ordered:
        return BaseGuess(found, tuple(notes))
    turned = columns(arrays, found.orientation, (4,), len(time), where)
    order = quaternion_order(
        time, turned, unit.get("angular_velocity"), unit.get("acceleration")
    )
    if order is None:
        raise RecordingError(
            f"{where}: whether the real part of {shown(names_of(found.orientation))} "
            "stands first or last cannot be told from the data; say --quaternion wxyz "
            "(MuJoCo, Isaac Lab) or xyzw (ROS, Isaac Gym)"
        )
    notes.append(f"the quaternion is {order.order}, {order.reason}")
    mounted = found.imu_orientation
    if mounted is not None and order.order != found.order:
        mounted = (*mounted[3:], *mounted[:3])
    found = replace(found, order=order.order, imu_orientation=mounted)
    return BaseGuess(found, tuple(notes))


def _unit(
    robot: RobotModel, hints: BaseHints, frames: Mapping[str, BaseFrame]
) -> tuple[Matrix, Vector, str]:
    """Return the unit's rotation and place in the base, and what was assumed."""
    own = {robot.link_names[0]: BaseFrame(np.eye(3), np.zeros(3)), **frames}
    for frame in robot.links[0].merged:
        own[frame.name] = BaseFrame(frame.rotation, frame.translation)
    if hints.imu is not None and hints.imu not in own:
        near = did_you_mean(hints.imu, list(own))
        raise RecordingError(f"--imu: no frame {hints.imu!r} on the base; {near}")
    named = (
        [hints.imu] if hints.imu else [name for name in own if "imu" in name.lower()]
    )
    if len(named) == 1:
        at = own[named[0]]
        note = f"the unit is at {named[0]} of the robot's file"
        return at.rotation, at.translation, note
    several = f"; the file has {', '.join(named)}: --imu FRAME" if named else ""
    note = f"the unit is at the base's origin, its axes those of the base{several}"
    return np.eye(3), np.zeros(3), note


def _require_gravity(felt: Matrix, found: BaseColumns, where: str) -> None:
    """Refuse an accelerometer in units of g, or without gravity."""
    median = float(np.median(np.linalg.norm(felt, axis=1)))
    if _FELT[0] <= median <= _FELT[1]:
        return
    seen = f"{where}: {shown(names_of(found.acceleration))} is {median:.3g} in the "
    if _IN_G[0] <= median <= _IN_G[1]:
        raise RecordingError(
            f"{seen}median, as in units of g; multiply it by 9.81 first"
        )
    raise RecordingError(
        f"{seen}median, expected about 9.81 m/s^2 of an accelerometer at "
        "rest. If gravity was taken out, name the raw channel: --acceleration "
        "ax,ay,az; or the pose: --base-position, --orientation"
    )


def _quaternion(rotation: Matrix, order: str) -> tuple[float, ...]:
    """Return the quaternion of a rotation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return (w, x, y, z) if order == "wxyz" else (x, y, z, w)
