"""Quadrupeds of example-robot-data on soft feet, simulated by MuJoCo alone.

Nothing here is of consistent_id: a robot's URDF becomes an MJCF file with armatures,
dry friction and an inertial unit; a box that the file does not know is on its trunk; a
controller holds each torque for one step.  A log can state the torque in three ways:

- ``right``: its mean over a step around the stamp, as a sensor that is read on time;
- ``held``: the torque that is held from the stamp on, half a step early;
- ``ahead``: the mean of that and the next one, a whole step early.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from sysconfig import get_paths
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

RATE, SUBSTEPS, SETTLE = 500, 16, 1.0  # Hz of the controller and log; s before the log
ENCODER, TORQUE, GYRO, ACCELEROMETER, TURN = 2e-5, 0.05, 0.002, 0.02, 2e-4  # noise, SI
STAMPS: Mapping[str, float] = {"right": 0.0, "held": -0.5 / RATE, "ahead": -1.0 / RATE}
"""By how much the torque of a log is late, s."""

_FREQUENCIES = (0.6, 1.7, 3.8)  # Hz, of the trunk's sway
_DUMMY = 1e-3  # kg: below, a body of the file stands for none
_FOLDER = Path(get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data/robots"


@dataclass(frozen=True, slots=True)
class Quadruped:
    """A robot's file, its legs and motors, and how far its trunk sways.

    `posture` are angles of hip, thigh and knee of each leg; `gains` those of the
    controller; `motor` are armature, damping and dry friction of each joint.
    """

    file: str
    trunk: str
    feet: tuple[str, ...]
    posture: tuple[tuple[float, float, float], ...]
    gains: tuple[float, float]
    motor: tuple[float, float, float]
    box: tuple[float, tuple[float, float, float], tuple[float, float, float]]
    places: tuple[float, ...] = (0.012, 0.005, 0.0008)  # m, by frequency
    turns: tuple[float, ...] = (0.08, 0.04, 0.012)  # rad


ROBOTS = {
    "a1": Quadruped(
        "a1_description/urdf/a1.urdf",
        "trunk",
        ("FR_foot", "FL_foot", "RR_foot", "RL_foot"),
        ((0.0, 0.8, -1.6),) * 4,
        (180.0, 4.0),
        (0.012, 0.1, 0.2),
        (1.5, (0.04, -0.02, 0.08), (0.01, 0.018, 0.022)),
    ),
    "anymal": Quadruped(
        "anymal_b_simple_description/robots/anymal.urdf",
        "base",
        ("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"),
        (
            (-0.05, 0.7, -1.2),
            (0.05, 0.7, -1.2),
            (-0.05, -0.7, 1.2),
            (0.05, -0.7, 1.2),
        ),
        (900.0, 20.0),
        (0.06, 0.4, 0.6),
        (4.0, (-0.1, 0.04, 0.12), (0.05, 0.09, 0.11)),
        places=(0.018, 0.007, 0.001),
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class StampedLogs:
    """One motion, its torque stamped in three ways, and the true trunk.

    `true` are mass, its product with the centre of mass, and the moments of inertia
    about the trunk's origin: ``m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz``.
    """

    names: tuple[str, ...]
    rows: Mapping[str, np.ndarray]
    true: np.ndarray

    def write(self, path: Path, stamp: str) -> Path:
        """Write the log with one kind of stamps as CSV."""
        header = ",".join(self.names)
        np.savetxt(path, self.rows[stamp], "%.9g", ",", header=header, comments="")
        return path


def nominal_file(robot: Quadruped, folder: Path) -> Path:
    """Write the robot's MJCF, without its box."""
    path = folder / "robot.xml"
    spec = _spec(robot)
    spec.compile()
    path.write_text(spec.to_xml())
    return path


