"""A motion played by a planted robot under a controller with a wrong model."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import SolverError
from consistent_id.laboratory.control import Controller
from consistent_id.laboratory.rehearsal.mujoco_robot import MujocoRobot, mujoco_robot
from consistent_id.laboratory.rehearsal.planted import PlantedRobot
from consistent_id.recordings.paths import JointPath
from consistent_id.recordings.recording import Recording

_TICK = 2e-3  # s; of the controller
_STEPS = 2  # of the integrator in a tick
_BANDWIDTH = 10.0  # Hz; of the controller
_ENCODER = 2e-5  # rad or m; step of a reading
_AWAY = 1e3  # rad or m, beyond which the robot is out of control


@dataclass(frozen=True, slots=True, eq=False)
class PlayedMotion:
    """What happened, and what was logged.

    Parameters
    ----------
    truth : Recording
        Position, velocity and torque of each tick.
    log : Recording
        Readings of encoders, and torque with noise, at the rate of recording.
    """

    wanted: Recording
    truth: Recording
    log: Recording

    @property
    def tracking_error(self) -> Vector:
        """Root-mean-square difference of wanted and true positions, [rad or m]."""
        error = np.mean((self.wanted.position - self.truth.position) ** 2, axis=0)
        return np.asarray(np.sqrt(error))


def play(
    robot: PlantedRobot,
    path: JointPath,
    noise: Vector,
    rng: np.random.Generator,
    *,
    rate: float = 100.0,
) -> PlayedMotion:
    """Play a path by computed torque of the believed model, and PD feedback.

    The robot begins in the path's first state.  Feedback is that of `Controller`; here
    it is written out, since MuJoCo moves the robot from tick to tick.  The log has the
    mean torque of the ticks around each of its samples, as drives average their
    currents; `TorqueSensors` say what becomes of it.

    Parameters
    ----------
    noise : ndarray, shape (joints,), [N m or N]
        Standard deviation of the logged torque's white noise.
    rate : float, [Hz]
        Of the log, at most the controller's.

    Raises
    ------
    SolverError
        If the robot gets out of control.
    """
    every = max(1, round(1.0 / (rate * _TICK)))
    wanted = _sampled(path)
    controller = Controller(robot.controlled, robot.believed, bandwidth=_BANDWIDTH)
    simulated = mujoco_robot(robot, _TICK / _STEPS)
    q, dq, torque = _followed(simulated, controller, wanted, robot.effort)
    names = robot.model.robot.joint_names
    truth = Recording(names, wanted.time, q, dq, torque=torque, name="as it was")
    readings: Array = np.floor(q / _ENCODER + 0.5) * _ENCODER
    read = torque + noise * np.sqrt(every) * rng.normal(size=torque.shape)
    log = Recording(
        names,
        wanted.time[::every],
        readings[::every],
        torque=robot.sensors.read(_averaged(read, every)),
        name="log",
    )
    return PlayedMotion(wanted, truth, log)


def _sampled(path: JointPath) -> Recording:
    count = round(path.duration / _TICK)
    time = path.start + np.arange(count + 1) * _TICK
    q, dq, ddq = path.evaluate(np.minimum(time, path.start + path.duration))
    elapsed = np.asarray(time - path.start, dtype=np.float64)
    return Recording(path.joints, elapsed, q, dq, ddq, name="wanted")


def _followed(
    robot: MujocoRobot, controller: Controller, wanted: Recording, effort: Vector
) -> tuple[Array, Array, Array]:
    """Return positions, velocities and torques, each (samples, joints)."""
    feedforward, gains = controller.feedforward(wanted), controller.gains(wanted)
    first, speed = wanted.position[0], wanted.velocity
    data = robot.at(first, np.zeros_like(first) if speed is None else speed[0])
    positions, velocities, torques = (np.zeros_like(wanted.position) for _ in range(3))
    last = np.zeros(len(effort))
    slope = np.zeros(len(effort))
    for k, target in enumerate(wanted.position):
        q = data.qpos[robot.positions]
        positions[k], velocities[k] = q, data.qvel[robot.velocities]
        error = target - np.floor(q / _ENCODER + 0.5) * _ENCODER
        slope += gains.share * ((error - last) / _TICK - slope)
        last = error
        torque = feedforward[k] + gains.stiffness * error + gains.damping * slope
        torques[k] = np.clip(torque, -effort, effort)
        robot.advance(data, torques[k], _STEPS)
        if not abs(data.qpos).max() < _AWAY:
            raise SolverError(
                f"the planted robot gets out of control at t = {wanted.time[k]:.3g} s; "
                "its nominal inertias are far from those of a robot that moves so"
            )
    return positions, velocities, torques


def _averaged(values: Array, every: int) -> Array:
    """Return means over so many ticks, centred at every so many-th of them.

    A torque holds from its tick to the next: those before and after a sample count.
    """
    before = np.vstack([values[:1], values[:-1]])
    centred = (before + values) / 2.0  # at the tick itself
    half = every // 2
    padded = np.pad(centred, ((half, half), (0, 0)), mode="edge")
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), padded]), axis=0)
    width = 2 * half + 1
    return np.asarray((sums[width:] - sums[:-width])[::every] / width)
