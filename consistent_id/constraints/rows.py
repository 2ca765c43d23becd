"""The protocol of constraints, and their rows."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.given_values import require_types
from consistent_id.constraints.cones.sets import ConicSet, intersection
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import ParameterLayout, require_known


@runtime_checkable
class Constraint(Protocol):
    """A restriction of parameters to a convex set."""

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the set, over the parameters of `model`."""
        ...


def lowered(constraints: Sequence[Constraint], model: TorqueModel) -> ConicSet:
    """Return the intersection of constraints over the parameters of `model`.

    Parameters
    ----------
    constraints : sequence of Constraint
    model : TorqueModel
    """
    require_types(constraints, Constraint, "constraints")
    sets = (constraint.lower(model) for constraint in constraints)
    return intersection(sets, len(model.layout))


def fixed_values(values: Mapping[str, float], layout: ParameterLayout) -> ConicSet:
    """Return the set in which the named parameters have the given values."""
    rows = [unit_row(layout, name) for name in values]
    labels = [
        f"{name} = {value:.10g} {layout.units[layout.index(name)]}"
        for name, value in values.items()
    ]
    return ConicSet.equal(
        stack_rows(rows, layout), np.array(list(values.values()), dtype=float), labels
    )


def known_links(named: Mapping[str, object], model: TorqueModel, what: str) -> None:
    """Refuse names that are not those of links."""
    require_known(named, model.layout.links, f"{what}: no link named")


def stated(model: TorqueModel, key: str, constraint: str) -> dict[str, Any]:
    """Return the datasheets' values of a key, for links that have it.

    Raises
    ------
    ProblemError
        If no link has it: the constraint would have no row.
    """
    found = {link.name: getattr(link.datasheet, key) for link in model.robot.links}
    values = {name: value for name, value in found.items() if value is not None}
    if not values:
        raise ProblemError(
            f"{constraint}: no link's datasheet has a {key}; give values, or leave "
            "this constraint out"
        )
    return values


def unit_row(layout: ParameterLayout, name: str) -> Vector:
    """Row that picks one parameter."""
    row = np.zeros(len(layout))
    row[layout.index(name)] = 1.0
    return row


def offset_row(layout: ParameterLayout, link: str, axis: str, c: float) -> Vector:
    """Row of ``h_axis - c m``."""
    return unit_row(layout, f"{link}.h{axis}") - c * unit_row(layout, f"{link}.m")


def stack_rows(rows: Sequence[Vector], layout: ParameterLayout) -> Matrix:
    """Matrix of rows, with the right number of columns also where there is none."""
    return np.array(rows) if rows else np.zeros((0, len(layout)))


def equalities(
    rows: Sequence[Vector],
    values: Sequence[float],
    labels: Sequence[str],
    model: TorqueModel,
) -> ConicSet:
    """Return ``{x : rows x = values}``, also for no row at all."""
    return ConicSet.equal(
        stack_rows(rows, model.layout), np.array(values, dtype=np.float64), labels
    )


def inequalities(
    rows: Sequence[Vector],
    limits: Sequence[float],
    labels: Sequence[str],
    model: TorqueModel,
) -> ConicSet:
    """Return ``{x : rows x <= limits}``; infinite limits are none."""
    limited = [i for i, limit in enumerate(limits) if limit != np.inf]
    return ConicSet.at_most(
        stack_rows([rows[i] for i in limited], model.layout),
        np.array([limits[i] for i in limited], dtype=np.float64),
        [labels[i] for i in limited],
    )
