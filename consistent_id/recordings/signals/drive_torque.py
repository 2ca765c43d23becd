"""Torque of PD-controlled drives from commands, and its calibration."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    array_default,
    freeze,
    frozen,
)
from consistent_id._support.tables import brief, some_of
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording, velocities

_GAINS = ("kp", "kd", "torque_limit", "stiffness")

_BY_JOINT = ("scale", "encoder_bias", "compliance")

_LISTED = 12  # names of joints in an error


@brief
@dataclass(frozen=True, slots=True, eq=False)
class PDGains:
    """Gains of drives that follow commands of position.

    ``tau = kp (q_command - q) + kd (dq_command - dq) + tau_command``

    Parameters
    ----------
    kp : array_like, shape () or (joints,), [N m/rad or N/m]
    kd : array_like, shape () or (joints,), [N m s/rad or N s/m]
    torque_limit : array_like, shape () or (joints,), [N m or N]
        Where the drive clips the torque; infinite if it does not.
    stiffness : array_like, shape () or (joints,), [N m/rad or N/m]
        Stiffness of the spring between motor and link, with the encoder at the motor;
        infinite for a rigid joint.

    Raises
    ------
    RecordingError
        If a gain is negative or not finite, or a limit or stiffness is not positive.

    Examples
    --------
    >>> PDGains(20.0, 1.5).of(2).kp
    array([20., 20.])
    """

    kp: Vector
    kd: Vector
    torque_limit: Vector = array_default(np.inf)
    stiffness: Vector = array_default(np.inf)

    def __post_init__(self) -> None:
        for name in _GAINS:
            value, positive = getattr(self, name), name not in ("kp", "kd")
            shape = (None,) if np.ndim(value) else ()
            array = frozen(value, shape, name, RecordingError, finite=not positive)
            least = np.nextafter(0.0, 1.0) if positive else 0.0
            if not (array >= least).all():
                expected = "positive" if positive else "0 or more"
                raise RecordingError(f"{name} is {array}, expected {expected}")
            freeze(self, **{name: array})

    def of(self, joints: int | Sequence[str]) -> "PDGains":
        """Return the gains of joints, or of so many joints, one each.

        Raises
        ------
        RecordingError
            If there are gains for another number of joints.
        """
        return PDGains(**by_joint(self, _GAINS, joints))


def commanded(
    recording: Recording,
    gains: PDGains,
    *,
    delay: float = 0.0,
    delay_error: float = 0.0,
) -> Recording:
    """Return a recording with the torque from its commands and gains.

    A command is constant from its sample to the next, so its mean delay is half a step:
    at the instant of a sample, the command before has the same weight as its own.

    Parameters
    ----------
    recording : Recording
        With position and its command.  Without a command of velocity, zero is used;
        without a measured velocity, central differences.
    gains : PDGains
    delay : float, [s]
        Additional delay of commands: they are read at an earlier time, by linear
        interpolation between samples.  Measurements of the drives are not delayed.
    delay_error : float, [s]
        Standard error of the delay; the torque's change is `Recording.torque_shift`.

    Raises
    ------
    RecordingError
        If there is no command of position, or the delay or its error is negative.

    Examples
    --------
    >>> time = np.arange(4) / 100.0
    >>> still, target = np.zeros((4, 1)), np.ones((4, 1))
    >>> log = Recording(("hip",), time, still, still, position_command=target)
    >>> commanded(log, PDGains(20.0, 1.5)).torque[0]
    array([20.])
    """
    if recording.position_command is None:
        raise RecordingError(
            f"{recording.name}: gains need commands, but there is no "
            f"position_command; name its columns"
        )
    for what, value in (("delay", delay), ("error of the delay", delay_error)):
        if not 0.0 <= value < np.inf:
            raise RecordingError(f"{what} of commands is {value} s, expected 0 or more")
    gains = gains.of(recording.joints)
    velocity = velocities(recording)
    own = 0.5 * float(np.median(np.diff(recording.time)))

    def torque(late: float) -> Array:
        commands = (
            None if values is None else _late(recording.time, values, own + late)
            for values in (
                recording.position_command,
                recording.velocity_command,
                recording.torque_command,
            )
        )
        q, dq, feed_forward = (0.0 if values is None else values for values in commands)
        tau = gains.kp * (q - recording.position) + gains.kd * (dq - velocity)
        return np.clip(tau + feed_forward, -gains.torque_limit, gains.torque_limit)

    shift = None
    if delay_error > 0.0:
        sooner, later = max(delay - delay_error, 0.0), delay + delay_error
        slope = (torque(later) - torque(sooner)) / (later - sooner)
        shift = slope * delay_error
    return replace(recording, torque=torque(delay), torque_shift=shift)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class DriveCalibration:
    """Delay of commands, torque scales, biases of encoders, and springs of joints.

    The torque of a drive is ``scale`` times the torque from its stated gains and
    delayed commands; and its encoder reads the joint's position plus ``encoder_bias``.
    A drive compares command and reading, so the bias does not change its torque, but
    gravity torque.  Between motor, where the encoder is, and link there may be a spring
    of ``compliance``; see `as_rigid`.

    Parameters
    ----------
    delay : float, [s]
    scale : array_like, shape () or (joints,)
    encoder_bias : array_like, shape () or (joints,), [rad or m]
    compliance : array_like, shape () or (joints,), [rad/(N m) or m/N]
        Zero for a rigid joint.
    delay_error : float, [s]
        Standard error of the delay.

    Raises
    ------
    RecordingError
        If the delay, its error or a compliance is negative, a scale is not positive, or
        a bias not finite.
    """

    delay: float = 0.0
    scale: Vector = array_default(1.0)
    encoder_bias: Vector = array_default(0.0)
    compliance: Vector = array_default(0.0)
    delay_error: float = 0.0

    def __post_init__(self) -> None:
        for name in _BY_JOINT:
            value = getattr(self, name)
            shape = (None,) if np.ndim(value) else ()
            freeze(self, **{name: frozen(value, shape, name, RecordingError)})
        if not (np.asarray(self.scale) > 0.0).all():
            raise RecordingError(f"scale is {self.scale}, expected positive numbers")
        if not (np.asarray(self.compliance) >= 0.0).all():
            raise RecordingError(f"compliance is {self.compliance}, expected 0 or more")
        late = {"delay": self.delay, "error of the delay": self.delay_error}
        for what, value in late.items():
            if not 0.0 <= value < np.inf:
                raise RecordingError(
                    f"{what} of commands is {value} s, expected 0 or more"
                )

    def of(self, joints: int | Sequence[str]) -> "DriveCalibration":
        """Return the calibration of joints, or of so many joints, one value each.

        Raises
        ------
        RecordingError
            If there are values for another number of joints.
        """
        values = by_joint(self, _BY_JOINT, joints)
        return DriveCalibration(self.delay, **values, delay_error=self.delay_error)

    def gains(self, gains: PDGains) -> PDGains:
        """Return the real gains of stated ones; torque limits are scaled, too.

        A spring is in series with the stated one.
        """
        scale = self.scale
        limit = gains.torque_limit * scale
        stiff = stiffness_of(self.compliance + 1.0 / gains.stiffness)
        return PDGains(gains.kp * scale, gains.kd * scale, limit, stiff)

    def log(self, recording: Recording) -> Recording:
        """Return a log with true positions and real feed-forward torque.

        Its commands are not delayed.
        """
        known = self.of(recording.joints)
        bias, scale = known.encoder_bias, known.scale
        command, forward = recording.position_command, recording.torque_command
        return replace(
            recording,
            position=recording.position - bias,
            position_command=None if command is None else command - bias,
            torque_command=None if forward is None else forward * scale,
        )


def calibrated(
    recording: Recording, gains: PDGains, calibration: DriveCalibration
) -> Recording:
    """Return a log with true positions and the real torque of its commands.

    Parameters
    ----------
    recording : Recording
        With position and its command, as logged.
    gains : PDGains
        The stated gains.
    calibration : DriveCalibration

    Raises
    ------
    RecordingError
        If there is no command of position.

    Examples
    --------
    >>> time = np.arange(4) / 100.0
    >>> still, told = np.zeros((4, 1)), np.ones((4, 1))
    >>> log = Recording(("hip",), time, still, still, position_command=told)
    >>> weak = DriveCalibration(scale=0.9)
    >>> calibrated(log, PDGains(20.0, 1.5), weak).torque[0]
    array([18.])
    """
    true = calibration.log(recording)
    return commanded(
        true,
        calibration.gains(gains),
        delay=calibration.delay,
        delay_error=calibration.delay_error,
    )


def stiffness_of(compliance: Vector) -> Vector:
    """Return the stiffness of springs, infinite for a rigid joint, [N m/rad or N/m]."""
    rigid = np.full(np.shape(compliance), np.inf)
    return np.asarray(np.divide(1.0, compliance, out=rigid, where=compliance > 0.0))


def by_joint(
    holder: object, names: Sequence[str], joints: int | Sequence[str]
) -> dict[str, Vector]:
    """Return arrays of a value by name, one number for each joint.

    Parameters
    ----------
    joints : int, or sequence of str
        Their number, or their names, which an error then lists.

    Raises
    ------
    RecordingError
        If there are values for another number of joints.
    """
    if isinstance(joints, int):
        count, listed = joints, ""
    else:
        count, listed = len(joints), f" ({some_of(joints, _LISTED)})"
    values = {}
    for name in names:
        array = getattr(holder, name)
        if array.ndim and len(array) != count:
            raise RecordingError(
                f"{name} has {len(array)} values for {count} joints{listed}; give one "
                "for all, or one each in the robot's order"
            )
        values[name] = np.broadcast_to(array, (count,))
    return values


def _late(time: Vector, values: Matrix, delay: float) -> Matrix:
    """Return the commands, delayed."""
    columns = (np.interp(time - delay, time, column) for column in values.T)
    return np.column_stack(list(columns))
