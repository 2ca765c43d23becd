"""Triangular factors by QR, in place."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix

_BLOCK = 32  # columns that LAPACK eliminates at a time, of wide matrices
_PANEL = 8  # columns that a QR eliminates at a time: 4 to 16 are equally fast


def extended(R: Matrix, rows: Matrix) -> Matrix:
    """Return the triangular factor of a triangular factor and more rows below it.

    Both are destroyed.  With a whole triangle on top, its zeros are not worked on.
    """
    width = R.shape[1]
    if len(R) + len(rows) < width:
        return triangle(np.vstack([R, rows]))
    if len(R) < width:
        R, above = np.zeros((width, width), order="F"), R
        R[: len(above)] = above
    panel = min(_PANEL, width)
    factor, *_ = _tpqrt()(0, panel, R, rows, overwrite_a=1, overwrite_b=1)
    return np.asarray(factor)


def triangle(rows: Matrix) -> Matrix:
    """Return the triangular factor of a QR decomposition, destroying `rows`."""
    if len(rows) == 0:
        return rows
    # With room for blocks of columns; SciPy's default is three columns.
    R, *_ = _geqrf()(rows, overwrite_a=1, lwork=_BLOCK * max(rows.shape[1], 1))
    R = R[: rows.shape[1]]
    return np.where(_upper(*R.shape), R, 0.0)


@lru_cache(maxsize=64)
def _upper(rows: int, columns: int) -> BoolArray:
    # numpy.triu makes this mask each time, which takes as long as a small QR.
    return np.tri(columns, rows, dtype=bool).T


@lru_cache(maxsize=1)
def _tpqrt() -> Callable[..., tuple[Any, ...]]:
    from scipy.linalg.lapack import dtpqrt

    return dtpqrt  # type: ignore[no-any-return]


@lru_cache(maxsize=1)
def _geqrf() -> Callable[..., tuple[Any, ...]]:
    # numpy.linalg.qr copies twice; LAPACK's own routine works in place.
    from scipy.linalg.lapack import dgeqrf

    return dgeqrf  # type: ignore[no-any-return]
