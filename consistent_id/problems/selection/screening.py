"""Moves ranked cheaply: the bodies are held, the drive terms are fitted anew.

Given bodies, the drive terms of each joint are a small non-negative least-squares
problem of their own.  It ranks what a move brings; the constrained fit then decides.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.problems.selection.factors import Factors, JointFactors
from consistent_id.problems.selection.held_out import HeldOut, held_out
from consistent_id.problems.selection.models import (
    RATES,
    Candidate,
    FoldFits,
    candidate_columns,
)
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import triangle

_RANK = 1e-8  # of the largest singular value, of columns of unit length


def screened(
    candidate: Candidate, factors: Factors, current: FoldFits, sigma: Vector
) -> HeldOut:
    """Return errors of a candidate whose bodies are those of other fits.

    Parameters
    ----------
    factors : Factors
        Of the candidate's rows.
    current : FoldFits
        Whose bodies are held, fold by fold.
    sigma : ndarray, shape (torque joints,), [N m or N]
    """
    size = candidate.model.layout.inertial_size
    x = np.zeros((len(current.parameters), len(candidate.model.layout)))
    x[:, :size] = current.parameters[:, :size]
    for group in _groups(candidate, factors):
        joints = [factors.joints[j] for j in group]
        keys = [
            i
            for i, key in enumerate(candidate.keys)
            if any(key in joint.places for joint in joints)
        ]
        A, b = _left(candidate, joints, sigma[group], current.parameters, keys)
        x[:, [size + i for i in keys]] = _drive(A, b, candidate.nonnegative[keys])
    return held_out(FoldFits(candidate, x), factors, sigma)


def _groups(candidate: Candidate, factors: Factors) -> list[list[int]]:
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
    candidate: Candidate,
    joints: Sequence[JointFactors],
    sigma: Vector,
    bodies: Matrix,
    keys: Sequence[int],
) -> tuple[Array, Matrix]:
    """Return drive columns, and the torque that the bodies leave to them, by folds."""
    size = candidate.model.layout.inertial_size
    columns, rest = [], []
    for joint, s in zip(joints, sigma, strict=True):
        R, kept = joint.training, len(joint.expand)
        A = np.zeros((*R.shape[:2], len(keys)))
        for i, key in enumerate(candidate.keys[i] for i in keys):
            if key in joint.places:
                A[:, :, i] = R[:, :, joint.places[key]]
        own = bodies[:, :size] @ joint.expand.T
        left = R[:, :, -1] - np.einsum("frk,fk->fr", R[:, :, :kept], own)
        columns.append(A / s)
        rest.append(left / s)
    return np.concatenate(columns, axis=1), np.concatenate(rest, axis=1)


def _drive(A: Array, b: Matrix, nonnegative: BoolArray) -> Matrix:
    """Return least-squares solutions, entries marked so being zero or more.

    Parameters
    ----------
    A : ndarray, shape (folds, rows, columns)
    b : ndarray, shape (folds, rows)
    nonnegative : ndarray of bool, shape (columns,)
    """
    from scipy.optimize import nnls

    n = A.shape[2]
    norms = np.linalg.norm(A, axis=1)
    unit = np.where(norms > 0.0, norms, 1.0)
    both = np.concatenate([A / unit[:, None], b[:, :, None]], axis=2)
    R = np.asarray(np.linalg.qr(both, mode="r"))
    y = np.zeros((len(A), n))
    sizes = abs(np.diagonal(R[:, :n, :n], axis1=1, axis2=2))
    fine = sizes.min(axis=1, initial=1.0) > _RANK
    y[fine] = np.linalg.solve(R[fine, :n, :n], R[fine, :n, n:])[:, :, 0]
    free = np.flatnonzero(~nonnegative)
    for fold in np.flatnonzero(~fine | (y[:, nonnegative] < 0.0).any(axis=1)):
        columns = R[fold, :n, :n]
        z, _ = nnls(np.column_stack([columns, -columns[:, free]]), R[fold, :n, n])
        y[fold] = z[:n]
        y[fold, free] -= z[n:]
    return y / unit


def torque_delay(
    candidate: Candidate, factors: Factors, base: BaseParameters, sigma: Vector
) -> float:
    """Return by how much the torque seems to be late [s]: to first order.

    A torque that is late by ``d`` is ``tau - d dtau/dt``; ``d`` is one more unknown of
    least squares, without constraints.  So is, joint by joint, a delay of Coulomb
    friction alone: bristles and teeth bend first where a joint turns back, and a delay
    of all torque has to show in the rest of it.

    Parameters
    ----------
    base : BaseParameters
        Of the bodies.
    sigma : ndarray, shape (torque joints,), [N m or N]
    """
    rows, late = [], RATES[0]
    for place, (joint, s) in enumerate(zip(factors.joints, sigma, strict=True)):
        columns = (
            candidate_columns(candidate, joint, np.concatenate(joint.cells), base) / s
        )
        own = np.zeros((len(columns), len(factors.joints)))
        own[:, place] = columns[:, late]
        rows.append(np.column_stack([own, np.delete(columns, late, 1)]))
    R = triangle(np.asfortranarray(np.vstack(rows)))
    return -float(smallest_solution(R[:, :-1], R[:, -1], _RANK)[-1])
