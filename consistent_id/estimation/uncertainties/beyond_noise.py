"""Errors of parameters beyond noise: scatter between blocks, and known shifts.

Friction that balances contact forces in joints at rest, and feet that creep, cause
errors that are correlated over seconds, but differ within a motion.  Noise and its
correlation do not show their size; parameters from blocks of the motion do, see
`block_scatter`.

The contact point of a foot and the delay of a channel have errors that cause no scatter
of the estimate.  The recordings are prepared again with such a value changed by its
standard error; the shift of the least-squares parameters is their error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.estimation.uncertainties.block_scatter import (
    BLOCKS,
    BlockScatter,
    block_scatter,
)
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import NORMAL, ResidualNoise, joint_noise
from consistent_id.regression.segments import merged

_LEVEL = 0.975  # quantile of intervals of 95 %


@dataclass(frozen=True, slots=True, eq=False)
class FloatingBlocks:
    """Blocks of a recording, and the scatter of parameters between them.

    Parameters
    ----------
    between : ndarray, shape (parameters,)
        Standard deviation between blocks, beyond noise; zero for fixed parameters.
    unit : ndarray, shape (parameters,)
        Change of a parameter if the weighted squared misfit rises by one, under the
        equalities; zero for parameters that are fixed or do not differ.
    """

    scatter: BlockScatter
    between: Vector
    unit: Vector

    @property
    def variance(self) -> Vector:
        """Contribution of the scatter to the variance of each parameter's mean."""
        return np.asarray(self.between**2 / self.scatter.blocks)

    @property
    def squared_misfit(self) -> Vector:
        """Increase of the squared misfit for moves by the roots of `variance`."""
        free = self.unit > 0.0
        return np.asarray(self.variance * free / np.where(free, self.unit, 1.0) ** 2)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the scatter."""
        return self.scatter.blocks - 1.0

    @property
    def quantile(self) -> float:
        """Standard errors either way for 95 %, as if the scatter were all of them."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, _LEVEL)) if self.freedom > 0.0 else NORMAL

    @property
    def sentence(self) -> str:
        """The content of standard errors, as a sentence."""
        return (
            f"The scatter of parameters between {self.scatter.blocks} blocks, beyond "
            f"noise, is included: 95 % intervals are {self.quantile:.2f} "
            f"standard errors either way"
        )


def floating_blocks(
    model: TorqueModel,
    segments: Sequence[Regression],
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> FloatingBlocks | None:
    """Return the scatter between blocks; None if a block does not determine parameters.

    Parameters
    ----------
    segments : sequence of Regression
        Segments of one recording, in the order of time.
    """
    count = min(BLOCKS, len(segments))
    parts = [
        merged([segments[i] for i in few])
        for few in np.array_split(range(len(segments)), count)
    ]
    level = joint_noise(model, merged(parts), base=base)
    weighted = [part.weighted(level) for part in parts]
    try:
        found = block_scatter(model, weighted, constraints=constraints)
    except NotExcitedError:
        return None
    between = np.zeros(len(model.layout))
    between[[model.layout.index(name) for name in found.names]] = found.between
    free = FreeParameters.of(constraints, model)
    unit = free.moves(merged(segments).stacked()[:, :-1] @ free.directions)
    unit[between == 0.0] = 0.0
    return FloatingBlocks(found, between, unit)


@dataclass(frozen=True, slots=True, eq=False)
class ParameterShifts:
    """Contribution of errors of assumed values to those of parameters.

    Parameters
    ----------
    variance : ndarray, shape (parameters,)
        Sum of the squared shifts.
    squared_misfit : ndarray, shape (parameters,)
        Increase of the weighted squared misfit if each parameter moves by the root of
        its variance, under the equalities.
    count : int
        Number of assumed values that were changed.
    """

    variance: Vector
    squared_misfit: Vector
    count: int

    @property
    def sentence(self) -> str:
        """The content of standard errors, as a sentence."""
        return (
            f"The shifts from {self.count} changes of assumed values, each by one "
            f"standard error, are included"
        )


class ScatterCauses(NamedTuple):
    """Causes of the parameters' scatter: noise, and effects beyond it.

    Parameters
    ----------
    noise : ResidualNoise
        Noise of the regression; with scatter between recordings, if there are several.
    blocks : FloatingBlocks, optional
        Scatter of the parameters between blocks of the motion.
    shifts : ParameterShifts, optional
        Shifts of the parameters by errors of assumed values.
    """

    noise: ResidualNoise
    blocks: FloatingBlocks | None = None
    shifts: ParameterShifts | None = None


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
        The same recordings, each with one assumed value changed by its standard error.
    constraints : sequence of Constraint
        Only their equalities are used.

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
