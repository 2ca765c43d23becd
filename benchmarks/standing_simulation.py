"""Logs of robots that MuJoCo simulates on their feet, their trunk swaying.

Contact, friction and noise are there; no force sensor.  Logged are encoders, joint
torques, a gyroscope, an accelerometer and the orientation at the base's origin, and
which feet touch.
"""

from typing import Any, Protocol

import numpy as np
from standing_robots import Foot, StandingRobot, Sway

import consistent_id as ci

RATE, SECONDS, SETTLE = 500, 21, 1  # Hz, s, s before the log begins
PARTS = 16  # steps of the simulation in one of the log
ENCODER, TORQUE, GYRO, ACCELEROMETER = 2e-5, 0.05, 0.002, 0.02  # rad, N m, rad/s, m/s^2
GRIP = 0.9  # of the ground
_NEWTON, _FIRST = 3, 30  # steps for a posture, and for the first


class RobotFellError(Exception):
    """The robot did not stay on its feet."""


class Plan(Protocol):
    """Place and turn of the trunk, and the free joints, at a time."""

    def at(self, t: float, /) -> np.ndarray:
        """Return all of it, shape (6 + joints,)."""


def simulated(
    robot: StandingRobot,
    seed: int = 0,
    seconds: float = SECONDS,
    *,
    dry_friction: bool = True,
    plan: Plan | None = None,
    feedforward: np.ndarray | None = None,
) -> ci.Recording:
    """Log a robot while its trunk sways over its feet, as a plan or by chance.

    Controllers add `feedforward`, shape (samples at `RATE`, joints of the nominal
    robot), to what they make of errors; it begins after `SETTLE` seconds.

    Raises
    ------
    RobotFellError
        If it does not stay on its feet.
    """
    import mujoco

    model = _model(robot, dry_friction=dry_friction)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    plan = _Waves(robot.sway, rng, model.nv) if plan is None else plan
    joints = _planned(robot, model, data, plan, seconds + SETTLE)
    mujoco.mj_resetData(model, data)
    data.qpos[:7] = [0, 0, robot.height, 1, 0, 0, 0]
    data.qpos[7:] = joints[0]
    slopes = np.gradient(joints, 1.0 / RATE, axis=0)
    rows, (kp, kd) = [], robot.gains
    added = _added(robot, model, feedforward, len(joints))
    for step in range(int((seconds + SETTLE) * RATE)):
        for part in range(PARTS):
            t = part / PARTS  # steps that the log's clock does not see have no jumps
            wanted = (1 - t) * joints[step] + t * joints[step + 1]
            slope = (1 - t) * slopes[step] + t * slopes[step + 1]
            error = wanted - data.qpos[7:]
            data.ctrl[:] = kp * error + kd * (slope - data.qvel[6:]) + added[step]
            if part == 0 and step >= SETTLE * RATE:
                mujoco.mj_forward(model, data)  # all of it at one time
                rows.append(_sample(robot, model, data))
            mujoco.mj_step(model, data)
    if data.qpos[2] < robot.height / 2:
        raise RobotFellError(f"{robot.nominal.name} fell with seed {seed}")
    return _recording(robot, model, np.array(rows), rng)


def _added(
    robot: StandingRobot, model: Any, torque: np.ndarray | None, steps: int
) -> np.ndarray:
    """Return what controllers add at each step, in MuJoCo's order of joints."""
    added = np.zeros((steps, model.nu))
    if torque is not None:
        names = robot.nominal.joint_names
        places = [model.joint(name).dofadr[0] - 6 for name in names]
        at = np.clip(np.arange(steps) - SETTLE * RATE, 0, len(torque) - 1)
        added[:, places] = torque[at]
    return added


def prepared(log: ci.Recording, cutoff: float) -> ci.Recording:
    """Return a log with derivatives, filtered, without its ends."""
    smooth = ci.low_passed(log, motion_cutoff=cutoff, torque_cutoff=cutoff)
    return ci.differentiated(smooth).samples(slice(50, -50))


def _model(robot: StandingRobot, *, dry_friction: bool) -> Any:
    """Return the compiled robot with its box."""
    import mujoco

    spec = robot.spec()
    mass, place, moments = robot.box
    box = spec.body(robot.trunk).add_body(
        name="box", pos=place, mass=mass, ipos=[0, 0, 0], inertia=moments
    )
    box.explicitinertial = True
    for joint in spec.joints:
        joint.frictionloss *= dry_friction
    spec.option.timestep = 1.0 / RATE / PARTS
    # Else damping acts on the next velocity, and accelerations are not those of qacc.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    model = spec.compile()
    model.geom_friction[:, 0] = GRIP
    return model


