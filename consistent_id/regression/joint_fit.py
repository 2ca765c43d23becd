"""Least squares of all parameters, each joint weighted by its own residual."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.triangles import triangle

_ROUNDS = 3  # of weights and solution; joints' levels settle to a few per cent
_EXACT = 1e-6  # residual, relative to the torque, that counts as none


class JointFit(NamedTuple):
    """A fit whose residuals show each joint's noise.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
        The smallest solution.
    noise : ndarray, shape (joints,), [N m or N]
        RMS residual, or a millionth of the torque.
    weights : ndarray, shape (joints,), [N m or N]
        By which rows were divided.
    steps : ndarray, shape (parameters, rank)
        All rows so divided, times these, are orthonormal.
    """

    x: Vector
    noise: Vector
    weights: Vector
    steps: Matrix


def joint_fit(factors: Sequence[Matrix], counts: Sequence[int]) -> JointFit:
    """Fit parameters to the triangular factors of joints.

    Weights and solution alternate, from weights of one.  Rank is decided on unit
    columns.
    """
    width = factors[0].shape[1]
    size = np.sqrt(counts)
    torque = np.array([np.linalg.norm(F[:, -1]) for F in factors]) / size
    floor = _EXACT * np.maximum(torque, _EXACT * (torque.max() or 1.0))
    noise = np.ones(len(factors))
    for _ in range(_ROUNDS):
        weights = noise
        rows = np.vstack([F / s for F, s in zip(factors, weights, strict=True)])
        norms = np.linalg.norm(rows[:, :-1], axis=0)
        # LAPACK's fast SVD may not converge where columns are zero: they are left out.
        kept = np.flatnonzero(norms > DATA_RANK_TOLERANCE * norms.max())
        R = triangle(np.asfortranarray(rows[:, [*kept, -1]]))
        U, s, Vt = np.linalg.svd(R[:, :-1] / norms[kept], full_matrices=False)
        rank = int((s > DATA_RANK_TOLERANCE * s.max(initial=1e-300)).sum())
        steps = np.zeros((width - 1, rank))
        steps[kept] = (Vt[:rank].T / s[:rank]) / norms[kept, None]
        x = steps @ (U[:, :rank].T @ R[:, -1])
        z = np.append(x, -1.0).reshape(width)
        rest = np.array([np.linalg.norm(F @ z) for F in factors]) / size
        noise = np.maximum(rest, floor)
    return JointFit(x, noise, weights, steps)
