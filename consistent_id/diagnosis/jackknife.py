"""Least squares whose standard errors come from leaving segments out.

Misfits of a model that is not quite right are neither white nor of one size; what each
segment of the log pulls the estimate by tells how sure it is.  The plain sandwich takes
the misfit that is left, too small where there are as many parameters as segments; the
jackknife takes what the fit of the other segments leaves.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector

_SEGMENTS = 20
_RANK = 1e-6  # of the largest singular value, of unit columns
_TOUCHED = 1e-6  # squared share in the null space from which a parameter is lost
_TINY = 1e-300  # instead of an error of zero, by which one could not divide


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A solution, its standard errors, and the misfit it leaves.

    Parameters
    ----------
    solution : ndarray, shape (columns,)
    errors : ndarray, shape (columns,)
        Infinite where the data leave it open.
    misfit : float
        Norm of ``A x - z``.
    """

    solution: Vector
    errors: Vector
    misfit: float


def jackknifed(A: Array, z: Matrix) -> Fitted:
    """Solve ``A x = z`` in the least-squares sense.

    With ``x_g`` the solution without segment ``g`` of ``G``, the standard errors are
    the roots of ``(G - 1) / G sum_g (x_g - x)^2``.

    Parameters
    ----------
    A : ndarray, shape (joints, samples, columns)
    z : ndarray, shape (joints, samples)
    """
    joints, samples, columns = A.shape
    norms = np.linalg.norm(A, axis=(0, 1))
    unit = np.where(norms > 0.0, norms, 1.0)
    U, s, Vt = np.linalg.svd((A / unit).reshape(-1, columns), full_matrices=False)
    kept = s > _RANK * s[0]
    U, back = U[:, kept], Vt[kept].T / s[kept]
    inner = U.T @ z.reshape(-1)
    rest = z - (U @ inner).reshape(z.shape)
    U = U.reshape(joints, samples, -1)
    cuts = [c for c in np.array_split(np.arange(samples), _SEGMENTS) if len(c)]
    moves = [back @ _moved(U[:, cut], rest[:, cut]) for cut in cuts]
    share = (len(cuts) - 1) / len(cuts)
    errors = np.sqrt(share * np.sum(np.square(moves), axis=0))
    lost = 1.0 - np.sum(Vt[kept] ** 2, axis=0) > _TOUCHED
    errors = np.where(lost, np.inf, np.maximum(errors, _TINY))
    return Fitted(back @ inner / unit, errors / unit, float(np.linalg.norm(rest)))


def _moved(U: Array, rest: Array) -> Vector:
    """Return by how much leaving a segment out moves the solution.

    In the orthonormal coordinates of all segments: ``(1 - U'U)^-1 U' rest`` of the
    segment's rows.
    """
    u = U.reshape(-1, U.shape[2])
    others = np.eye(u.shape[1]) - u.T @ u
    moved, *_ = np.linalg.lstsq(others, u.T @ rest.reshape(-1), rcond=_RANK)
    return np.asarray(moved)
