"""Constraints on a robot that carries a load: what holds of which of the two."""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.estimation.load.loaded_robot import LoadedRobot
from consistent_id.regression.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class OfBareRobot:
    """A constraint on the robot without its load, among the loaded one's parameters."""

    constraint: Constraint
    robot: LoadedRobot

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the bare robot's set; whatever the load is."""
        place, size = self.robot.place, len(model.layout)
        bare = self.constraint.lower(self.robot.bare)

        def wide(A: Matrix) -> Matrix:
            rows = np.zeros((len(A), size))
            rows[:, place] = A
            return rows

        blocks = []
        for block in bare.blocks:
            k = len(block.scale)
            coefficients = np.zeros((size, k, k))
            coefficients[place] = block.coefficients
            blocks.append(
                SemidefiniteBlock(
                    block.label, coefficients, block.constant, block.scale
                )
            )
        return replace(
            bare, A_eq=wide(bare.A_eq), A_in=wide(bare.A_in), blocks=tuple(blocks)
        )


@dataclass(frozen=True, slots=True, eq=False)
class OfLoad:
    """A constraint on all links, of which that on the load's body alone is kept."""

    constraint: Constraint
    load: str

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the load's blocks."""
        every = self.constraint.lower(model)
        blocks = [block for block in every.blocks if block.label == self.load]
        return ConicSet.semidefinite(blocks, len(model.layout))
