"""The torque of known bodies along a motion, and as a load that friction depends on."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import Array, Vector, chunks, frozen
from consistent_id.errors import ProblemError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.newton_euler import (
    Scalar,
    coordinate_torques,
    floats,
    joint_geometry,
    link_motions,
    regressor_entries,
)
from consistent_id.robot.model import RobotModel

_NO_LOAD = 1e-9  # torque over the sum of its parts' sizes that is rounding alone


def body_torques(
    robot: RobotModel,
    rows: Mapping[int, int],
    bodies: Sequence[Vector],
    state: Sequence[Array | None],
    base: Array | None,
    *,
    size: int,
) -> list[Array]:
    """Return torques of several robots' bodies along one motion.

    Parameters
    ----------
    robot : RobotModel
    rows : mapping of int to int
        The row of each generalised coordinate that has one.
    bodies : sequence of ndarray, each shape (10 links,)
    state, base
        See `TorqueModel.rigid_torque`.
    size : int
        Samples that are computed at a time.

    Returns
    -------
    list of ndarray, each shape (samples, rows), [N m or N]
    """
    geometry, gravity = joint_geometry(robot), floats(robot.gravity)
    numbers = [own.reshape(-1, 10).tolist() for own in bodies]
    samples = 0 if state[0] is None else len(state[0])
    torques = [np.zeros((samples, len(rows))) for _ in bodies]
    for part in chunks(samples, size):
        moves: list[Sequence[Scalar] | Array] = [
            [0.0] * len(robot)
            if values is None
            else np.ascontiguousarray(values[part].T)
            for values in state
        ]
        carried = None if base is None else np.ascontiguousarray(base[part].T)
        motion = link_motions(robot, moves, lambda x: (np.sin(x), np.cos(x)), carried)
        found = coordinate_torques(geometry, gravity, motion, numbers)
        for robot_number, j, values in found:
            if j in rows:
                torques[robot_number][part, rows[j]] += values
    return torques


def checked_reference(
    robot: RobotModel, drive: Sequence[DriveTerms], given: Vector | None
) -> Vector | None:
    """Return the inertial parameters that loads are computed from, if any is needed.

    Parameters
    ----------
    drive : sequence of DriveTerms
        Drive terms of each joint.
    given : array_like, shape (10 links,), optional
        By default the nominal robot's.

    Raises
    ------
    ProblemError
        If they are needed and not known, or put no load on a joint that needs one.
    """
    in_need = [
        name
        for name, terms in zip(robot.joint_names, drive, strict=True)
        if terms.needs_load
    ]
    if not in_need:
        return None
    reference = robot.nominal if given is None else given
    if reference is None:
        raise ProblemError(
            f"friction of {', '.join(in_need)} depends on the load, but some links' "
            "nominal parameters are unknown; give load_reference, or leave "
            "load_friction out"
        )
    reference = frozen(reference, (10 * len(robot.links),), "load_reference")
    idle = unloaded_joints(robot, reference)
    without = [name for name in in_need if name in idle]
    if without:
        raise ProblemError(
            f"the robot of the nominal parameters puts no load on {', '.join(without)}"
            "; leave load_friction out there, or give load_reference"
        )
    return reference


def unloaded_joints(
    robot: RobotModel, reference: Vector | None = None
) -> tuple[str, ...]:
    """Return the joints on which the robot puts no torque but rounding.

    Parameters
    ----------
    reference : ndarray, shape (10 links,), optional
        Inertial parameters; by default the nominal ones.  None are unloaded where
        these are unknown.
    """
    reference = robot.nominal if reference is None else reference
    if reference is None:
        return ()
    parts = _rigid_probe(robot) * reference.reshape(-1, 10)[:, :, None]
    torques = np.linalg.norm(parts.sum(axis=(1, 2)), axis=1)
    sizes = np.linalg.norm(abs(parts).sum(axis=(1, 2)), axis=1)
    return tuple(
        name
        for name, torque, size in zip(robot.joint_names, torques, sizes, strict=True)
        if torque <= _NO_LOAD * size
    )


@lru_cache(maxsize=16)
def _rigid_probe(robot: RobotModel) -> Array:
    """Return each joint's torque by each body's parameters at some random states."""
    states = [*np.random.default_rng(0).uniform(-2.0, 2.0, (3, len(robot), 8))]
    base = BaseMotion.at_rest(8).stacked.T if robot.floating else None
    motion = link_motions(robot, states, lambda x: (np.sin(x), np.cos(x)), base)
    gravity, bodies = floats(robot.gravity), len(robot.links)
    probe = np.zeros((len(robot), bodies, 10, 8))
    for j, k, entries in regressor_entries(joint_geometry(robot), gravity, motion):
        if j < len(robot):  # the others are the base's
            probe[j, k] = np.stack([np.broadcast_to(x, 8) for x in entries])
    return probe
