"""What noise does not show of parameters' errors: blocks of a motion, and known shifts.

Friction that balances contact forces in joints at rest, and feet that creep, err alike
for seconds, and not alike in all of a motion.  Noise and its correlation do not show
how much; parameters found from blocks of the motion do, see `block_scatter`.

Where a foot touches, or how late a channel is, is known with an error of its own, which
no scatter of the estimate shows.  The same recordings are prepared once more with it
changed by its standard error; the parameters of least squares move by theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.equalities import FreeParameters, least_squares
from consistent_id.estimation.uncertainties.block_scatter import (
    BLOCKS,
    BlockScatter,
    block_scatter,
)
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import ResidualNoise, joint_noise
from consistent_id.regression.segments import merged


@dataclass(frozen=True, slots=True, eq=False)
class FloatingBlocks:
    """Blocks of a recording, and how far parameters differ between them.

    Parameters
    ----------
    between : ndarray, shape (parameters,)
        Standard deviation between blocks, beyond noise; zero of what is fixed.
    unit : ndarray, shape (parameters,)
        How far a parameter moves if the weighted squared misfit rises by one, with
        equalities held; zero of what is fixed or does not differ.
    """

    scatter: BlockScatter
    between: Vector
    unit: Vector

    @property
    def variance(self) -> Vector:
        """What the scatter adds to each parameter's variance: that of the mean."""
        return np.asarray(self.between**2 / self.scatter.blocks)

    @property
    def squared_misfit(self) -> Vector:
        """What moving each parameter by the root of its `variance` adds."""
        free = self.unit > 0.0
        return np.asarray(self.variance * free / np.where(free, self.unit, 1.0) ** 2)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the scatter."""
        return self.scatter.blocks - 1.0

    @property
    def sentence(self) -> str:
        """What standard errors contain."""
        return (
            f"Scatter of parameters between {self.scatter.blocks} blocks, beyond "
            f"noise, is added: 95 % are {self.scatter.quantile:.2f} standard errors "
            "either way"
        )


def floating_blocks(
    model: TorqueModel,
    segments: Sequence[Regression],
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> FloatingBlocks | None:
    """Find the scatter between `BLOCKS` blocks; None where one leaves parameters open.

    Parameters
    ----------
    segments : sequence of Regression
        Of one recording, in the order of time.
    """
    count = min(BLOCKS, len(segments))
    parts = [
        merged([segments[i] for i in few])
        for few in np.array_split(np.arange(len(segments)), count)
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


class ScatterCauses(NamedTuple):
    """What parameters scatter by: noise, and what is beyond it.

    Parameters
    ----------
    noise : ResidualNoise
        Of the regression; with scatter between recordings, if there are several.
    blocks : FloatingBlocks, optional
        What parameters differ by between blocks of the motion.
    shifts : ParameterShifts, optional
        What things taken for granted move.
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
