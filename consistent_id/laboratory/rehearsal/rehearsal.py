"""Rehearsals: motions played by planted robots, and the errors of predictions.

A controller with a wrong model follows the motion; parameters are identified from the
log and compared with the planted ones; and the identified model has to keep the robot
still against gravity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.tables import Table, brief
from consistent_id.constraints import NonNegativeDrive, PhysicalConsistency
from consistent_id.errors import SolverError
from consistent_id.estimation.base_least_squares import least_squares
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate, torque_errors
from consistent_id.excitation.accuracy import PredictedAccuracy
from consistent_id.laboratory.closed_loop import Controller
from consistent_id.laboratory.rehearsal.planted import (
    MujocoRobot,
    PlantedRobot,
    mujoco_robot,
)
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    decimated,
    differentiated,
    low_passed,
    trimmed,
)
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import build_regression

_TICK = 2e-3  # s; of the controller
_STEPS_PER_TICK = 2  # of the integrator in a tick
_BANDWIDTH = 10.0  # Hz; of the controller
_ENCODER_STEP = 2e-5  # rad or m; step of a reading
_OUT_OF_CONTROL = 1e3  # rad or m, beyond which the robot is out of control

HELD = float(np.radians(0.2))
"""Angle [rad], or distance [m], within which a pose is kept."""
_HELD_POSES = 50  # random poses that must be kept
_HOLDING_TIME = 1.0  # s
_HOLDING_STEP = 2e-3  # s
_HOLDING_LOOKS = 50  # at how far joints have moved

_CUTOFF = 8.0  # times the highest frequency of the motion
_LOWEST_CUTOFF, _HIGHEST_CUTOFF = 6.0, 0.2  # Hz; share of the rate
_MIXED = 0.05  # s of which rows are mixed to one
_TRIM = 0.5  # s at either end: filters have no neighbours, friction at rest any value

SENSED = 0.5
"""Share of the predicted noise that sensors have; friction's errors are the rest."""
_WITHIN = 1.96  # standard errors that contain 95 % of a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class PlayedMotion:
    """The true motion, and the log.

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
    currents; `TorqueSensors` convert it.

    Parameters
    ----------
    noise : ndarray, shape (joints,), [N m or N]
        Standard deviation of the logged torque's white noise.
    rate : float, [Hz]
        Rate of the log, at most the controller's.

    Raises
    ------
    SolverError
        If the robot gets out of control.
    """
    every = max(1, round(1.0 / (rate * _TICK)))
    wanted = _sampled(path)
    controller = Controller(robot.controlled, robot.believed, bandwidth=_BANDWIDTH)
    simulated = mujoco_robot(robot, _TICK / _STEPS_PER_TICK)
    q, dq, torque = _followed(simulated, controller, wanted, robot.effort)
    names = robot.model.robot.joint_names
    truth = Recording(names, wanted.time, q, dq, torque=torque, name="as it was")
    readings: Array = np.floor(q / _ENCODER_STEP + 0.5) * _ENCODER_STEP
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
        error = target - np.floor(q / _ENCODER_STEP + 0.5) * _ENCODER_STEP
        slope += gains.share * ((error - last) / _TICK - slope)
        last = error
        torque = feedforward[k] + gains.stiffness * error + gains.damping * slope
        torques[k] = np.clip(torque, -effort, effort)
        robot.advance(data, torques[k], _STEPS_PER_TICK)
        if not abs(data.qpos).max() < _OUT_OF_CONTROL:
            raise SolverError(
                f"the planted robot gets out of control at t = {wanted.time[k]:.3g} s; "
                "its nominal inertias are far from those of a robot that moves so"
            )
    return positions, velocities, torques


def _averaged(values: Array, every: int) -> Array:
    """Return means over so many ticks, centred at every so many-th of them.

    A torque is constant from its tick to the next: those before and after a sample are
    used.
    """
    before = np.vstack([values[:1], values[:-1]])
    centred = (before + values) / 2.0  # at the tick itself
    half = every // 2
    padded = np.pad(centred, ((half, half), (0, 0)), mode="edge")
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), padded]), axis=0)
    width = 2 * half + 1
    return np.asarray((sums[width:] - sums[:-width])[::every] / width)


