"""The free parameters of a model under equalities."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints import Constraint, lowered
from consistent_id.regression.linear import (
    DATA_RANK_TOLERANCE,
    smallest_solution,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

_RANK = 1e-12  # of equalities, relative to the largest singular value


@dataclass(frozen=True, slots=True, eq=False)
class FreeParameters:
    """Parameters ``x = start + directions y`` that meet all equalities.

    Parameters
    ----------
    start : ndarray, shape (parameters,)
    directions : ndarray, shape (parameters, free)
    """

    start: Vector
    directions: Matrix

    @staticmethod
    def of(constraints: Sequence[Constraint], model: TorqueModel) -> "FreeParameters":
        """Return the parameters that the equalities among constraints leave free."""
        known = lowered(constraints, model)
        width = len(model.layout)
        if not len(known.A_eq):
            return FreeParameters(np.zeros(width), np.eye(width))
        scale = np.linalg.norm(known.A_eq, axis=1, keepdims=True)
        A, b = known.A_eq / scale, known.b_eq / scale[:, 0]
        _, s, Vt = np.linalg.svd(A)
        rank = int((s > _RANK * s[0]).sum())
        return FreeParameters(np.linalg.lstsq(A, b, rcond=None)[0], Vt[rank:].T)

    def determined(self, regression: Regression) -> "FreeParameters":
        """Return the part of the free parameters that data determine."""
        return self.spanned(regression.stacked()[:, :-1] @ self.directions)

    def spanned(self, A: Matrix) -> "FreeParameters":
        """Return the part of the free parameters that rows determine.

        Parameters
        ----------
        A : ndarray, shape (rows, free)
        """
        scale = np.linalg.norm(A, axis=0)
        unit = np.where(scale > 0.0, scale, 1.0)
        _, s, Vt = np.linalg.svd(A / unit, full_matrices=False)
        kept = Vt[s > DATA_RANK_TOLERANCE * s[0]].T if len(s) else Vt.T
        return FreeParameters(self.start, self.directions @ (kept / unit[:, None]))

    def misfit(self, regression: Regression) -> float:
        """Return the least weighted squared misfit over all free parameters."""
        stacked = regression.stacked()
        A, rest = self.reduced(stacked[:, :-1], stacked[:, -1])
        return float(((rest - A @ least_squares(A, rest)) ** 2).sum())

    def reduced(self, Y: Matrix, tau: Vector) -> tuple[Matrix, Vector]:
        """Return rows and their right-hand side in the free directions."""
        return Y @ self.directions, tau - Y @ self.start

    def moves(self, A: Matrix) -> Vector:
        """Return the change of each parameter for which ``||A y||^2`` rises by one.

        These are standard errors for white noise of level one.

        Parameters
        ----------
        A : ndarray, shape (rows, free)
            Rows, of full rank.
        """
        scale = np.linalg.norm(A, axis=0)
        steps = np.linalg.inv(np.linalg.qr(A / scale, mode="r")) / scale[:, None]
        return np.asarray(np.linalg.norm(self.directions @ steps, axis=1))


def least_squares(A: Matrix, b: Vector) -> Vector:
    """Return the smallest solution in unit columns."""
    return smallest_solution(A, b, _RANK)
