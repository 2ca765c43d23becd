"""The information that a path's variables stand for, with its pull-back.

    M = (recorded / sampled) sum_rows  w w^T / noise^2  +  earlier

over the rows ``w`` of the base regressor at the sampled times: what a recording of the
path tells of the base parameters, and what is known of them already.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.kernels import RegressorKernel


class Informed(NamedTuple):
    """An information matrix, and how its gradient becomes that of the variables."""

    matrix: Matrix
    pull: Callable[[Matrix], Matrix]


class PathInformation:
    """Maps the variables of a path to the information it gives.

    Parameters
    ----------
    basis : FourierBasis
    kernel : RegressorKernel
    time : ndarray, shape (samples,), [s]
    noise : ndarray, shape (torque joints,), [N m or N]
    recorded : float
        Samples that will be recorded, for which the sampled ones stand.
    earlier : ndarray, shape (base parameters, base parameters)
    """

    def __init__(
        self,
        basis: FourierBasis,
        kernel: RegressorKernel,
        time: Vector,
        *,
        noise: Vector,
        recorded: float,
        earlier: Matrix,
    ) -> None:
        self._basis, self._kernel, self._earlier = basis, kernel, earlier
        self._columns = np.array([basis.columns(order, time) for order in range(3)])
        self._weights = recorded / len(time) / noise**2

    def __call__(self, variables: Matrix) -> Informed:
        """Return the information of a path, and its pull-back."""
        basis = self._basis
        motion = self._columns @ (variables[1:] * basis.unit)
        motion[0] += basis.offset(variables)
        W = self._kernel.regressor(motion)
        weighted = W * self._weights[:, None, None]
        rows = W.shape[0] * W.shape[1]
        M = W.reshape(rows, -1).T @ weighted.reshape(rows, -1)

        def pull(gradient: Matrix) -> Matrix:
            seed: Array = 2.0 * (weighted.reshape(rows, -1) @ gradient).reshape(W.shape)
            slopes = self._kernel.pull(motion, seed)
            parts = [basis.pull(i, self._columns[i], slopes[i]) for i in range(3)]
            return np.asarray(np.sum(parts, axis=0))

        return Informed(M + self._earlier, pull)