@dataclass(frozen=True, slots=True)
class Holding:
    """Number of poses that are kept.

    Parameters
    ----------
    largest : float, [rad or m]
        Largest motion of a joint.
    """

    poses: int
    held: int
    largest: float


def held_poses(
    robot: PlantedRobot,
    estimate: Estimate,
    limits: MotionLimits,
    rng: np.random.Generator,
) -> Holding:
    """Let go of the robot at random poses, with the identified gravity torque alone.

    The torque is that of the pose.  There is no controller, only dry friction: a pose
    is kept if within a second no joint moves further than `HELD`.
    """
    rigid, x = robot.controlled, robot.without_friction(estimate.parameters)
    simulated = mujoco_robot(robot, _HOLDING_STEP)
    poses = rng.uniform(limits.lower, limits.upper, (_HELD_POSES, len(limits.joints)))
    still = np.zeros_like(poses)
    torques = rigid.predict(x, poses, still, still)
    moved = np.array(
        [_moved(simulated, *case) for case in zip(poses, torques, strict=True)]
    )
    return Holding(_HELD_POSES, int((moved <= HELD).sum()), float(moved.max()))


def _moved(simulated: MujocoRobot, pose: Vector, torque: Vector) -> float:
    """Return the largest motion of a joint."""
    data = simulated.at(pose, np.zeros_like(pose))
    largest = 0.0
    for _ in range(_HOLDING_LOOKS):
        simulated.advance(
            data, torque, round(_HOLDING_TIME / _HOLDING_STEP / _HOLDING_LOOKS)
        )
        moved = abs(data.qpos[simulated.positions] - pose).max()
        largest = max(largest, float(moved))
    return largest


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Estimates from a log.

    Parameters
    ----------
    plain : Estimate
        Weighted least squares: base parameters.
    constrained : Estimate
        Estimate of physically consistent bodies, with friction that brakes.
    """

    plain: Estimate
    constrained: Estimate

    def errors(self, robot: PlantedRobot, base: BaseParameters) -> Vector:
        """Return the errors of the base parameters by least squares."""
        return np.asarray(self.plain.base_values - base.projection @ robot.parameters)


def prepared(log: Recording, highest: float) -> Recording:
    """Return a log with velocity and acceleration, its motion low-passed.

    Parameters
    ----------
    highest : float, [Hz]
        Frequency of the motion.
    """
    cutoff = min(max(_CUTOFF * highest, _LOWEST_CUTOFF), _HIGHEST_CUTOFF * log.rate)
    filtered = differentiated(low_passed(log, motion_cutoff=cutoff))
    start, stop = float(log.time[0]), float(log.time[-1])
    return trimmed(filtered, start + _TRIM, stop - _TRIM)


def identified(
    robot: PlantedRobot,
    base: BaseParameters,
    log: Recording,
    noise: Vector,
    highest: float,
) -> Identified:
    """Identify a planted robot from a log, with unknown bodies.

    Parameters
    ----------
    robot : PlantedRobot
        Planted robot; only its model is used.
    noise : ndarray, shape (joints,), [N m or N]
        By which rows are divided.
    highest : float, [Hz]
        Frequency of the motion.
    """
    model = robot.model
    ready = prepared(log, highest)
    mixed = max(1, round(_MIXED * ready.rate))
    regression = build_regression(model, decimated(ready, mixed)).weighted(noise)
    plain = least_squares(model, regression, base=base)
    constraints = (PhysicalConsistency(), NonNegativeDrive())
    constrained = constrained_least_squares(
        model, regression, constraints=constraints, base=base
    )
    return Identified(plain, constrained)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """One motion, played by one planted robot.

    Parameters
    ----------
    errors : ndarray, shape (base,)
        Errors of the base parameters by weighted least squares.
    predicted : ndarray, shape (base,)
        Standard errors that were predicted.
    held_out : float
        Error of the predicted torque on another motion, RMS, in shares of the noise.
    reached : mapping of str to ndarray, shape (joints,)
        Largest share of each limit, by quantity: position, velocity, torque.
    tracking : float, [rad or m]
        Largest root-mean-square tracking error of a joint.
    """

    base: BaseParameters
    errors: Vector
    predicted: Vector
    held_out: float
    holding: Holding
    reached: Mapping[str, Vector]
    tracking: float

    @property
    def mean_error(self) -> float:
        """Geometric mean of the errors' sizes."""
        size = np.maximum(abs(self.errors), np.finfo(float).tiny)
        return float(np.exp(np.log(size).mean()))

    @property
    def ratio(self) -> float:
        """Root mean square of errors over predicted standard errors."""
        return float(np.sqrt(np.mean((self.errors / self.predicted) ** 2)))

    @property
    def covered(self) -> float:
        """Share of the predicted 95 % intervals that contain the truth."""
        return float(np.mean(abs(self.errors) <= _WITHIN * self.predicted))


