"""How much of a regressor is noise of the motion, and what that does to least squares.

With ``W + V`` in place of ``W``, least squares tends to ``(W^T W + V^T V)^-1 W^T W x``:
to first order it is off by ``-(W^T W)^-1 V^T V x``, which no number of samples cures.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.motion_arrays import Motion, motion_of
from consistent_id.regression.regressor import TorqueModel

_SAMPLES = 4000  # of the motion, spread evenly, from which averages are taken


@dataclass(frozen=True, slots=True, eq=False)
class ColumnNoise:
    """Noise of the motion in the columns of a regressor.

    Parameters
    ----------
    names : tuple of str
        Of the base parameters.
    shares : ndarray, shape (base,)
        Of each column's power, noise; joints are weighted by their torque.
    bias : ndarray, shape (base,)
        Of weighted least squares by that noise, to first order.
    torque_error : float
        What this bias does to the torque, relative to the torque.
    """

    names: tuple[str, ...]
    shares: Vector
    bias: Vector
    torque_error: float

    @property
    def noisiest(self) -> tuple[tuple[str, float], ...]:
        """Columns and their shares, the largest first."""
        order = np.argsort(-self.shares)
        return tuple((self.names[i], float(self.shares[i])) for i in order)


@single_threaded
def column_noise(
    model: TorqueModel,
    recording: Recording,
    covariance: Array,
    base: BaseParameters,
    *,
    seed: int = 0,
) -> ColumnNoise:
    """Return the share of each base column that is noise of the motion.

    The noise is drawn at samples of the motion: friction, which jumps, and products of
    velocities have no simpler propagation.

    Parameters
    ----------
    recording : Recording
        Prepared, with torque.
    covariance : ndarray, shape (joints, 3, 3)
        Of position, velocity and acceleration: `noise_gain` times the variance of the
        readings, in the robot's order.
    seed : int
        Of the noise that is drawn.
    """
    # Noise of the motion is looked at before the filter: each sample by itself.
    bare = replace(_spread(recording), torque_filter=None)
    motion = motion_of(model, bare, None)
    torque = motion.torque
    weights = 1.0 / np.maximum(np.sqrt((torque**2).mean(axis=0)), 1e-12)
    W = _rows(model, motion, base, weights)
    V = _rows(model, _noisy(motion, covariance, seed), base, weights) - W
    solution = solve_linear(W, (torque * weights).T.ravel())
    pulled = V.T @ (V @ solution.x)
    bias = -solution.pseudo_inverse @ (solution.pseudo_inverse.T @ pulled)
    power = (W**2).sum(axis=0)
    shares = (V**2).sum(axis=0) / np.where(power > 0.0, power, np.inf)
    error = np.linalg.norm(W @ bias) / np.sqrt(torque.size)
    return ColumnNoise(base.names, shares, np.asarray(bias), float(error))


def _spread(recording: Recording) -> Recording:
    return recording.samples(slice(None, None, -(-len(recording) // _SAMPLES)))


def _noisy(motion: Motion, covariance: Array, seed: int) -> Motion:
    """Return the motion with noise of the given covariance drawn upon it."""
    rng = np.random.default_rng(seed)
    n, joints = motion.q.shape
    # Eigenvectors, as position and acceleration may go wholly together.
    values, axes = np.linalg.eigh(covariance)
    roots = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    drawn = np.einsum("jab,njb->anj", roots, rng.normal(size=(n, joints, 3)))
    q, dq, ddq = (x + e for x, e in zip(motion[:3], drawn, strict=True))
    return motion._replace(q=q, dq=dq, ddq=ddq)


def _rows(
    model: TorqueModel, motion: Motion, base: BaseParameters, weights: Vector
) -> Matrix:
    """Return the base columns of all torque joints' rows, weighted."""
    Y = model.regressor(motion.q, motion.dq, motion.ddq)[:, list(base.independent)]
    return np.concatenate(list(Y * weights[:, None, None]), axis=1).T