class _Waves:
    """Sums of sinusoids of the base's six coordinates and the joints', from rest."""

    def __init__(self, sway: Sway, rng: np.random.Generator, freedom: int) -> None:
        def drawn(width: int) -> list[np.ndarray]:
            shape = len(sway.frequencies), width
            return [rng.uniform(0.85, 1.15, shape), rng.uniform(0, 2 * np.pi, shape)]

        pairs = zip(drawn(6), drawn(freedom - 6), strict=True)
        around, self.phases = (np.concatenate(pair, axis=1) for pair in pairs)
        self.frequencies = np.array(sway.frequencies)[:, None] * around
        widths = 3, 3, freedom - 6
        of_kinds = sway.places, sway.turns, sway.joints
        self.sizes = np.repeat(np.array(of_kinds).T, widths, axis=1)

    def at(self, t: float) -> np.ndarray:
        waves = np.sin(2 * np.pi * self.frequencies * t + self.phases)
        return np.asarray(min(t, 1.0) * np.sum(self.sizes * waves, axis=0))


def _planned(
    robot: StandingRobot, model: Any, data: Any, plan: Plan, seconds: float
) -> np.ndarray:
    """Return joint positions that keep the feet in place, by Newton's method."""
    import mujoco

    home = np.zeros(model.nq - 7)
    for name, angle in robot.posture.items():
        home[model.joint(name).qposadr[0] - 7] = angle
    bearing = [[model.joint(j).dofadr[0] for j in f.joints] for f in robot.feet]
    others = np.setdiff1d(np.arange(6, model.nv), np.concatenate(bearing))
    data.qpos[:7] = [0, 0, robot.height, 1, 0, 0, 0]
    data.qpos[7:] = home
    mujoco.mj_kinematics(model, data)
    places = [[*data.body(f.body).xpos[:2], f.rest] for f in robot.feet]
    found = []
    for step in range(int(seconds * RATE) + 2):
        x = plan.at(step / RATE)
        data.qpos[:3] = x[:3] + np.array([0, 0, robot.height])
        angle = np.linalg.norm(x[3:6])
        data.qpos[3] = np.cos(angle / 2)
        data.qpos[4:7] = x[3:6] * np.sinc(angle / 2 / np.pi) / 2
        data.qpos[others + 1] = home[others - 6] + x[others]
        for _ in range(_NEWTON if found else _FIRST):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for foot, place, own in zip(robot.feet, places, bearing, strict=True):
                off, J = _off(model, data, foot, place)
                data.qpos[np.array(own) + 1] += np.linalg.solve(J[:, own], off)
        found.append(data.qpos[7:].copy())
    return np.array(found)


def _off(model: Any, data: Any, foot: Foot, place: list[float]) -> tuple[Any, Any]:
    """Return how far a foot is off its place, a sole off level too; its Jacobian."""
    import mujoco

    body = data.body(foot.body)
    J = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, J[:3], J[3:], body.id)
    off = np.array(place) - body.xpos
    if not foot.sole:
        return off, J[:3]
    R = body.xmat.reshape(3, 3)
    turn = np.array([R[1, 2] - R[2, 1], R[2, 0] - R[0, 2], R[0, 1] - R[1, 0]]) / 2
    return np.append(off, turn), J


def _sample(robot: StandingRobot, model: Any, data: Any) -> np.ndarray:
    """Positions, torques, and what an IMU at the base's origin measures, exactly."""
    import mujoco

    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, data.qpos[3:7])
    felt = R.reshape(3, 3).T @ (data.qacc[:3] + np.array([0, 0, 9.81]))
    pairs = data.contact.geom[: data.ncon]
    touching = set(model.geom_bodyid[pairs.ravel()].tolist())
    closed = [model.body(foot.body).id in touching for foot in robot.feet]
    joints = data.qpos[7:], data.qfrc_actuator[6:]
    # Velocities of the integrator are those of half a step before its positions.
    rate = data.qvel[3:6] + 0.5 * model.opt.timestep * data.qacc[3:6]
    return np.concatenate([*joints, rate, felt, data.qpos[3:7], closed])


def _recording(
    robot: StandingRobot, model: Any, rows: np.ndarray, rng: np.random.Generator
) -> ci.Recording:
    """Return what was logged, noise and all."""
    n = model.nv - 6
    time = np.arange(len(rows)) / RATE
    cuts = np.cumsum([n, n, 3, 3, 4])
    q, torque, gyro, felt, quaternion, closed = np.split(rows, cuts, axis=1)

    def noisy(values: np.ndarray, level: float) -> np.ndarray:
        return values + level * rng.normal(size=values.shape)

    base = ci.signals.base_from_imu(
        time,
        noisy(gyro, GYRO),
        noisy(felt, ACCELEROMETER),
        cutoff=None,
        rotation=ci.signals.rotations(quaternion, "wxyz"),
    )
    flags = tuple(
        ci.recordings.ContactFlags(
            foot.frame,
            closed[:, i] > 0.5,
            foot.point,
            surface=foot.sole,
            radius=foot.radius,
        )
        for i, foot in enumerate(robot.feet)
    )
    return ci.Recording(
        tuple(model.joint(j).name for j in range(1, model.njnt)),
        time,
        noisy(q, ENCODER),
        torque=noisy(torque, TORQUE),
        name="sway",
        base=base,
        contacts=flags,
    )
