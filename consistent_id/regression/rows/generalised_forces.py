"""The effect of forces from outside on the rows of a floating robot.

``[Y_b; Y_j] x = [0; tau] + sum_i J_i^T f_i``: a wrench at a point pushes the base as it
is, turns it by its moment about the base's origin, and weighs on the joints before it.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import Wrench
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import CONTACT_FREE, row_names
from consistent_id.robot.kinematics import FrameMotion, frame_motion
from consistent_id.robot.model import RobotModel


def contact_jacobian(
    robot: RobotModel,
    q: ArrayLike,
    *,
    frame: str,
    point: ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """Return the Jacobian of a point of a floating robot, in base axes.

    ``[v; w] = J [v_base; w_base; dq]``, all in the axes of the base, so that a wrench
    at the point does ``J^T [f; n]`` to the rows of `row_names`.

    Parameters
    ----------
    robot : RobotModel
        Robot with a floating base.
    q : array_like, shape (samples, joints), [rad or m]
    frame : str
        A link, or one that is fixed to it.
    point : array_like, shape (3,), [m]
        In that frame.

    Returns
    -------
    ndarray, shape (samples, 6, 6 + joints)
    """
    return _of_base_and_joints(frame_motion(robot, q, frame=frame, point=point))


def _of_base_and_joints(moved: FrameMotion) -> Array:
    """Return the Jacobian of `contact_jacobian`, given the motion with the joints."""
    n, _, joints = moved.jacobian.shape
    J = np.zeros((n, 6, 6 + joints))
    J[:, :3, :3] = J[:, 3:, 3:6] = np.eye(3)
    x, y, z = moved.position.T
    # v = v_base + w_base x p
    J[:, 0, 4], J[:, 0, 5] = z, -y
    J[:, 1, 3], J[:, 1, 5] = -z, x
    J[:, 2, 3], J[:, 2, 4] = y, -x
    J[:, :, 6:] = moved.jacobian
    return J


def measured_forces(model: TorqueModel, recording: Recording) -> Matrix | None:
    """Return the right-hand side of a floating robot's rows.

    Torques of joints, zero for the base, and what the recorded wrenches add to both;
    None if a joint has a row, but no torque.

    Raises
    ------
    RecordingError
        If the motion of the base is missing.
    """
    robot = model.robot
    if recording.base is None:
        raise RecordingError(
            f"{recording.name} has no base motion, but the base of {robot.name!r} "
            "floats; give Recording(..., base=BaseMotion(...)), or load the robot with "
            "a fixed base"
        )
    forces = _of_drives(model, recording, "torque")
    if forces is None:
        return None
    for wrench in recording.wrenches:
        forces += _of_wrench(robot, recording, wrench)
    return _wanted(model, forces)


def shifted_forces(model: TorqueModel, recording: Recording) -> Matrix | None:
    """Return the `torque_shift` of a floating robot's rows, if the recording has it."""
    if recording.torque_shift is None:
        return None
    forces = _of_drives(model, recording, "torque_shift")
    return None if forces is None else _wanted(model, forces)


def _of_drives(
    model: TorqueModel,
    recording: Recording,
    channel: Literal["torque", "torque_shift"],
) -> Matrix | None:
    """Return a channel of the joints in all rows; None if a row lacks it."""
    wanted, every = model.torque_joints, row_names(model.robot)
    names = every if wanted == (CONTACT_FREE,) else wanted
    own = [name for name in names if name in model.robot.joint_names]
    forces = np.zeros((len(recording), len(every)))
    if own:
        values = getattr(recording.of(own), channel)
        if values is None:
            return None
        forces[:, [every.index(name) for name in own]] = values
    return forces


def _wanted(model: TorqueModel, forces: Matrix) -> Matrix:
    """Return the rows that a model has, of all."""
    wanted, every = model.torque_joints, row_names(model.robot)
    names = every if wanted == (CONTACT_FREE,) else wanted
    return np.asarray(forces[:, [every.index(name) for name in names]])


def _of_wrench(robot: RobotModel, recording: Recording, wrench: Wrench) -> Matrix:
    q = joint_positions(robot, recording)
    moved = frame_motion(robot, q, frame=wrench.frame, point=wrench.point)
    acting = _in_base_axes(wrench, recording, moved.rotation)
    return np.asarray(np.einsum("nir,ni->nr", _of_base_and_joints(moved), acting))


def joint_positions(robot: RobotModel, recording: Recording) -> Matrix:
    """Return positions in the robot's order; of one body alone there are none."""
    if not len(robot):
        return np.zeros((len(recording), 0))
    return recording.of(robot.joint_names).position


def state_of(
    model: TorqueModel, recording: Recording
) -> tuple[Array, Array | None, Array | None]:
    """Return position, velocity and acceleration in the robot's order of joints."""
    if not len(model.robot):  # one body, all of whose motion is the base's
        still = np.zeros((len(recording), 0))
        return still, still, still
    log = recording.of(model.robot.joint_names)
    return log.position, log.velocity, log.acceleration


def _in_base_axes(wrench: Wrench, recording: Recording, frame: Array) -> Matrix:
    """Return a wrench in base axes, shape (samples, 6).

    Parameters
    ----------
    frame : ndarray, shape (samples, 3, 3)
        Rotation of the wrench's frame in the base.

    Raises
    ------
    RecordingError
        If it is given in world axes, and the base's rotation is not known.
    """
    if wrench.axes == "base":
        return wrench.values
    if wrench.axes == "frame":
        turn = frame
    elif recording.base is None or recording.base.rotation is None:
        raise RecordingError(
            f"{recording.name}: the wrench at {wrench.frame!r} is in world axes, but "
            "the rotation of the base is not known; give BaseMotion(..., rotation=...)"
        )
    else:
        turn = np.swapaxes(recording.base.rotation, 1, 2)
    halves = wrench.values.reshape(-1, 2, 3)
    return np.asarray(np.einsum("nij,nkj->nki", turn, halves).reshape(-1, 6))
