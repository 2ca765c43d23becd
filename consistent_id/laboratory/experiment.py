"""An experiment: a robot follows a motion, and sensors record it, each on its clock.

Both logs are then synchronised, ready for a regression.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from consistent_id._support.arrays import Array, Vector, array_default, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.laboratory.closed_loop import (
    Controller,
    Encoders,
    SimulatedRobot,
    controlled,
    one_or_each,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.derivatives import differentiated
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.parts import trimmed
from consistent_id.recordings.signals.tracks import (
    Delay,
    aligned,
    estimate_delay,
    track,
)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LoadCell:
    """Joint torques, on the encoders' clock, ``torque + offset + white noise``.

    Parameters
    ----------
    noise : array_like, shape () or (joints,), [N m or N]
        Standard deviation.
    offset : array_like, shape () or (joints,), [N m or N]
    """

    noise: Vector = array_default(0.0)
    offset: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        freeze(self, noise=one_or_each(self.noise, "load cell: noise"))
        offset = frozen(self.offset, (None,) * np.ndim(self.offset), "offset")
        freeze(self, offset=offset)

    def reads(self, torque: Array, rng: np.random.Generator) -> Array:
        """Return its readings of torques, shape (samples, joints)."""
        return torque + self.offset + self.noise * rng.normal(size=torque.shape)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """Joint positions and accelerations, on a clock of their own.

    The stamp of time ``t`` is ``(1 + drift) t + delay``.  Accelerations are second
    differences of true positions from picture to picture, with noise of their own: what
    shakes faster than pictures are taken is averaged, not folded back.

    Parameters
    ----------
    rate : float, [Hz]
        By their own clock.
    delay : float, [s]
        By which stamps come late; early if below zero.
    drift : float
        Relative error of their clock's rate.
    position_noise : array_like, shape () or (joints,), [rad or m]
        Standard deviation.
    acceleration_noise : array_like, shape () or (joints,), [rad/s^2 or m/s^2]
        Standard deviation.
    """

    rate: float = 300.0
    delay: float = 0.0
    drift: float = 0.0
    position_noise: Vector = array_default(0.0)
    acceleration_noise: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        if not 0.0 < self.rate < np.inf:
            raise ProblemError(f"cameras: rate is {self.rate} Hz, expected more than 0")
        if not abs(self.delay) < np.inf:
            raise ProblemError(f"cameras: delay is {self.delay} s")
        if not abs(self.drift) < 0.1:
            raise ProblemError(
                f"cameras: drift is {self.drift}, expected a relative error of the "
                "clock, such as 1e-5"
            )
        for name in ("position_noise", "acceleration_noise"):
            values = one_or_each(getattr(self, name), f"cameras: {name}")
            freeze(self, **{name: values})

    def stamps(self, start: float, stop: float) -> tuple[Vector, Vector]:
        """Return true times of the pictures between two, and their stamps, [s]."""
        first, last = ((1.0 + self.drift) * t + self.delay for t in (start, stop))
        count = int(np.floor((last - first) * self.rate * (1.0 + 1e-12))) + 1
        stamps = first + np.arange(count) / self.rate
        times = (stamps - self.delay) / (1.0 + self.drift)
        return np.clip(times, start, stop), stamps


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Laboratory:
    """A robot, its controller and its sensors.

    Parameters
    ----------
    substeps : int
        Integration steps between two ticks of the controller.
    """

    robot: SimulatedRobot
    controller: Controller
    encoders: Encoders
    load_cell: LoadCell
    cameras: Cameras
    substeps: int = 2

    def __post_init__(self) -> None:
        n = len(self.robot.joints)
        if self.controller.model.robot.joint_names != self.robot.joints:
            raise ProblemError(
                f"laboratory: the controller's joints are "
                f"{self.controller.model.robot.joint_names}, the robot's "
                f"{self.robot.joints}"
            )
        for what, values in (
            ("encoders: step", self.encoders.step),
            ("load cell: noise", self.load_cell.noise),
            ("load cell: offset", self.load_cell.offset),
            ("cameras: position_noise", self.cameras.position_noise),
            ("cameras: acceleration_noise", self.cameras.acceleration_noise),
        ):
            if values.shape not in ((), (n,)):
                raise ProblemError(
                    f"{what} has shape {values.shape}, expected one number or {n}"
                )

    def without_friction(self) -> Self:
        """Return the laboratory with the robot's friction switched off.

        The controller's model keeps it.
        """
        return replace(self, robot=self.robot.without_friction())


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ExperimentLog:
    """The logs of an experiment.

    Parameters
    ----------
    wanted : Recording
        The commanded motion.
    truth : Recording
        True position, velocity, acceleration and torque, without sensors.
    encoders : Recording
        Positions in whole steps and the load cell's torques, on the controller's clock.
    cameras : Recording
        Positions and accelerations, on the cameras' clock.
    """

    wanted: Recording
    truth: Recording
    encoders: Recording
    cameras: Recording

    @property
    def tracking_error(self) -> Vector:
        """Root-mean-square difference of wanted and true positions, [rad or m]."""
        wanted = self.wanted.of(self.truth.joints).position
        error = np.mean((wanted - self.truth.position) ** 2, axis=0)
        return np.asarray(np.sqrt(error))


def perform(
    laboratory: Laboratory, motion: Recording, rng: np.random.Generator
) -> ExperimentLog:
    """Run an experiment.

    Parameters
    ----------
    motion : Recording
        To be followed: position, velocity and acceleration, uniformly sampled at the
        rate at which the controller runs and the encoders are read.
    rng : numpy.random.Generator
        Each sensor draws from its own stream, so a change of one does not change the
        noise of the others.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.laboratory import with_friction
    >>> from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
    >>> arm = from_modified_dh("rod", [DHRow(0, 0)])
    >>> rod = with_friction(arm, [1, 0.5, 0, 0, 0, 0, 0.3, 0, 0, 0.3], viscous=0.2)
    >>> motion = SinusoidalMotion(2.0, 1000.0, ((Sinusoid(0.5, 0.5, 0.5),),))
    >>> laboratory = Laboratory(
    ...     rod,
    ...     Controller(rod.model, rod.parameters),
    ...     Encoders(1e-4),
    ...     LoadCell(noise=0.01),
    ...     Cameras(delay=0.02),
    ... )
    >>> rng = np.random.default_rng(0)
    >>> log = perform(laboratory, motion.recording(arm.joint_names), rng)
    >>> len(log.encoders), len(log.cameras), log.cameras.time[0].item()
    (2001, 601, 0.02)
    """
    cell_noise, camera_noise = rng.spawn(2)
    loop = controlled(
        laboratory.robot,
        laboratory.controller,
        laboratory.encoders,
        motion,
        substeps=laboratory.substeps,
    )
    truth = loop.motion
    encoders = Recording(
        truth.joints,
        truth.time,
        loop.readings,
        torque=laboratory.load_cell.reads(loop.torque, cell_noise),
        name=f"{motion.name} (encoders)",
    )
    cameras = _filmed(truth, laboratory.cameras, camera_noise, motion.name)
    return ExperimentLog(motion, truth, encoders, cameras)


def _filmed(
    truth: Recording, cameras: Cameras, rng: np.random.Generator, name: str
) -> Recording:
    """Look at the motion between ticks: positions by cubic pieces of exact slope."""
    from scipy.interpolate import CubicHermiteSpline

    start, stop, frame = truth.time[0], truth.time[-1], 1.0 / cameras.rate
    times, stamps = cameras.stamps(start, stop)
    path = CubicHermiteSpline(truth.time, truth.position, truth.velocity)
    q = path(times)
    # The first and the last picture have no neighbour: the next inner one is used.
    middle = np.clip(times, start + frame, stop - frame)
    ends = path(middle + frame) + path(middle - frame)
    ddq = (ends - 2.0 * path(middle)) / frame**2
    noise = rng.normal(size=(2, *q.shape))
    return Recording(
        truth.joints,
        stamps,
        q + cameras.position_noise * noise[0],
        acceleration=ddq + cameras.acceleration_noise * noise[1],
        name=f"{name} (cameras)",
    )


@brief
@dataclass(frozen=True, slots=True, eq=False)
class SynchronisedLog:
    """Motion and torque on one clock, and the corrected delay.

    Parameters
    ----------
    recording : Recording
        Position, velocity, acceleration and torque, at the slower of the two rates.
    delay : Delay
        Delay of the cameras, as estimated.
    """

    recording: Recording
    delay: Delay


def synchronised(
    log: ExperimentLog, *, cutoff: float, trim: float = 0.0, longest: float = 0.5
) -> SynchronisedLog:
    """Synchronise encoders, load cell and cameras.

    The delay comes from the encoders' positions and the cameras' accelerations;
    velocities are differences of encoder positions; all channels pass the same filters,
    which leaves what is linear in them true.

    Parameters
    ----------
    cutoff : float, [Hz]
        Cut-off of a zero-phase low-pass, below the slower clock's Nyquist frequency.
    trim : float, [s]
        Cut off at either end, where filters see one side only.
    longest : float, [s]
        Longest delay that is tried.
    """
    delay = estimate_delay(
        track(log.encoders, "position"),
        track(log.cameras, "acceleration"),
        longest=longest,
    )
    moving = replace(log.encoders, velocity=differentiated(log.encoders).velocity)
    seen = track(log.cameras, "acceleration")
    together = aligned(moving, seen, delay=delay.seconds)
    smooth = low_passed(together, motion_cutoff=cutoff, torque_cutoff=cutoff)
    start, stop = smooth.time[0] + trim, smooth.time[-1] - trim
    name = f"{log.wanted.name} (synchronised)"
    return SynchronisedLog(replace(trimmed(smooth, start, stop), name=name), delay)
