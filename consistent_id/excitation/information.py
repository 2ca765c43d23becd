"""The information that a path's variables stand for, with its pull-back.

    M = (recorded / samples) sum_rows  w w^T / noise^2  +  earlier

over the rows ``w`` of the base regressor at the sampled times: what a recording of the
path adds to what is known of the base parameters already.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.kernels import RegressorKernel, slow_speeds
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.row_model import RowModel


class Information(NamedTuple):
    """An information matrix, and how its gradient becomes that of the variables."""

    matrix: Matrix
    pull: Callable[[Matrix], Matrix]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class PathInformation:
    """Maps the variables of a path to the information it gives.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    base : BaseParameters
    basis : FourierBasis
    samples : int
        Of a path at which the regressor is taken.
    recorded : float
        Samples that will be recorded, for which the sampled ones stand.
    noise : ndarray, shape (torque joints,), [N m or N]
    earlier : ndarray, shape (base parameters, base parameters)
        Information there is already.
    """

    model: RowModel
    base: BaseParameters
    basis: FourierBasis
    samples: int
    recorded: float
    noise: Vector
    earlier: Matrix

    def __call__(self, variables: Matrix) -> Information:
        """Return the information of a path; the last one is remembered."""
        if self not in _EVALUATORS:
            _EVALUATORS[self] = _Evaluator(self)
        return _EVALUATORS[self](variables)


class _Evaluator:
    """The compiled regressor of a `PathInformation`, and the last information."""

    def __init__(self, of: PathInformation) -> None:
        basis, count = of.basis, of.samples
        time = np.arange(count) * basis.duration / count
        self._basis, self._earlier = basis, of.earlier
        self._kernel = RegressorKernel(
            of.model, of.base, count, slow_speeds(basis.limits)
        )
        self._columns = np.array([basis.columns(order, time) for order in range(3)])
        self._weights = of.recorded / count / of.noise**2
        self._last: tuple[Matrix, Information] | None = None

    def __call__(self, variables: Matrix) -> Information:
        if self._last is None or not np.array_equal(self._last[0], variables):
            self._last = variables.copy(), self._evaluated(variables)
        return self._last[1]

    def _evaluated(self, variables: Matrix) -> Information:
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

        return Information(M + self._earlier, pull)


# CasADi functions on memory of their own, which go to no other process.
_EVALUATORS: WeakKeyDictionary[PathInformation, _Evaluator] = WeakKeyDictionary()
