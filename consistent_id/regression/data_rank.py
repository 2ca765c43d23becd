"""How well recorded motion excites a robot: rank and condition in the data."""

from dataclasses import dataclass

from consistent_id.regression.base import (
    BaseParameters,
    ConditionNumber,
    condition_number,
    open_combinations,
)
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """How well the training data excite the robot.

    Parameters
    ----------
    structural_rank : int
        Number of base parameters, from random motions.
    data_rank : int
        How many of them the data determine.
    condition : tuple of ConditionNumber
        Of the base regressor, unscaled and with unit columns.
    undetermined : tuple of str
        Combinations of base parameters that the data do not determine.
    """

    structural_rank: int
    data_rank: int
    condition: tuple[ConditionNumber, ...]
    undetermined: tuple[str, ...]


def excitation_of(regression: Regression, base: BaseParameters) -> Excitation:
    """Return rank and condition of the base regressor in the data."""
    columns = list(base.independent)
    R = regression.stacked()
    solution = solve_linear(R[:, columns], R[:, -1])
    return Excitation(
        structural_rank=len(base),
        data_rank=solution.rank,
        condition=tuple(
            condition_number(
                R[:, columns], basis=f"{len(base)} base columns", unit_columns=unit
            )
            for unit in (False, True)
        ),
        undetermined=open_combinations(solution, base.names),
    )