def stamped_logs(robot: Quadruped, seed: int, seconds: float = 21.0) -> StampedLogs:
    """Simulate a robot that sways on its feet."""
    spec = _spec(robot)
    mass, place, moments = robot.box
    body = spec.body(robot.trunk).add_body(name="box", pos=place, mass=mass)
    body.ipos, body.inertia, body.explicitinertial = [0, 0, 0], moments, True
    size = [5.0, 5.0, 0.1]
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=size)
    spec.option.timestep = 1.0 / RATE / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    model.geom_friction[:, 0] = 0.9
    model.geom_solref[:] = [0.006, 1.0]  # rubber: a mm or less under the weight
    rng = np.random.default_rng(seed)
    steps = int((seconds + SETTLE) * RATE) + 2
    wanted = _joints(robot, model, _sway(robot, rng, steps))
    seen, torque = _run(robot, model, wanted)
    return _logs(robot, model, seen, torque, rng)


def _spec(robot: Quadruped) -> Any:
    tree = ET.parse(_FOLDER / robot.file)
    for link in tree.getroot().iter("link"):
        body = link.find("inertial")
        if body is not None and float(body.find("mass").get("value")) < _DUMMY:
            link.remove(body)
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            foot = link.get("name") in robot.feet and shape.tag == "collision"
            if not foot or shape.find("geometry/sphere") is None:
                link.remove(shape)
    keep = {"fusestatic": "false", "discardvisual": "false"}
    ET.SubElement(ET.SubElement(tree.getroot(), "mujoco"), "compiler", keep)
    spec = mujoco.MjSpec.from_string(ET.tostring(tree.getroot(), encoding="unicode"))
    root, *_ = spec.worldbody.bodies
    root.add_freejoint()
    spec.body(robot.trunk).add_site(name="imu", pos=[-0.02, 0.01, 0.03])
    armature, damping, friction = robot.motor
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            continue
        joint.armature, joint.frictionloss = armature, friction
        joint.damping = [damping, 0, 0]
        motor = spec.add_actuator(name=joint.name, target=joint.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    for name, kind in (
        ("gyro", mujoco.mjtSensor.mjSENS_GYRO),
        ("acc", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
    ):
        sensor = spec.add_sensor(name=name, type=kind, objname="imu")
        sensor.objtype = mujoco.mjtObj.mjOBJ_SITE
    return spec


def _sway(robot: Quadruped, rng: np.random.Generator, steps: int) -> np.ndarray:
    """Return places, m, and turns, rad, of the trunk, shape (steps, 6)."""
    t = np.arange(steps)[:, None] / RATE
    found = np.zeros((steps, 6))
    for f, place, turn in zip(_FREQUENCIES, robot.places, robot.turns, strict=True):
        own = f * rng.uniform(0.8, 1.2, 6)
        waves = np.sin(2 * np.pi * (own * t + rng.uniform(0, 1, 6)))
        found += np.repeat([place, turn], 3) * waves
    return np.minimum(t, 1.0) * found


def _joints(robot: Quadruped, model: Any, sway: np.ndarray) -> np.ndarray:
    """Return joint positions that keep the feet in place, by Gauss-Newton steps."""
    data = mujoco.MjData(model)
    data.qpos[7:] = np.ravel(robot.posture)
    mujoco.mj_kinematics(model, data)
    feet = [_ball(model, name) for name in robot.feet]
    start = np.array([data.geom_xpos[ball] for ball in feet])
    J, found = np.zeros((3, model.nv)), []
    for k, x in enumerate(sway):
        data.qpos[:3] = x[:3]
        angle = np.linalg.norm(x[3:])
        axis = x[3:] / max(angle, 1e-12)
        mujoco.mju_axisAngle2Quat(data.qpos[3:7], axis, angle)
        for _ in range(20 if k == 0 else 3):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for leg, (ball, place) in enumerate(zip(feet, start, strict=True)):
                at, body = data.geom_xpos[ball], model.geom_bodyid[ball]
                mujoco.mj_jac(model, data, J, None, at, body)
                own = slice(3 * leg, 3 * leg + 3)
                step = np.linalg.solve(J[:, 6:][:, own], place - at)
                data.qpos[7:][own] += step
        found.append(data.qpos[7:].copy())
    return np.array(found)


def _ball(model: Any, foot: str) -> int:
    return int(model.body(foot).geomadr[0])


def _run(
    robot: Quadruped, model: Any, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what sensors read at each step, and the torque held from it on."""
    data = mujoco.MjData(model)
    data.qpos[7:] = wanted[0]
    mujoco.mj_kinematics(model, data)
    balls = [_ball(model, name) for name in robot.feet]
    lowest = min(data.geom_xpos[b][2] - model.geom_size[b][0] for b in balls)
    data.qpos[2] -= lowest
    rates = np.gradient(wanted, 1.0 / RATE, axis=0)
    (kp, kd), seen, torque = robot.gains, [], []
    for k in range(len(wanted) - 1):
        mujoco.mj_forward(model, data)
        before = data.sensordata.copy()
        error = wanted[k] - data.qpos[7:]
        data.ctrl[:] = kp * error + kd * (rates[k] - data.qvel[6:])
        mujoco.mj_forward(model, data)
        unit = (before + data.sensordata) / 2  # an accelerometer smooths the jump
        seen.append(np.concatenate([data.qpos[7:], unit, data.qpos[3:7]]))
        torque.append(data.ctrl.copy())
        mujoco.mj_step(model, data, SUBSTEPS)
    heights = [data.geom_xpos[b][2] - model.geom_size[b][0] for b in balls]
    if max(map(abs, heights)) > 0.01:
        raise RuntimeError(f"{robot.file} does not stand on its feet: {heights} m")
    return np.array(seen), np.array(torque)


def _logs(
    robot: Quadruped,
    model: Any,
    seen: np.ndarray,
    torque: np.ndarray,
    rng: np.random.Generator,
) -> StampedLogs:
    n = model.nu
    kept = slice(int(SETTLE * RATE), len(seen) - 1)
    q, gyro, acc, turn = np.split(seen[kept], np.cumsum([n, 3, 3]), axis=1)
    levels = (ENCODER, GYRO, ACCELEROMETER, TURN)
    measured = [
        part + level * rng.normal(size=part.shape)
        for part, level in zip((q, gyro, acc, turn), levels, strict=True)
    ]
    noise = TORQUE * rng.normal(size=torque[kept].shape)
    before, now, after = (
        torque[kept.start + k : kept.stop + k] + noise for k in (-1, 0, 1)
    )
    stamped = {"right": (before + now) / 2, "held": now, "ahead": (now + after) / 2}
    joints = [model.joint(j).name for j in range(1, model.njnt)]
    names = (
        "time",
        *(f"q_{j}" for j in joints),
        *(f"imu_{kind}_{c}" for kind in ("gyro", "acc") for c in "xyz"),
        *(f"imu_quat_{c}" for c in "wxyz"),
        *(f"tau_{j}" for j in joints),
    )
    time = np.arange(len(q))[:, None] / RATE
    rows = {k: np.hstack([time, *measured, tau]) for k, tau in stamped.items()}
    return StampedLogs(names, rows, _true_trunk(robot, model))


def _true_trunk(robot: Quadruped, model: Any) -> np.ndarray:
    """Return the ten parameters of the trunk and all that is fixed to it."""
    root = model.body(robot.trunk).rootid[0]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    R, origin = data.xmat[root].reshape(3, 3), data.xpos[root]
    mass, h, moments = 0.0, np.zeros(3), np.zeros((3, 3))
    for body in np.flatnonzero(model.body_weldid == model.body_weldid[root]):
        m, c = model.body_mass[body], R.T @ (data.xipos[body] - origin)
        turned = R.T @ data.ximat[body].reshape(3, 3)
        mass, h = mass + m, h + m * c
        moments += turned @ np.diag(model.body_inertia[body]) @ turned.T
        moments += m * (c @ c * np.eye(3) - np.outer(c, c))
    xx, xy, yy, xz, yz, zz = moments[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.array([mass, *h, xx, xy, yy, xz, yz, zz])
