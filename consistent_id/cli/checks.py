"""A log without a problem file, looked through for faults."""

from collections.abc import Callable, Sequence
from pathlib import Path

from consistent_id.diagnosis import Diagnosis, diagnose
from consistent_id.problems.drafting import gains_of
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.recordings.column_guess import require_torque
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import differentiated, low_passed, resampled
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.loaders import load_robot


def check_log(
    model: Path,
    log: Path,
    columns: Columns,
    *,
    torque_gain: Sequence[float] = (),
    cutoff: float = 10.0,
) -> Diagnosis:
    """Look for faults in a log of a robot that has no problem file.

    Parameters
    ----------
    model : Path
        URDF or MJCF.
    log : Path
    columns : Columns
        Its `torque_joints` are the model's, too.
    torque_gain : sequence of float
        From the torque columns to torque: one for all joints, or one each.
    cutoff : float, [Hz]
        Of the filter before differentiation.
    """
    torque_model = TorqueModel(
        load_robot(model),
        DEFAULT_DRIVE.terms,
        torque_joints=tuple(columns.torque_joints),
    )
    require_torque(columns.torque, torque_gain)
    gain = gains_of(torque_gain, len(torque_model.robot))
    recording = read_recording(
        log, torque_model.robot.joint_names, columns, torque_gain=gain
    )

    return diagnose(torque_model, recording, prepare=smoothed(cutoff))


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
