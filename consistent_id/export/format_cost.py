"""The torque error of an exported file: it is read back, and predicts recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from consistent_id.estimation.estimate import Estimate, torque_errors
from consistent_id.estimation.torque_error import stacked_of_kinds
from consistent_id.export.export_formats import exported, known_format
from consistent_id.export.file_torque import FileTorque, file_torque
from consistent_id.export.file_values import parameters_in_file, read_contents
from consistent_id.recordings.recording import Recording
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import FLOATING, Selection

_SUFFIXES = {"mjcf": "xml", "numpy": "py"}


@dataclass(frozen=True, slots=True)
class FormatCost:
    """Torque error of a file, beside that of the estimate in it.

    Parameters
    ----------
    error, own : float
        Relative torque errors over the recordings: of the file, of the estimate.
    recordings : tuple of str
        Names of the recordings.
    held_out : bool
        Whether the estimate that was exported for it was not fitted to them.
    read_back : bool
        Whether the file was read back; otherwise the error is that of the estimate
        without the terms that the format does not have.
    """

    error: float
    own: float
    recordings: tuple[str, ...]
    held_out: bool
    read_back: bool

    def __str__(self) -> str:
        kind = "held-out error" if self.held_out else "error on its own data,"
        how = "read back" if self.read_back else "by the terms that it has"
        return (
            f"{kind} of the file, {how}: {100.0 * self.error:.2g} %; of the estimate: "
            f"{100.0 * self.own:.2g} % (all joints, {', '.join(self.recordings)})"
        )


def format_cost(
    estimate: Estimate,
    form: str,
    recordings: Sequence[Recording],
    *,
    selection: Selection,
    source: Path | None = None,
    held_out: bool = True,
) -> FormatCost:
    """Export an estimate, read the file back and return its torque error.

    Friction that a format has as one Coulomb level changes its sign as the estimate's
    does.

    Parameters
    ----------
    estimate : Estimate
        Fitted to other recordings, or the error is too small.
    recordings : sequence of Recording
        With torque; prepared as for a comparison.
    selection : Selection
        Joints of the source that are the robot's.
    source : Path, optional
        See `exported`.
    held_out : bool
        Whether the estimate was not fitted to the recordings.

    Raises
    ------
    ProblemError, ModelError
        If the format cannot express the robot, or its file is refused.
    """
    known, robot = known_format(form), estimate.model.robot
    if source is None:
        selection = Selection(
            base=FLOATING if robot.floating else None,
            joints=None if robot.floating else robot.joint_names,
        )
    # The bodies and drive terms of mjlab's robot are in the MJCF file.
    form = "mjcf" if form == "mjlab" else form
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        export = exported(
            estimate, form, source=source, folder=place, allow_refused=True
        )
        file = place / f"robot.{_SUFFIXES.get(form, form)}"
        file.write_bytes(export.content)
        read = read_contents(form, file, estimate, selection)
        torque = file_torque(form, file, estimate) if read is None else None
        own = [e.stacked for log in recordings for e in torque_errors([estimate], log)]
        if torque is None:
            x = parameters_in_file(estimate, known.holds, read)
            left = replace(estimate, parameters=x)
            errors = [
                e.stacked for log in recordings for e in torque_errors([left], log)
            ]
        else:
            errors = [error_by(torque, estimate.model, log) for log in recordings]
    names = tuple(dict.fromkeys(log.name for log in recordings))
    loaded = read is not None or torque is not None
    return FormatCost(_mean(errors), _mean(own), names, held_out, loaded)


def error_by(torque: FileTorque, model: TorqueModel, recording: Recording) -> float:
    """Return the relative error of the torque that a function computes.

    It is that of `TorqueError.stacked`.

    Parameters
    ----------
    recording : Recording
        With torque, which is not zero throughout.
    """
    motion, joints = motion_of(model, recording, None), model.robot.joint_names
    rows, along = [joints.index(name) for name in model.torque_joints], motion.along
    tau = torque(along.q, along.dq, along.ddq)[:, rows]
    wrong = motion.torque - motion.through(tau)
    squares = [
        np.sum(values**2, axis=0, where=motion.counted)
        for values in (wrong, motion.torque)
    ]
    return stacked_of_kinds(model, *squares)


def _mean(errors: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0
