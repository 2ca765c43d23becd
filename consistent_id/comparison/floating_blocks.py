"""What blocks of one recording add to the errors of a floating base's parameters.

Friction that balances contact forces in joints at rest, and feet that creep, err alike
for seconds, and not alike in all of a motion.  Noise and its correlation do not show
how much; parameters found from blocks of the motion do, see `block_scatter`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.comparison.block_scatter import BLOCKS, BlockScatter, block_scatter
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.equalities import FreeParameters
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
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
