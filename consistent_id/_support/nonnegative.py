"""Small least-squares problems of which some unknowns must not be negative."""

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector

_STEEP = 1e-12  # slope over the sizes it is made of: less is rounding


def nonnegative_least_squares(
    A: Matrix, b: Vector, nonnegative: BoolArray, *, guess: BoolArray | None = None
) -> Vector:
    """Return the `x` with least ``||A x - b||`` and the marked entries zero or more.

    The active-set method of [LawsonHanson1974]_, without the import of scipy.optimize.

    Parameters
    ----------
    A : ndarray, shape (rows, columns)
        With columns of about unit length.
    b : ndarray, shape (rows,)
    nonnegative : ndarray of bool, shape (columns,)
    guess : ndarray of bool, shape (columns,), optional
        Which of them may not be zero, to begin with.

    Examples
    --------
    >>> A, b = np.eye(2), np.array([1.0, -1.0])
    >>> nonnegative_least_squares(A, b, np.array([True, True])).tolist()
    [1.0, 0.0]
    """
    x = np.zeros(A.shape[1])
    moving = ~nonnegative if guess is None else ~nonnegative | guess
    enough = _STEEP * float(np.linalg.norm(b))
    for _ in range(3 * len(x) + 1):
        x = _inside(A, b, x, moving, nonnegative)
        slopes = np.where(moving, -np.inf, A.T @ (b - A @ x))
        if moving.all() or slopes.max() <= enough:
            break
        moving[np.argmax(slopes)] = True
    return x


def _inside(
    A: Matrix, b: Vector, x: Vector, moving: BoolArray, nonnegative: BoolArray
) -> Vector:
    """Go to the optimum of the moving unknowns; those that reach zero stop there."""
    while True:
        aim = np.zeros(len(x))
        aim[moving] = np.linalg.lstsq(A[:, moving], b, rcond=None)[0]
        below = moving & nonnegative & (aim <= 0.0)
        if not below.any():
            return aim
        shares = x[below] / np.maximum(x[below] - aim[below], 1e-300)
        x = x + shares.min() * (aim - x)
        stopped = np.flatnonzero(below)[shares <= shares.min()]
        x[stopped] = 0.0
        moving[stopped] = False
