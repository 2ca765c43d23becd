"""How well an estimate predicts recorded torque."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.stiction import IN_MOTION, beyond_friction, moving_shares
from consistent_id.recordings.recording import Recording
from consistent_id.regression.motion_arrays import Motion, motion_of
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import rows_in_newton


@dataclass(frozen=True, slots=True, eq=False)
class TorqueError:
    """Prediction error of one estimate on one recording.

    Parameters
    ----------
    rms : ndarray, shape (torque joints,), [N m or N]
        Root of the mean squared error.
    relative : ndarray, shape (torque joints,)
        RMS error over RMS torque.
    torque : ndarray, shape (torque joints,), [N m or N]
        RMS torque.
    stacked : float
        ``||tau - prediction|| / ||tau||`` over all joints; where some turn and others
        slide, the root mean square of both kinds' own, since N m and N do not add.
    beyond : ndarray, shape (torque joints,), [N m or N]
        Root of the mean squared error beyond what friction can hold where a joint
        rests, which is no error of the robot; see `beyond_friction`.
    stacked_beyond : float
        ``stacked`` of that.
    """

    recording: str
    rms: Vector
    relative: Vector
    torque: Vector
    stacked: float
    beyond: Vector
    stacked_beyond: float

    @property
    def mse(self) -> Vector:
        """Mean squared error of each joint, [(N m)^2 or N^2]."""
        return self.rms**2


def torque_errors(
    estimates: Sequence[Estimate], recording: Recording
) -> list[TorqueError]:
    """Return the prediction error of each estimate of one model along a recording.

    Raises
    ------
    ProblemError
        If the recording has no torque, or its torque is zero throughout.
    """
    model = estimates[0].model
    if not model.robot.floating and recording.of(model.torque_joints).torque is None:
        raise ProblemError(f"{recording.name} has no torque to compare with")
    motion = motion_of(model, recording, None)
    if not motion.torque.any():
        raise ProblemError(f"{recording.name}: its torque is zero throughout")
    regression = build_regression(model, recording, noise=False)
    counts, size = np.array(regression.counts), regression.torque_rms
    moving = moving_shares(model, regression)
    # Where rows are mixed, friction of a joint at rest is in all of them.
    rests = motion.mixing is None and bool((moving < IN_MOTION).any())
    errors = []
    for estimate in estimates:
        rms = regression.residual_rms(estimate.parameters)
        beyond = _beyond(estimate, recording, motion) if rests else rms
        errors.append(
            TorqueError(
                recording.name,
                rms,
                rms / np.where(size > 0.0, size, np.nan),
                size,
                stacked_of_kinds(model, counts * rms**2, counts * size**2),
                beyond,
                stacked_of_kinds(model, counts * beyond**2, counts * size**2),
            )
        )
    return errors


def _beyond(estimate: Estimate, recording: Recording, motion: Motion) -> Vector:
    """Return the RMS error beyond what friction at rest can hold, of each joint."""
    model, fit = estimate.model, estimate.fit
    error = motion.torque - motion.predicted(model, estimate.parameters)
    held = np.zeros(len(model.torque_joints)) if fit is None else fit.holding
    moved = recording.of(model.robot.joint_names)
    left = beyond_friction(model, moved, error, held)
    return np.asarray(np.sqrt(np.mean(left**2, axis=0)))


def stacked_of_kinds(model: TorqueModel, error: Vector, torque: Vector) -> float:
    """Return the relative error of all rows, each kind relative to its own size.

    Forces in N and torques in N m do not add.  `error` and `torque` are sums of
    squares, of each row.
    """
    slides = rows_in_newton(model.robot, model.torque_joints)
    kinds = [kind for kind in (slides, ~slides) if torque[kind].any()]
    squares = [error[kind].sum() / torque[kind].sum() for kind in kinds]
    return float(np.sqrt(np.mean(squares)))


def stacked_error(errors: Sequence[TorqueError]) -> float | None:
    """Return the relative torque error over several recordings, which count alike.

    The root of the mean square of `TorqueError.stacked`; None without any.
    """
    return _mean([error.stacked for error in errors])


def stacked_beyond(errors: Sequence[TorqueError]) -> float | None:
    """Return the same of what is beyond friction at rest."""
    return _mean([error.stacked_beyond for error in errors])


def _mean(stacked: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(stacked)))) if stacked else None
