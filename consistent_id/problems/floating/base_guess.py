"""The motion of a robot's base in a log: names, quaternion order, the IMU.

The model determines the content of arrays of MuJoCo, such as ``qpos``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.problems.statement import Statement
from consistent_id.recordings.column_names import shown
from consistent_id.recordings.readers.beside_columns import (
    BaseColumns,
    Names,
    columns,
    names_of,
)
from consistent_id.recordings.sensor_words import BaseNames, BaseRole
from consistent_id.recordings.signals.base_signals import quaternion_order
from consistent_id.robot.loaders.mjcf_spec import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

_FREE = 7  # places in qpos of a free joint, six in qvel: position and quaternion

_ROLES: tuple[BaseRole, ...] = (
    "angular_velocity",
    "acceleration",
    "position",
    "orientation",
)
_FIELDS = {"position": "base_position"}
"""Fields of a statement whose name is not the role."""

_SAME_PLACE = 1e-6  # m and rad; frames that differ by less are at the same place
# Median acceleration [m/s^2] that an IMU measures on a robot that stands, walks or
# runs.  Without gravity it is a few m/s^2 at most; in units of g it is about one.
_FELT = 5.0, 20.0
_IN_G = 0.5, 2.0


class BaseFrame(NamedTuple):
    """Pose of a frame on the base."""

    rotation: Matrix
    translation: Vector


@dataclass(frozen=True, slots=True)
class MujocoArrays:
    """The content of a log's arrays.

    Parameters
    ----------
    columns : dict of str to str
        Columns by channel of the joints; empty if the log has no ``qpos``.
    array_joints : tuple of str
        Joints of those arrays.
    base : tuple of BaseNames
        Pose, and sensors on the base.
    imu : str, optional
        Site of those sensors.
    """

    columns: Mapping[str, str] = field(default_factory=dict, hash=False)
    array_joints: tuple[str, ...] = ()
    base: tuple[BaseNames, ...] = ()
    imu: str | None = None


def mujoco_arrays(
    path: Path, joints: Sequence[str], widths: Mapping[str, int]
) -> MujocoArrays:
    """Return the content of ``qpos``, ``qvel``, ``qfrc_actuator`` and ``sensordata``.

    Parameters
    ----------
    path : Path
        The robot's file; if it is URDF, qpos is taken to have its joints in its order.
    joints : sequence of str
        Joints of the robot.
    widths : mapping of str to int
        Columns of the log's arrays.
    """
    model = _model(path)
    order = tuple(joints) if model is None else _joints(model)
    n = len(order)
    if widths.get("qpos") != _FREE + n or not set(joints) <= set(order):
        return MujocoArrays()
    found = {"position": f"qpos[{_FREE}:{_FREE + n}]"}
    for channel, name in (("velocity", "qvel"), ("torque", "qfrc_actuator")):
        if widths.get(name) == n + 6:
            found[channel] = f"{name}[6:{6 + n}]"
    base = [
        BaseNames("position", "qpos[0:3]", None),
        BaseNames("orientation", "qpos[3:7]", "wxyz"),
    ]
    imu = None
    if model is not None and widths.get("sensordata") == model.nsensordata:
        unit = dict(_unit_sensors(model))
        if set(unit) == {"angular_velocity", "acceleration"}:
            ((imu, *_), *_) = unit.values()
            base += [BaseNames(role, name) for role, (_, name) in unit.items()]
    return MujocoArrays(found, order, tuple(base), imu)


def base_frames(path: Path) -> dict[str, BaseFrame]:
    """Return the sites on the base of an MJCF file, by name; none for a URDF."""
    model = _model(path)
    if model is None:
        return {}
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = _root(model)
    R, origin = data.xmat[root].reshape(3, 3), data.xpos[root]
    return {
        model.site(site).name: BaseFrame(
            R.T @ data.site_xmat[site].reshape(3, 3),
            R.T @ (data.site_xpos[site] - origin),
        )
        for site in range(model.nsite)
        if _on_base(model, int(model.site_bodyid[site]))
    }


def _model(path: Path) -> Any:
    """Return the compiled model of an MJCF file with a free joint first, or None."""
    if not is_mjcf(path):
        return None
    import mujoco

    model = read_spec(path, mujoco).compile()
    free = mujoco.mjtJoint.mjJNT_FREE
    return model if model.njnt and model.jnt_type[0] == free else None


def _joints(model: Any) -> tuple[str, ...]:
    """Return the joints behind the free one, in the order of qpos."""
    return tuple(model.joint(j).name for j in range(1, model.njnt))


def _root(model: Any) -> int:
    return int(model.jnt_bodyid[0])


def _on_base(model: Any, body: int) -> bool:
    """Return whether a body is the base, or fixed to it."""
    while body > 0 and body != _root(model) and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    return body == _root(model)


def _unit_sensors(model: Any) -> Iterator[tuple[BaseRole, tuple[str, str]]]:
    """Yield gyro and accelerometer of the base, with their sites and array parts."""
    import mujoco

    kinds: dict[int, BaseRole] = {
        int(mujoco.mjtSensor.mjSENS_GYRO): "angular_velocity",
        int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "acceleration",
    }
    for sensor in range(model.nsensor):
        role = kinds.get(int(model.sensor_type[sensor]))
        site = int(model.sensor_objid[sensor])
        if role is not None and _on_base(model, int(model.site_bodyid[site])):
            first = int(model.sensor_adr[sensor])
            yield role, (model.site(site).name, f"sensordata[{first}:{first + 3}]")


def widths_of(arrays: Mapping[str, Any]) -> dict[str, int]:
    """Return the number of columns of each array that has several."""
    return {
        name: int(min(np.shape(values)))
        for name, values in arrays.items()
        if np.ndim(values) == 2 and min(np.shape(values)) > 1
    }


@dataclass(frozen=True, slots=True)
class BaseGuess:
    """Columns of the base, and notes on how they were found."""

    columns: BaseColumns
    notes: tuple[str, ...]


def chosen_names(
    found: Sequence[BaseNames], stated: Statement, log: Path, names: Sequence[str]
) -> BaseGuess:
    """Return the columns of the base; the quaternion's order may still be unknown.

    Raises
    ------
    RecordingError
        If there is neither an inertial measurement unit nor a pose; with the options
        that name one.
    """
    said: dict[BaseRole, str] = {}
    taken: dict[str, Names | None] = {}
    orders = {_key(each.names): each.order for each in found}
    for role in _ROLES:
        mine = [each for each in found if each.role == role]
        given = getattr(stated, _FIELDS.get(role, role))
        taken[role] = given if given or not mine else mine[0].names
        if given is None and mine:
            note = f"{role} of the base is read from {mine[0]}"
            said[role] = note + (f", not from {mine[1]}" if len(mine) > 1 else "")
    unit = taken["angular_velocity"] and taken["acceleration"]
    if not unit and not (taken["position"] and taken["orientation"]):
        raise RecordingError(
            f"{log}: the base floats, but no columns of an inertial measurement unit "
            f"(gyro and accelerometer) nor of a pose are found; the log has "
            f"{shown(names) or 'no list of names'}. Name them: --angular-velocity "
            "gx,gy,gz --acceleration ax,ay,az, or --base-position x,y,z --orientation "
            "qw,qx,qy,qz; an array has one name. If the base stands still, leave "
            "--base floating out"
        )
    order = stated.quaternion or orders.get(_key(taken["orientation"]))
    found_columns = BaseColumns(
        taken["angular_velocity"] if unit else None,
        taken["acceleration"] if unit else None,
        None if unit else taken["position"],
        taken["orientation"],
        order or "xyzw",
    )
    unused = ("position",) if unit else ("angular_velocity", "acceleration")
    notes = [note for role, note in said.items() if role not in unused]
    if order is not None and stated.quaternion is None:
        notes.append(f"the quaternion is {order}, by the names of its columns")
    return BaseGuess(found_columns, tuple(notes))


def _key(names: Names | None) -> tuple[str, ...]:
    return tuple(names_of(names))


@dataclass(frozen=True, slots=True, eq=False)
class BaseSamples:
    """The samples of a log's columns of the base.

    Parameters
    ----------
    arrays : dict of str to ndarray
        Arrays of the log, by name.
    time : ndarray, shape (samples,)
    log : str
        Name of the log, for messages.
    """

    arrays: dict[str, NDArray[Any]]
    time: Vector
    log: str

    def of(self, names: Names, width: int) -> Matrix:
        """Return columns, shape (samples, width)."""
        return columns(self.arrays, names, (width,), len(self.time), self.log)


def completed_guess(
    guess: BaseGuess,
    samples: BaseSamples,
    frames: Mapping[str, BaseFrame],
    imu: str | None,
    *,
    ordered: bool,
) -> BaseGuess:
    """Return the columns with the IMU's place and the quaternion's order.

    Parameters
    ----------
    frames : mapping of str to BaseFrame
        See `frames_on_base`.
    imu : str, optional
        Frame of the inertial measurement unit; by default the one that is named so.
    ordered : bool
        Whether the order of the quaternion is known already.

    Raises
    ------
    RecordingError
        If the data do not show the quaternion's order, or the measured acceleration
        lacks gravity.
    """
    found, notes = guess.columns, list(guess.notes)
    unit: dict[str, Matrix] = {}
    if found.angular_velocity is not None and found.acceleration is not None:
        rotation, place, note = _unit(frames, imu)
        unit["angular_velocity"] = samples.of(found.angular_velocity, 3) @ rotation.T
        unit["acceleration"] = samples.of(found.acceleration, 3) @ rotation.T
        _require_gravity(unit["acceleration"], found, samples.log)
        found = replace(found, imu_position=place)
        notes.append(note)
        if abs(rotation - np.eye(3)).max() > 1e-9:
            found = replace(found, imu_orientation=_quaternion(rotation, found.order))
    if found.orientation is None or ordered:
        return BaseGuess(found, tuple(notes))
    order = quaternion_order(
        samples.time,
        samples.of(found.orientation, 4),
        unit.get("angular_velocity"),
        unit.get("acceleration"),
    )
    if order is None:
        raise RecordingError(
            f"{samples.log}: the data do not show whether the real part of "
            f"{shown(names_of(found.orientation))} is first or last; state "
            f"--quaternion wxyz "
            "(MuJoCo, Isaac Lab) or xyzw (ROS, Isaac Gym)"
        )
    notes.append(f"the quaternion is {order.order}, {order.reason}")
    mounted = found.imu_orientation
    if mounted is not None and order.order != found.order:
        mounted = (*mounted[3:], *mounted[:3])
    found = replace(found, order=order.order, imu_orientation=mounted)
    return BaseGuess(found, tuple(notes))


def frames_on_base(
    robot: RobotModel, sites: Mapping[str, BaseFrame]
) -> dict[str, BaseFrame]:
    """Return the frames of a robot's base, with sites of its file."""
    frames = {robot.link_names[0]: BaseFrame(np.eye(3), np.zeros(3)), **sites}
    for frame in robot.links[0].merged:
        frames[frame.name] = BaseFrame(frame.rotation, frame.translation)
    return frames


