"""How far parameters move with what is taken for granted: another part of their errors.

Where a foot touches, or how late a channel is, is known with an error of its own, which
no scatter of the estimate shows.  The same recordings are prepared once more with it
changed by its standard error; the parameters of least squares move by theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.estimation.equalities import FreeParameters, least_squares
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class ParameterShifts:
    """What errors of things taken for granted add to those of parameters.

    Parameters
    ----------
    variance : ndarray, shape (parameters,)
        Sum of the squared shifts.
    squared_misfit : ndarray, shape (parameters,)
        What moving each parameter by the root of its variance adds to the weighted
        squared misfit, with equalities held.
    count : int
        How many things were changed.
    """

    variance: Vector
    squared_misfit: Vector
    count: int

    @property
    def sentence(self) -> str:
        """What standard errors contain."""
        return (
            f"What {self.count} changes of what is taken for granted move is added, "
            "each a standard error"
        )


def parameter_shifts(
    model: TorqueModel,
    whole: Regression,
    variants: Sequence[Regression],
    constraints: Sequence[Constraint],
) -> ParameterShifts | None:
    """Find the shifts of parameters between recordings and their variants.

    Parameters
    ----------
    model : TorqueModel
    whole : Regression
        Its `sigma` are the weights.
    variants : sequence of Regression
        Of the same recordings, each with one thing changed by its standard error.
    constraints : sequence of Constraint
        Of these the equalities count.

    Returns
    -------
    ParameterShifts or None
        None if there are no variants.
    """
    if not variants:
        return None
    free = FreeParameters.of(constraints, model).determined(whole)
    A, rest = free.reduced(*_rows(whole))
    best = least_squares(A, rest)
    moved = [
        free.directions
        @ (least_squares(*free.reduced(*_rows(v.weighted(whole.sigma)))) - best)
        for v in variants
    ]
    variance = np.sum(np.square(moved), axis=0)
    unit = free.moves(A)
    known = unit > 0.0
    return ParameterShifts(
        variance, variance * known / np.where(known, unit, 1.0) ** 2, len(moved)
    )


def _rows(regression: Regression) -> tuple[np.ndarray, Vector]:
    stacked = regression.stacked()
    return stacked[:, :-1], stacked[:, -1]
