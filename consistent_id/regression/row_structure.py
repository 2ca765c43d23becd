"""Which columns of a joint's rows are independent, and how they give all others."""

from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix
from consistent_id.regression.independent_columns import STRUCTURAL_TOLERANCE
from consistent_id.regression.random_rows import random_rows
from consistent_id.regression.regressor import TorqueModel


@lru_cache(maxsize=16)
def row_structure(
    model: TorqueModel, *, mixed: bool = False
) -> tuple[tuple[IntArray, Matrix], ...]:
    """Return, per joint, its row's independent columns and how they give all others.

    A row of joint ``j`` is zero beyond its descendants, and of the rest about half are
    combinations of others for every motion; only independent columns are factorised,
    chosen by pivoting so that the others follow without loss of digits.

    Parameters
    ----------
    mixed : bool
        Whether rows hold parts of all others, see `ContactMixing`.
    """
    p, inertial = len(model.layout), model.layout.inertial_size
    structure: list[tuple[IntArray, Matrix]] = []
    found, count = random_rows(model), len(model.torque_joints)
    rows = [found.stacked()] if mixed else [found.dense(row) for row in range(count)]
    for row in rows:
        kept, K = _pivoted_columns(row[:, :inertial])
        drive = [i for i in range(inertial, p) if row[:, i].any()]
        expand = np.zeros((len(kept) + len(drive), p))
        expand[: len(kept), :inertial] = K
        expand[range(len(kept), len(expand)), drive] = 1.0
        structure.append((np.array([*kept, *drive], dtype=np.intp), expand))
    return tuple(structure * count if mixed else structure)


def _pivoted_columns(W: Matrix) -> tuple[list[int], Matrix]:
    """Return independent columns and the map ``K`` with ``W = W[:, kept] K``."""
    from scipy.linalg import qr, solve_triangular

    norms = np.linalg.norm(W, axis=0)
    if not norms.any():
        return [], np.zeros((0, W.shape[1]))
    unit = np.where(norms > 0.0, norms, 1.0)
    R, order = qr(W / unit, mode="r", pivoting=True)
    size = abs(np.diag(R))
    rank = int((size > STRUCTURAL_TOLERANCE * size[0]).sum())
    kept = order[:rank]
    K = np.zeros((rank, W.shape[1]))
    K[:, order] = solve_triangular(R[:rank, :rank], R[:rank])
    K = K * unit / unit[kept, None]
    K[:, kept] = np.eye(rank)
    return kept.tolist(), K