def rehearse(
    robot: PlantedRobot,
    accuracy: PredictedAccuracy,
    path: JointPath,
    validation: JointPath,
    limits: MotionLimits,
    noise: Vector,
    rng: np.random.Generator,
    *,
    highest: float,
    rate: float = 100.0,
) -> Rehearsal:
    """Play a motion, identify, and compare with the truth and with predictions.

    Parameters
    ----------
    accuracy : PredictedAccuracy
        Accuracy of the motion, for this robot's model.
    path, validation : JointPath
        The motion for identification, and another motion whose torque is predicted.
    noise : ndarray, shape (joints,), [N m or N]
        That accuracy was predicted for; that of the sensors is `SENSED` times this.
    highest : float, [Hz]
        Frequency of the motion.
    rate : float, [Hz]
        Rate of the log.
    """
    played = play(robot, path, SENSED * noise, rng, rate=rate)
    found = identified(robot, accuracy.base, played.log, noise, highest)
    unseen = play(robot, validation, np.zeros_like(noise), rng, rate=rate).log
    (unexplained,) = torque_errors([found.constrained], prepared(unseen, highest))
    return Rehearsal(
        base=accuracy.base,
        errors=found.errors(robot, accuracy.base),
        predicted=accuracy.standard_errors(),
        held_out=float(np.sqrt(np.mean((unexplained.rms / noise) ** 2))),
        holding=held_poses(robot, found.constrained, limits, rng),
        reached=_reached(played, limits),
        tracking=float(played.tracking_error.max()),
    )


def _reached(played: PlayedMotion, limits: MotionLimits) -> dict[str, Vector]:
    """Return the largest share of each limit that was used in truth."""
    truth = played.truth
    motion = {
        "position": abs(truth.position - limits.middle) / limits.derivative(0),
        "velocity": abs(np.asarray(truth.velocity)) / limits.velocity,
        "torque": abs(np.asarray(truth.torque)) / limits.effort,
    }
    return {name: share.max(axis=0) for name, share in motion.items()}


def rehearsal_table(title: str, rehearsals: Mapping[str, Sequence[Rehearsal]]) -> Table:
    """Return the errors of predictions, a line for each motion.

    Parameters
    ----------
    rehearsals : mapping of str to sequence of Rehearsal
        By the motion's name, those of all planted robots.
    """
    rows = []
    for name, some in rehearsals.items():
        poses = sum(one.holding.poses for one in some)
        rows.append(
            (
                name,
                f"{np.median([one.mean_error for one in some]):.3g}",
                f"{np.median([one.held_out for one in some]):.3g}",
                f"{np.sqrt(np.mean([one.ratio**2 for one in some])):.2f}",
                f"{100.0 * np.mean([one.covered for one in some]):.0f} %",
                f"{sum(one.holding.held for one in some)} of {poses}",
            )
        )
    count = min(len(some) for some in rehearsals.values())
    return Table(
        title,
        ("motion", "error", "held-out", "over predicted", "in 95 %", "poses held"),
        tuple(rows),
        (
            f"{count} planted robots; medians; error: geometric mean over base "
            "parameters, in SI units",
            "held-out: torque error on another motion, RMS, in shares of the noise",
            "over predicted: RMS of errors over predicted standard errors, 1 if true",
            "poses held: kept by the identified gravity torque alone, within 0.2 "
            "degrees for a second",
        ),
    )
