"""The torque of known parameters, without the regressor.

With bodies known, Newton and Euler's forces take a fraction of what the coefficients of
all parameters do.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.regression.compiled.sines import sine_and_cosine
from consistent_id.regression.drive_entries import drive_entries
from consistent_id.regression.joint_geometry import (
    floats,
    joint_geometry,
    link_motions,
)
from consistent_id.regression.loads import loaded
from consistent_id.regression.model_rows import biased_rows, rows_of
from consistent_id.regression.newton_euler import Scalar, torque_parts

if TYPE_CHECKING:
    from consistent_id.regression.regressor import TorqueModel

_CHUNK = 4072  # samples: as of the regressor


def model_torque(
    model: "TorqueModel", x: Vector, state: Sequence[Array], base: Array | None
) -> Array:
    """Return the torque of all parameters, shape (samples, torque joints), [N m or N].

    Parameters
    ----------
    model : TorqueModel
    x : ndarray, shape (parameters,)
    state : three ndarray, each shape (samples, joints)
        Positions and their two derivatives.
    base : ndarray, shape (samples, 9), optional
        How the base moves, if it floats; see `BaseMotion.stacked`.
    """
    size = model.layout.inertial_size
    torque, row = rigid_torque(model, x[:size], state, base), rows_of(model)
    for start in range(0, len(torque), _CHUNK):
        part = slice(start, start + _CHUNK)
        few = [values[part] for values in state]
        carried = None if base is None else base[part]
        loads = {
            j: rigid_torque(model, reference, few, carried)[:, row[j]]
            for j, reference in loaded(model)
        }
        q, dq, ddq = (np.ascontiguousarray(values.T) for values in few)
        for j, column, values in drive_entries(model, q, dq, ddq, loads):
            if j in row:
                torque[part, row[j]] += x[column] * values
    for column, name in enumerate(biased_rows(model), start=-6):
        torque[:, model.torque_joints.index(name)] += x[column]
    return torque


def rigid_torque(
    model: "TorqueModel",
    bodies: Vector,
    state: Sequence[Array | None],
    base: Array | None = None,
) -> Array:
    """Return the torque of bodies alone, shape (samples, torque joints), [N m or N].

    Parameters
    ----------
    model : TorqueModel
    bodies : ndarray, shape (10 links,)
    state : three ndarray, each shape (samples, joints)
        As of `model_torque`; derivatives are None for a robot at rest, which feels
        gravity alone.
    base : ndarray, shape (samples, 9), optional
        As of `model_torque`.
    """
    robot, row = model.robot, rows_of(model)
    geometry, gravity = joint_geometry(robot), floats(robot.gravity)
    numbers = bodies.reshape(-1, 10).tolist()
    samples = 0 if state[0] is None else len(state[0])
    torque = np.zeros((samples, len(model.torque_joints)))
    for start in range(0, samples, _CHUNK):
        part = slice(start, start + _CHUNK)
        moves: list[Sequence[Scalar] | Array] = [
            [0.0] * len(robot)
            if values is None
            else np.ascontiguousarray(values[part].T)
            for values in state
        ]
        carried = None if base is None else np.ascontiguousarray(base[part].T)
        motion = link_motions(robot, moves, _both, carried)
        for j, _, values in torque_parts(geometry, gravity, motion, numbers):
            if j in row:
                torque[part, row[j]] += values
    return torque


def _both(x: Array) -> tuple[Array, Array]:
    sine, cosine = sine_and_cosine(x)
    return sine, cosine
