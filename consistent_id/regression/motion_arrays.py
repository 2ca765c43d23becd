"""A recording's arrays in a torque model's order of joints."""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, IntArray, frozen
from consistent_id.errors import RecordingError
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.generalised_forces import measured_forces


class Motion(NamedTuple):
    """A recording's arrays in the model's order of joints, all of one length.

    Torque and weights are those of the model's torque joints.
    """

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    weights: Array | None
    base: BaseMotion | None = None

    def samples(self, start: int, stop: int) -> "Motion":
        """Return consecutive samples."""
        part = slice(start, stop)
        weights = None if self.weights is None else self.weights[part]
        state = self.q[part], self.dq[part], self.ddq[part]
        base = None if self.base is None else self.base.samples(part)
        return Motion(*state, self.torque[part], weights, base)

    def counts(self, rows: range) -> IntArray:
        """Return how many of the rows count as samples of each joint's torque."""
        if self.weights is None:
            return np.full(self.torque.shape[1], len(rows))
        return np.asarray(np.count_nonzero(self.weights[rows], axis=0))


def motion_of(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    """Return a recording's arrays as a model wants them.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing, or the motion of a base that floats.
    """
    if model.robot.floating:
        tau, base = measured_forces(model, recording), recording.base
    else:
        tau, base = recording.of(model.torque_joints).torque, None
    dq: Array | None
    ddq: Array | None
    if not len(model.robot):  # one body, all of whose motion is the base's
        still = np.zeros((len(recording), 0))
        q, dq, ddq = still, still, still
    else:
        log = recording.of(model.robot.joint_names)
        q, dq, ddq = log.position, log.velocity, log.acceleration
    if dq is None or ddq is None or tau is None:
        given = {"velocity": dq, "acceleration": ddq, "torque": tau}
        missing = [name for name, values in given.items() if values is None]
        raise RecordingError(
            f"{recording.name} has no {' and no '.join(missing)}; velocity and "
            "acceleration come from signals.differentiated(recording)"
        )
    if weights is not None:
        weights = frozen(weights, tau.shape, f"row_weights of {recording.name}")
    return Motion(q, dq, ddq, tau, weights, base)
