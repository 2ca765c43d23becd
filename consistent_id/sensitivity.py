"""How a constrained estimate follows the data: covariance on active constraints.

At the optimum ``u`` of ``1/2 ||M u - z||^2 + weight/2 distance(u)^2`` the active
constraints leave a tangent space ``T``: steps that keep equalities and inequalities
that hold with multipliers, and keep each pseudo-inertia's null space where it is.
Along it, with the Hessian ``H`` of the Lagrangian,

``du = T (T^T H T)^-1 T^T ds``  for a change ``ds`` of the scores ``M^T z``

so a covariance ``S`` of the scores becomes one of the parameters [Shapiro1997]_.  ``H``
contains what bends a semidefinite block's surface, ``2 tr(Z dF F^+ dF)``.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._arrays import Matrix, Vector
from consistent_id.base import BaseParameters
from consistent_id.certificate import null_space
from consistent_id.cones import svec
from consistent_id.conic import SemidefiniteBlock
from consistent_id.estimators.scaled_fit import base_factor
from consistent_id.estimators.settled import Settled
from consistent_id.regression import Regression

_ACTIVE = 1e-6  # slack, or eigenvalue, of typical parameters that counts as none


def covariance(settled: Settled, scores: Matrix) -> Matrix:
    """Return the covariance of a constrained estimate's parameters.

    Parameters
    ----------
    settled : Settled
    scores : ndarray, shape (parameters, parameters)
        Covariance of the scores; see `white_scores` and `segment_scores`.

    Returns
    -------
    ndarray, shape (parameters, parameters)
        In original units.  Of what the prior settles it is the estimate's scatter,
        not its error: a firm belief hardly moves.
    """
    response = _response(settled) * settled.best.scaled.unit[:, None]
    return np.asarray(response @ scores @ response.T)


def white_scores(
    settled: Settled, regression: Regression, base: BaseParameters, sigma: Vector
) -> Matrix:
    """Return the scores' covariance for white noise of each joint.

    Parameters
    ----------
    settled : Settled
    regression : Regression
    base : BaseParameters
    sigma : ndarray, shape (joints,), [N m or N]
        Standard deviation of each joint's noise.
    """
    scaled, columns = settled.best.scaled, list(base.independent)
    total = np.zeros((len(scaled.unit),) * 2)
    for factor, weight, noise in zip(
        regression.factors, regression.sigma, sigma, strict=True
    ):
        rows = factor[:, columns] @ scaled.projection
        rows = rows * (noise / weight**2 / scaled.size**2)
        total += rows.T @ rows
    return total


def segment_scores(
    settled: Settled, segments: Sequence[Regression], base: BaseParameters
) -> Matrix:
    """Return the scores' covariance from their scatter between segments.

    ``k / (k - 1) sum_s g_s g_s^T`` with ``g_s`` the gradient of segment ``s`` of ``k``:
    robust to correlation within segments and to noise that is not alike.
    """
    scaled, u = settled.best.scaled, settled.fit.solution.u
    gradients = []
    for segment in segments:
        part = scaled.with_factor(base_factor(segment, base))
        gradients.append(part.M.T @ (part.M @ u - part.z))
    g = np.array(gradients)
    g = g - g.mean(axis=0)
    return np.asarray(g.T @ g * len(g) / (len(g) - 1))


def _response(settled: Settled) -> Matrix:
    """Return ``T (T^T H T)^-1 T^T``."""
    scaled, fit = settled.best.scaled, settled.fit
    u, multipliers = fit.solution.u, fit.solution.multipliers
    rows = np.sqrt(fit.weight) * settled.distance.local(u).G
    H = scaled.M.T @ scaled.M + rows.T @ rows
    domain = scaled.domain
    slack = domain.b_in - domain.A_in @ u
    held = [domain.A_eq, domain.A_in[slack <= _ACTIVE]]
    for block, Z in zip(domain.blocks, multipliers.blocks, strict=True):
        kept, bent = _surface(block, Z, u)
        held.append(kept)
        H = H + bent
    T = null_space(np.vstack(held))
    return np.asarray(T @ np.linalg.solve(T.T @ H @ T, T.T))


def _surface(block: SemidefiniteBlock, Z: Matrix, u: Vector) -> tuple[Matrix, Matrix]:
    """Return rows that keep a block's rank, and the curvature of its surface."""
    values, vectors = np.linalg.eigh(block.value(u))
    null, rest = vectors[:, values <= _ACTIVE], vectors[:, values > _ACTIVE]
    kept = svec(null.T @ block.coefficients @ null).T
    inverse = (rest / values[values > _ACTIVE]) @ rest.T
    # 2 tr(Z A_i F^+ A_j) with Z = N N^T.
    root = null @ np.linalg.cholesky(_definite(null.T @ Z @ null))
    across = block.coefficients @ root
    bent = 2.0 * np.einsum("iab,ac,jcb->ij", across, inverse, across)
    return kept, bent


def _definite(Z: Matrix) -> Matrix:
    """Return a symmetric matrix with eigenvalues raised above rounding."""
    values, vectors = np.linalg.eigh((Z + Z.T) / 2)
    return np.asarray((vectors * np.maximum(values, 1e-300)) @ vectors.T)