def _unit(own: Mapping[str, BaseFrame], imu: str | None) -> tuple[Matrix, Vector, str]:
    """Return the IMU's rotation and place in the base, and a note on assumptions."""
    if imu is not None and imu not in own:
        near = did_you_mean(imu, list(own))
        raise RecordingError(f"--imu: no frame {imu!r} on the base; {near}")
    named = [imu] if imu else [name for name in own if "imu" in name.lower()]
    if not named:
        note = "the unit is at the base's origin, its axes those of the base"
        return np.eye(3), np.zeros(3), note
    at = own[named[0]]
    if not all(_alike(own[name], at) for name in named):
        option = f"--imu {named[0]}"
        raise RecordingError(
            f"the robot's file has several frames of an inertial measurement unit, in "
            f"different places: {', '.join(named)}. State the one whose readings the "
            f"log has, such as {option}",
            options=option,
        )
    return at.rotation, at.translation, f"the unit is at {named[0]} of the robot's file"


def _alike(one: BaseFrame, other: BaseFrame) -> bool:
    pairs = zip(one, other, strict=True)
    return all(np.allclose(a, b, rtol=0.0, atol=_SAME_PLACE) for a, b in pairs)


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
        "rest. If gravity was removed, name the raw channel: --acceleration "
        "ax,ay,az; or the pose: --base-position, --orientation"
    )


def _quaternion(rotation: Matrix, order: str) -> tuple[float, ...]:
    """Return the quaternion of a rotation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return (w, x, y, z) if order == "wxyz" else (x, y, z, w)
