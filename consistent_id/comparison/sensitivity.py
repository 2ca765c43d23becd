"""How a constrained estimate follows the data: covariance on active constraints.

At the optimum ``u`` of ``1/2 ||M u - z||^2 + weight/2 distance(u)^2`` the active
constraints leave a tangent space ``T``: steps that keep equalities, inequalities that
hold as such, and the rank of each pseudo-inertia, to first order.  It is all of the
answer unless a constraint is only just active, with a multiplier of zero.
Along it, with the Hessian ``H`` of the Lagrangian,

``du = T (T^T H T)^-1 T^T ds``  for a change ``ds`` of the scores ``M^T z``

so a covariance ``S`` of the scores becomes one of the parameters [Shapiro1997]_.  ``H``
contains what bends a semidefinite block's surface, ``2 tr(Z dF F^+ dF)``.

All of these are Gram matrices, ``H = A^T A`` and ``S = g^T g``, of which only the
factors are formed: a faint prior leaves nothing of ``H`` itself but rounding.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints.cones.matrices import svec
from consistent_id.constraints.cones.row_spaces import row_spaces
from consistent_id.constraints.cones.sets import SemidefiniteBlock
from consistent_id.errors import ProblemError
from consistent_id.estimation.constrained_fit import ConstrainedFit
from consistent_id.estimation.scaled_fit import base_factor
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression

_ACTIVE = 1e-6  # slack, or eigenvalue, of typical parameters that counts as none


def covariance(fitted: ConstrainedFit, scores: Matrix) -> Matrix:
    """Return the covariance of a constrained estimate's parameters.

    Parameters
    ----------
    scores : ndarray, shape (rows, parameters)
        Factor ``g`` of the scores' covariance ``g^T g``; see `white_scores` and
        `segment_scores`.

    Returns
    -------
    ndarray, shape (parameters, parameters)
        In original units.  Of what the prior settles it is the estimate's scatter,
        not its error: a firm belief hardly moves.
    """
    root = _response_root(fitted)
    moves = (root @ (root.T @ scores.T)) * fitted.best.scaled.unit[:, None]
    return np.asarray(moves @ moves.T)


def white_scores(
    fitted: ConstrainedFit, regression: Regression, base: BaseParameters, sigma: Vector
) -> Matrix:
    """Return a factor of the scores' covariance for white noise of each joint.

    Parameters
    ----------
    sigma : ndarray, shape (joints,), [N m or N]
        Standard deviation of each joint's noise.

    Returns
    -------
    ndarray, shape (rows, parameters)
    """
    scaled, columns = fitted.best.scaled, list(base.independent)
    rows = [
        factor[:, columns] * (noise / weight**2 / scaled.size**2)
        for factor, weight, noise in zip(
            regression.factors, regression.sigma, sigma, strict=True
        )
    ]
    return np.asarray(np.vstack(rows) @ scaled.projection)


def shift_scores(
    fitted: ConstrainedFit,
    parts: Sequence[Regression],
    base: BaseParameters,
    deviations: Vector,
) -> Matrix:
    """Return a factor of the scores' covariance for shifts of the base parameters.

    Parameters
    ----------
    parts : sequence of Regression
        Data whose parameters are shifted by amounts of their own.
    deviations : ndarray, shape (base,)
        Standard deviation of the shifts.

    Returns
    -------
    ndarray, shape (rows, parameters)
    """
    scaled = fitted.best.scaled
    rows = []
    for part in parts:
        A = base_factor(part, base)[:, :-1] / scaled.size
        rows.append(deviations[:, None] * (A.T @ A))
    return np.asarray(np.vstack(rows) @ scaled.projection)


def segment_scores(
    fitted: ConstrainedFit,
    segments: Sequence[Regression],
    base: BaseParameters,
    sources: Sequence[int] | None = None,
) -> Matrix:
    """Return a factor of the scores' covariance, from their scatter between segments.

    The covariance is ``k / (k - 1) sum_s g_s g_s^T`` with ``g_s`` the gradient of
    segment ``s`` of ``k``, less their mean: robust to correlation within segments and
    to noise that is not alike.  If they are from several recordings (`sources`), it is
    the sum over these, each with its own mean.

    Returns
    -------
    ndarray, shape (segments, parameters)

    Raises
    ------
    ProblemError
        If there are fewer than two segments.
    """
    if len(segments) < 2:
        raise ProblemError(f"{len(segments)} segments, expected 2 or more")
    scaled, u = fitted.best.scaled, fitted.final.solution.u
    gradients = []
    for segment in segments:
        part = scaled.with_factor(base_factor(segment, base))
        gradients.append(part.M.T @ (part.M @ u - part.z))
    g = np.array(gradients)
    owners = np.zeros(len(g)) if sources is None else np.asarray(sources)
    for owner in np.unique(owners):
        own, k = owners == owner, int(np.sum(owners == owner))
        g[own] = (g[own] - g[own].mean(axis=0)) * np.sqrt(k / max(k - 1, 1))
    return g


def _response_root(fitted: ConstrainedFit) -> Matrix:
    """Return ``B`` with ``B B^T = T (T^T H T)^-1 T^T``."""
    scaled, fit = fitted.best.scaled, fitted.final
    u, multipliers = fit.solution.u, fit.solution.multipliers
    rows = [scaled.M, np.sqrt(fit.weight) * fitted.distance.local(u).G]
    domain = scaled.domain
    slack = domain.b_in - domain.A_in @ u
    active = [domain.A_eq, domain.A_in[slack <= _ACTIVE]]
    for block, Z in zip(domain.blocks, multipliers.blocks, strict=True):
        kept, bent = _surface(block, Z, u)
        active.append(kept)
        rows.append(bent)
    T = row_spaces(np.vstack(active)).steps
    _, R = np.linalg.qr(np.vstack(rows) @ T)
    return np.asarray(np.linalg.solve(R.T, T.T).T)


def _surface(block: SemidefiniteBlock, Z: Matrix, u: Vector) -> tuple[Matrix, Matrix]:
    """Return rows that keep a block's rank, and rows of its surface's curvature."""
    values, vectors = np.linalg.eigh(block.value(u))
    touching = values <= _ACTIVE
    null, rest = vectors[:, touching], vectors[:, ~touching]
    kept = svec(null.T @ block.coefficients @ null).T
    # 2 tr(Z A_i F^+ A_j) with Z = N N^T and F^+ = V V^T: rows sqrt(2) (V^T A_i N).
    weights, turned = np.linalg.eigh(null.T @ Z @ null)
    N = null @ turned * np.sqrt(np.maximum(weights, 0.0))
    V = rest / np.sqrt(values[~touching])
    bent = np.sqrt(2.0) * (V.T @ block.coefficients @ N)
    return kept, bent.reshape(len(bent), -1).T
