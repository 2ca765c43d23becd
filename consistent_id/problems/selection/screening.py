"""Ranking of moves without constrained fits.

With fixed bodies, the drive terms of each joint are the solution of a small
non-negative least-squares problem, whose error ranks the moves.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.problems.selection.fits import (
    UNSEEN,
    CandidateModel,
    Factors,
    FoldFits,
    HeldOut,
    JointFactors,
    held_out,
)

_RANK = 1e-8  # of the largest singular value, of columns of unit length


def screened(
    candidate: CandidateModel, factors: Factors, bodies: Matrix, sigma: Vector
) -> HeldOut:
    """Return errors of a candidate with the bodies of other fits.

    Parameters
    ----------
    factors : Factors
        Factors of the candidate's rows.
    bodies : ndarray, shape (folds, parameters)
        Fits, whose inertial parameters are used, fold by fold.
    sigma : ndarray, shape (torque joints,), [N m or N]
    """
    size = candidate.model.layout.inertial_size
    x = np.zeros((len(bodies), len(candidate.model.layout)))
    x[:, :size] = bodies[:, :size]
    for group in _groups(candidate, factors):
        joints = [factors.joints[j] for j in group]
        places = set().union(*(joint.places for joint in joints))
        keys = [i for i, key in enumerate(candidate.keys) if key in places]
        A, b = _left(candidate, joints, sigma[group], bodies, keys)
        x[:, [size + i for i in keys]] = drive_fit(A, b, candidate.nonnegative[keys])
    return held_out(FoldFits(candidate, x), factors, sigma)


def _groups(candidate: CandidateModel, factors: Factors) -> list[list[int]]:
    """Return the joints that share drive terms, by their places."""
    groups: list[list[int]] = []
    for j, joint in enumerate(factors.joints):
        own = {key for key in candidate.keys if key in joint.places}
        shared = [
            group
            for group in groups
            if any(own & factors.joints[i].places.keys() for i in group)
        ]
        merged = sorted({j, *(i for group in shared for i in group)})
        groups = [*(g for g in groups if g not in shared), merged]
    return groups


def _left(
    candidate: CandidateModel,
    joints: Sequence[JointFactors],
    sigma: Vector,
    bodies: Matrix,
    keys: Sequence[int],
) -> tuple[Array, Matrix]:
    """Return drive columns, and the torque less that of the bodies, for each fold."""
    size = candidate.model.layout.inertial_size
    columns, rest = [], []
    for joint, s in zip(joints, sigma, strict=True):
        R, kept = joint.training, len(joint.expand)
        places = [joint.places.get(candidate.keys[i], -1) for i in keys]
        A = R[:, :, places] * np.where(np.array(places) < 0, 0.0, 1.0 / s)
        own = bodies[:, :size] @ joint.expand.T
        left = R[:, :, -1] - (R[:, :, :kept] @ own[:, :, None])[:, :, 0]
        columns.append(A)
        rest.append(left / s)
    return np.concatenate(columns, axis=1), np.concatenate(rest, axis=1)


def drive_fit(A: Array, b: Matrix, nonnegative: BoolArray) -> Matrix:
    """Return least-squares solutions whose marked entries are zero or more.

    Parameters
    ----------
    A : ndarray, shape (folds, rows, columns)
    b : ndarray, shape (folds, rows)
    nonnegative : ndarray of bool, shape (columns,)
    """
    n = A.shape[2]
    norms = np.linalg.norm(A, axis=1)
    seen = norms > UNSEEN * np.linalg.norm(b, axis=1)[:, None]
    A, unit = A * seen[:, None], np.where(seen, norms, 1.0)
    both = np.concatenate([A / unit[:, None], b[:, :, None]], axis=2)
    R = np.asarray(np.linalg.qr(both, mode="r"))
    y = np.zeros((len(A), n))
    sizes = abs(np.diagonal(R[:, :n, :n], axis1=1, axis2=2))
    fine = sizes.min(axis=1, initial=1.0) > _RANK
    y[fine] = np.linalg.solve(R[fine, :n, :n], R[fine, :n, n:])[:, :, 0]
    wrong = np.flatnonzero(~fine | (y[:, nonnegative] < 0.0).any(axis=1))
    if not len(wrong):
        return y / unit
    from scipy.optimize import nnls  # its import takes longer than all else here

    free = np.flatnonzero(~nonnegative)
    for fold in wrong:
        columns = R[fold, :n, :n]
        z, _ = nnls(np.column_stack([columns, -columns[:, free]]), R[fold, :n, n])
        y[fold] = z[:n]
        y[fold, free] -= z[n:]
    return y / unit
