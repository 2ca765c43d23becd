"""Proof of how fast torque changes, and of its root mean square, which heats a motor.

The rate is that of the smooth part: Coulomb friction jumps where a joint turns, and no
rate bounds that.
"""

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.motion.proofs.peaks import bounds_of, peaks
from consistent_id.motion.proofs.torque_bounds import (
    TorqueBounds,
    first_cells,
    path_torques,
)
from consistent_id.recordings.paths import JointPath
from consistent_id.regression.regressor import TorqueModel

_TOLERANCE = 0.01  # share of a limit that proven and reached rates may differ by
_DENSITY = 400.0  # stretches per second, over which the largest torque stands for all


def torque_rate_bounds(
    path: JointPath, model: TorqueModel, parameters: Matrix, limit: Vector
) -> TorqueBounds:
    """Enclose the rates at which the smooth part of each torque changes, [N m/s].

    Parameters
    ----------
    parameters : ndarray, shape (robots, parameters)
    limit : ndarray, shape (torque joints,), [N m/s or N/s]
        What the tolerance is relative to, where it is finite.
    """
    found = []
    for torque in path_torques(path, model, parameters):
        piece, cells = torque.path, first_cells(torque.path)
        within = np.tile(_TOLERANCE * limit, 2)
        found.append(
            peaks(
                torque.rate_enclosure(cells),
                piece.start,
                piece.duration,
                cells,
                within,
            )
        )
    return TorqueBounds(model.torque_joints, *bounds_of(found))


def torque_rms_bound(path: JointPath, model: TorqueModel, parameters: Matrix) -> Vector:
    """Bound each torque's root mean square over a path, friction included.

    Over each of 400 stretches per second, the largest torque of any robot counts.

    Returns
    -------
    ndarray, shape (torque joints,), [N m or N]
    """
    total, duration = np.zeros(len(model.torque_joints)), 0.0
    for torque in path_torques(path, model, parameters):
        length = torque.path.duration
        cells = max(first_cells(torque.path), int(np.ceil(_DENSITY * length)))
        total += length * torque.mean_square(cells)
        duration += length
    return np.asarray(np.sqrt(total / duration))
