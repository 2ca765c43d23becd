"""Arrays of a simulation in MuJoCo: what of ``qpos`` is a joint, what the base."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.recordings.base_words import BaseNames, BaseRole
from consistent_id.robot.loaders.mjcf_assets import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf

_FREE = 7  # places in qpos of a free joint, six in qvel: position and quaternion


class BaseFrame(NamedTuple):
    """Where a frame is on the base."""

    rotation: Matrix
    translation: Vector


@dataclass(frozen=True, slots=True)
class MujocoArrays:
    """What the arrays of a log are.

    Parameters
    ----------
    columns : dict of str to str
        By channel of the joints; empty if the log has no ``qpos``.
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
    """Return what ``qpos``, ``qvel``, ``qfrc_actuator`` and ``sensordata`` hold.

    Parameters
    ----------
    path : Path
        Of the robot; if it is URDF, its joints are taken to stand in qpos in its order.
    joints : sequence of str
        The robot's.
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
        unit = dict(_unit(model))
        if set(unit) == {"angular_velocity", "acceleration"}:
            ((imu, *_), *_) = unit.values()
            base += [BaseNames(role, name) for role, (_, name) in unit.items()]
    return MujocoArrays(found, order, tuple(base), imu)


def base_frames(path: Path) -> dict[str, BaseFrame]:
    """Return the sites on the base of an MJCF file, by name; of a URDF none."""
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


def _unit(model: Any) -> Iterator[tuple[BaseRole, tuple[str, str]]]:
    """Yield gyro and accelerometer on the base: their site, their part of the array."""
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
    """Return how many columns arrays have, of those that have several."""
    return {
        name: int(min(np.shape(values)))
        for name, values in arrays.items()
        if np.ndim(values) == 2 and min(np.shape(values)) > 1
    }
