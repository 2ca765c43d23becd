"""What drives, encoders and gears of PD-controlled joints get wrong, as a value."""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector, array_default, freeze, frozen
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.commanded import PDGains, by_joint, commanded

_BY_JOINT = ("scale", "encoder_bias", "compliance")


@dataclass(frozen=True, slots=True, eq=False)
class DriveCalibration:
    """Delay of commands, torque scales, biases of encoders, and springs of joints.

    The drive of a joint makes ``scale`` times the torque that its gains state, from
    commands that reach it late; and its encoder reads the joint's position plus
    ``encoder_bias``.  A drive compares command and reading, so its torque does not feel
    the bias; gravity does.  Between motor, where the encoder is, and link there may be
    a spring of ``compliance``; see `as_rigid`.

    Parameters
    ----------
    delay : float, [s]
    scale : array_like, shape () or (joints,)
    encoder_bias : array_like, shape () or (joints,), [rad or m]
    compliance : array_like, shape () or (joints,), [rad/(N m) or m/N]
        Zero for a rigid joint.

    Raises
    ------
    RecordingError
        If the delay or a compliance is negative, a scale is not positive, or a bias
        not finite.
    """

    delay: float = 0.0
    scale: Vector = array_default(1.0)
    encoder_bias: Vector = array_default(0.0)
    compliance: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        for name in _BY_JOINT:
            value = getattr(self, name)
            shape = (None,) if np.ndim(value) else ()
            freeze(self, **{name: frozen(value, shape, name, RecordingError)})
        if not (np.asarray(self.scale) > 0.0).all():
            raise RecordingError(f"scale is {self.scale}, expected positive numbers")
        if not (np.asarray(self.compliance) >= 0.0).all():
            raise RecordingError(f"compliance is {self.compliance}, expected 0 or more")
        if not 0.0 <= self.delay < np.inf:
            raise RecordingError(
                f"delay of commands is {self.delay} s, expected 0 or more"
            )

    def of(self, joints: int) -> "DriveCalibration":
        """Return the calibration of so many joints, one value each.

        Raises
        ------
        RecordingError
            If there are values for another number of joints.
        """
        return DriveCalibration(self.delay, **by_joint(self, _BY_JOINT, joints))

    def gains(self, gains: PDGains) -> PDGains:
        """Return what stated gains really are; torque limits are in the same units.

        A spring comes behind the one that is stated.
        """
        scale = self.scale
        limit = gains.torque_limit * scale
        stiff = stiffness_of(self.compliance + 1.0 / gains.stiffness)
        return PDGains(gains.kp * scale, gains.kd * scale, limit, stiff)

    def log(self, recording: Recording) -> Recording:
        """Return a log in true positions, with what feed-forward torque really is.

        Its commands stay as early as they were given.
        """
        known = self.of(len(recording.joints))
        bias, scale = known.encoder_bias, known.scale
        command, forward = recording.position_command, recording.torque_command
        return replace(
            recording,
            position=recording.position - bias,
            position_command=None if command is None else command - bias,
            torque_command=None if forward is None else forward * scale,
        )


def stiffness_of(compliance: Vector) -> Vector:
    """Return the stiffness of springs, infinite for a rigid joint, [N m/rad or N/m]."""
    rigid = np.full(np.shape(compliance), np.inf)
    return np.asarray(np.divide(1.0, compliance, out=rigid, where=compliance > 0.0))


def calibrated(
    recording: Recording, gains: PDGains, calibration: DriveCalibration
) -> Recording:
    """Return a log in true positions, with the torque that its commands really make.

    Parameters
    ----------
    recording : Recording
        With position and the command of it, as they were logged.
    gains : PDGains
        As they are stated.
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
    return commanded(true, calibration.gains(gains), delay=calibration.delay)
