"""How least squares moves with the gains that made torque of currents."""

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import Regression


def gain_slopes(regression: Regression, base: BaseParameters) -> Matrix:
    """Return the derivative of the base parameters by the logarithm of each gain.

    The torque of a joint is proportional to its gain, and the solution is linear in the
    torques: with ``x = A^+ b`` the slope of joint ``j`` is ``A^+ b_j``, where ``b_j``
    has the rows of that joint alone.

    Parameters
    ----------
    regression : Regression
        With its weights, which are held.

    Returns
    -------
    ndarray, shape (base parameters, joints)
    """
    scaled = [F / s for F, s in zip(regression.factors, regression.sigma, strict=True)]
    A = np.vstack([own[:, list(base.independent)] for own in scaled])
    torque = np.zeros((len(A), len(scaled)))
    first = 0
    for place, own in enumerate(scaled):
        torque[first : first + len(own), place] = own[:, -1]
        first += len(own)
    return smallest_solution(A, torque)
