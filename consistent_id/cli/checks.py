"""A log without a problem file, looked through for faults."""

from collections.abc import Callable
from pathlib import Path

from consistent_id.diagnosis import Diagnosis, diagnose
from consistent_id.problems.log_entries import drive_limits, with_torque
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.robot_logs import RobotLogs
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import differentiated, low_passed, resampled
from consistent_id.regression.regressor import TorqueModel


def check_log(logs: RobotLogs, log: Path, *, cutoff: float = 10.0) -> Diagnosis:
    """Look for faults in a log of a robot that has no problem file.

    Parameters
    ----------
    logs : RobotLogs
        How it is read.
    cutoff : float, [Hz]
        Of the filter before differentiation.
    """
    model = TorqueModel(
        logs.robot,
        DEFAULT_DRIVE.terms,
        torque_joints=tuple(logs.columns.torque_joints),
    )
    raw = with_torque(logs.read(log), logs.gains)
    limits = drive_limits(logs.gains, logs.robot.joint_names)
    return diagnose(model, raw, prepare=smoothed(cutoff), limits=limits)


def smoothed(cutoff: float) -> Callable[[Recording], Recording]:
    """Return what makes a log uniform, low-passes and differentiates it.

    Parameters
    ----------
    cutoff : float, [Hz]
    """

    def prepare(raw: Recording) -> Recording:
        smooth = low_passed(
            resampled(raw, raw.rate), motion_cutoff=cutoff, torque_cutoff=cutoff
        )
        return differentiated(smooth)

    return prepare
