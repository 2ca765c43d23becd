"""Singular values and least squares by them, also where LAPACK's first method fails.

NumPy's method divides and conquers.  On rare matrices, all of whose numbers are
ordinary, it does not converge; the older method by QR steps does.
"""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector


class Decomposition(NamedTuple):
    """``A = U diag(s) Vt``, with `s` from the largest to the smallest."""

    U: Matrix
    s: Vector
    Vt: Matrix


def svd(A: Matrix, *, full_matrices: bool = True) -> Decomposition:
    """Return the singular value decomposition of a matrix.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a number is not finite.

    Examples
    --------
    >>> svd(np.diag([1.0, 3.0])).s
    array([3., 1.])
    """
    try:
        return Decomposition(*np.linalg.svd(A, full_matrices=full_matrices))
    except np.linalg.LinAlgError:
        if not np.isfinite(A).all():
            raise
    from scipy.linalg import svd as decomposed

    parts = decomposed(A, full_matrices=full_matrices, lapack_driver="gesvd")
    return Decomposition(*map(np.asarray, parts))


def singular_values(A: Matrix) -> Vector:
    """Return the singular values of a matrix, the largest first."""
    try:
        return np.asarray(np.linalg.svd(A, compute_uv=False))
    except np.linalg.LinAlgError:
        return svd(A, full_matrices=False).s


def lstsq(A: Matrix, b: Array, rcond: float | None = None) -> Array:
    """Return the smallest solution of ``min ||A x - b||``.

    Parameters
    ----------
    b : ndarray, shape (rows,) or (rows, right-hand sides)
    rcond : float, optional
        Singular values below this, relative to the largest, count as zero; by default
        NumPy's tolerance.
    """
    try:
        return np.asarray(np.linalg.lstsq(A, b, rcond=rcond)[0])
    except np.linalg.LinAlgError:
        U, s, Vt = svd(A, full_matrices=False)
    least = np.finfo(float).eps * max(A.shape) if rcond is None else rcond
    rank = int((s > least * s[0]).sum())
    return np.asarray((Vt[:rank].T / s[:rank]) @ (U[:, :rank].T @ b))


def pinv(A: Matrix, rcond: float = 1e-15) -> Matrix:
    """Return the pseudo-inverse of a matrix; `rcond` as of `lstsq`."""
    try:
        return np.asarray(np.linalg.pinv(A, rcond=rcond))
    except np.linalg.LinAlgError:
        return np.asarray(lstsq(A, np.eye(len(A)), rcond))
