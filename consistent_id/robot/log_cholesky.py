"""Inertial parameters without constraints: the log-Cholesky parametrisation.

Any ten variables ``theta`` give physically consistent parameters with mass and
thickness, and each of those has one ``theta`` [Rucker2022]_.  In the central form

``m = exp(theta_0)``, ``c = theta_1..3``, central second moments ``m L L^T``

=====  ==========================================================
index  variable
=====  ==========================================================
0      ``log m``
1-3    ``cx, cy, cz``
4-6    ``log L11, log L22, log L33``
7-9    ``L21, L31, L32``, of the lower triangular ``L``
=====  ==========================================================

so that a mass or a centre of mass that is known is a variable left out.  The
pseudo-inertia is ``J = m [[L L^T + c c^T, c], [c^T, 1]]``, positive definite whatever
``theta``.  Flat bodies lie infinitely far away: ``log Lii -> -inf``.

The map keeps units: with masses and lengths in typical ones, so are its variables.
"""

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, frozen
from consistent_id.errors import ModelError
from consistent_id.robot.inertia import inertial_vector, pseudo_inertia

MASS, COM, DIAGONAL, BELOW = 0, slice(1, 4), slice(4, 7), slice(7, 10)
"""Places of ``log m``, ``c``, ``log Lii`` and the entries of ``L`` below them."""

# Rows and columns of L at which variables 4..9 stand.
_ROWS, _COLUMNS = (0, 1, 2, 1, 2, 2), (0, 1, 2, 0, 0, 1)


def body_from_log_cholesky(theta: ArrayLike) -> Array:
    """Return the inertial parameters of the bodies with these variables.

    Parameters
    ----------
    theta : array_like, shape (..., 10)
        In the order of this module, [log kg, m, log m, m].

    Returns
    -------
    ndarray, shape (..., 10)
        In the convention of `consistent_id.robot.inertia`.

    Examples
    --------
    >>> print(body_from_log_cholesky([0, 0.5, 0, 0, *np.log([0.1, 0.1, 0.1]), 0, 0, 0]))
    [1.   0.5  0.   0.   0.02 0.   0.27 0.   0.   0.27]
    """
    return inertial_vector(_pseudo_inertia(np.asarray(theta, dtype=np.float64)))


def log_cholesky_jacobian(theta: ArrayLike) -> Array:
    """Return the derivatives of `body_from_log_cholesky`, exactly.

    With ``T = [[1, c], [0, 1]]`` and ``J = m T diag(L L^T, 1) T^T``:

    ``dJ/d log m = J``, ``dJ/dc_i = m (e_i (c, 1)^T + (c, 1) e_i^T)`` and
    ``dJ/dL_ij = m (e_i l_j^T + l_j e_i^T)``, ``l_j`` the columns of ``L``.

    Returns
    -------
    ndarray, shape (..., 10, 10)
        Rows: inertial parameters; columns: variables.
    """
    theta = np.asarray(theta, dtype=np.float64)
    L = _factor(theta)
    d = np.zeros((*theta.shape, 4, 4))  # dJ, one matrix per variable
    d[..., MASS, :, :] = _pseudo_inertia(theta)
    mass = np.exp(theta[..., MASS])[..., None]
    for i in range(3):
        d[..., 1 + i, i, :3] = mass * theta[..., COM]
        d[..., 1 + i, i, 3] = mass[..., 0]
    for index, (i, j) in enumerate(zip(_ROWS, _COLUMNS, strict=True), start=4):
        own = L[..., i, j, None] if i == j else 1.0  # dLii / d log Lii
        d[..., index, i, :3] = mass * own * L[..., :, j]
    rest = d[..., 1:, :, :]
    d[..., 1:, :, :] = rest + np.swapaxes(rest, -1, -2)
    return np.swapaxes(inertial_vector(d), -1, -2)


def log_cholesky_from_body(vector: ArrayLike) -> Array:
    """Return the variables of a body: the inverse of `body_from_log_cholesky`.

    Parameters
    ----------
    vector : array_like, shape (10,)
        Inertial parameters with a positive definite pseudo-inertia.

    Raises
    ------
    ModelError
        If they are not consistent, or without mass or thickness.
    """
    J = pseudo_inertia(frozen(vector, (10,), "inertial parameters", ModelError))
    mass = J[3, 3]
    if mass <= 0.0:
        raise ModelError(f"the mass is {mass:g} kg, expected more than zero")
    c = J[:3, 3] / mass
    try:
        L = np.linalg.cholesky(J[:3, :3] / mass - np.outer(c, c))
    except np.linalg.LinAlgError:
        raise ModelError(
            "the parameters are flat or not consistent: their pseudo-inertia has "
            "eigenvalues "
            f"from {np.linalg.eigvalsh(J)[0]:.1e}, expected more than zero"
        ) from None
    entries = L[_ROWS, _COLUMNS]
    entries[:3] = np.log(entries[:3])
    return np.concatenate([[np.log(mass)], c, entries])


def _factor(theta: Array) -> Array:
    L = np.zeros((*theta.shape[:-1], 3, 3))
    L[..., _ROWS[:3], _COLUMNS[:3]] = np.exp(theta[..., DIAGONAL])
    L[..., _ROWS[3:], _COLUMNS[3:]] = theta[..., BELOW]
    return L


def _pseudo_inertia(theta: Array) -> Array:
    """``J = C C^T`` with ``C = sqrt(m) [[L, c], [0, 1]]``: no difference is taken."""
    C = np.zeros((*theta.shape[:-1], 4, 4))
    C[..., :3, :3] = _factor(theta)
    C[..., :3, 3] = theta[..., COM]
    C[..., 3, 3] = 1.0
    mass = np.exp(theta[..., MASS])[..., None, None]
    return np.asarray(mass * (C @ np.swapaxes(C, -1, -2)))
