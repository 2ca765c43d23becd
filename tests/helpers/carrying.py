"""An arm with a flange as a URDF, and logs of it that a user would have."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin

from consistent_id import InertialParameters
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion

JOINTS = ("j0", "j1", "j2", "j3")
_AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0")
_OFFSETS = ("0 0 0.3", "0.1 0 0.3", "0 0 0.4", "0 0 0.3")
FLANGE = pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), np.array([0.1, 0.0, 0.05]))
"""Place of the flange in the last link."""

LOAD = InertialParameters.from_central(
    3.0,
    [0.05, 0.02, 0.15],
    [[0.03, 0.004, 0], [0.004, 0.04, -0.003], [0, -0.003, 0.02]],
)
"""The load, in the frame of the flange."""


def urdf() -> str:
    """Four turning joints that feel gravity, a flange, and a tool on it."""
    parts = ['<robot name="arm">', '<link name="base"/>']
    for k, (axis, offset) in enumerate(zip(_AXES, _OFFSETS, strict=True)):
        parent = "base" if k == 0 else f"link{k - 1}"
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0.02 0.03 0.15"/>'
            f'<mass value="{5 - k}"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.09" '
            f'iyz="0" izz="0.04"/></inertial></link>'
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="{offset}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="4" effort="200"/></joint>'
        )
    parts.append(
        '<link name="flange"/><joint name="to_flange" type="fixed">'
        '<parent link="link3"/><child link="flange"/>'
        f'<origin xyz="0.1 0 0.05" rpy="0 {np.pi / 2!r} 0"/></joint>'
        '<link name="tcp"/><joint name="to_tcp" type="fixed">'
        '<parent link="flange"/><child link="tcp"/>'
        f'<origin xyz="0 0 0.2" rpy="0 0 {np.pi / 2!r}"/></joint></robot>'
    )
    return "\n".join(parts)


def write_robot(folder: Path) -> Path:
    """Write ``robot.urdf`` and return its path."""
    file = folder / "robot.urdf"
    file.write_text(urdf())
    return file


def write_log(
    file: Path,
    load: InertialParameters | None,
    *,
    noise: float = 0.02,
    seed: int = 0,
    gains: np.ndarray | float = 1.0,
    still: bool = False,
) -> Path:
    """Write a log as CSV: torque over ``gains``, of motion or of many poses at rest.

    Noise is relative to each joint's torque.
    """
    model = pin.buildModelFromXML(urdf())
    if load is not None:
        body = pin.Inertia(load.mass, load.com, load.central_inertia)
        model.appendBodyToJoint(model.njoints - 1, body, FLANGE)
    rng = np.random.default_rng(seed)
    time, q, dq, ddq = _poses(rng) if still else _motion(rng)
    data = model.createData()
    torque = np.array(
        [pin.rnea(model, data, *s).copy() for s in zip(q, dq, ddq, strict=True)]
    )
    torque += 1.2 * dq + 0.8 * np.tanh(dq / 0.02) + 0.1
    torque += rng.normal(size=torque.shape) * noise * np.sqrt(np.mean(torque**2, 0))
    names = ["time", *(f"q_{j}" for j in JOINTS), *(f"dq_{j}" for j in JOINTS)]
    names += [f"tau_{j}" for j in JOINTS]
    table = np.column_stack([time, q, dq, torque / gains])
    np.savetxt(file, table, "%.9g", ",", header=",".join(names), comments="")
    return file


def _motion(rng):
    joints = tuple(
        tuple(Sinusoid(a, a, f, p) for a, f, p in rng.uniform(0.1, 0.5, (5, 3)))
        for _ in JOINTS
    )
    motion = SinusoidalMotion(20.0, 50.0, joints).recording(JOINTS)
    return motion.time, motion.position, motion.velocity, motion.acceleration


def _poses(rng):
    """Return slow moves between twelve poses, two seconds of rest in each."""
    poses, rate = rng.uniform(-1.5, 1.5, (12, len(JOINTS))), 50
    s = np.linspace(0.0, 1.0, 20 * rate)
    blend = 10 * s**3 - 15 * s**4 + 6 * s**5
    parts = [
        part
        for a, b in pairwise(poses)
        for part in (np.tile(a, (2 * rate, 1)), a + np.outer(blend, b - a))
    ]
    q = np.vstack(parts)
    time = np.arange(len(q)) / rate
    dq = np.gradient(q, time, axis=0)
    return time, q, dq, np.gradient(dq, time, axis=0)
