"""Constraints read as variables left out, and as bounds on those that stay.

Read are rows, not kinds of constraints: whatever lowers to ``low <= x_i <= high`` on a
mass or drive parameter, or to ``h = c m``, is understood; the rest is refused.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint, PhysicalConsistency
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.estimation.body_variables import BodyVariables
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.log_cholesky import MASS

_EQUAL = 1e-9  # difference of two typical parameters that is rounding alone


def body_variables(
    model: TorqueModel, constraints: Sequence[Constraint], unit: Vector
) -> BodyVariables:
    """Return the variables that constraints leave, with their bounds.

    Parameters
    ----------
    unit : ndarray, shape (parameters,)
        Typical sizes: those of `link_scales`, and of drive parameters.

    Raises
    ------
    ProblemError
        If a constraint says anything else, or not exactly one says that links are
        bodies, or a mass has no logarithm.
    InfeasibleError
        If two of them contradict each other.
    """
    margins = [c.margin for c in constraints if isinstance(c, PhysicalConsistency)]
    if len(margins) != 1:
        raise ProblemError(
            f"PhysicalConsistency is stated {len(margins)} times, expected once: the "
            "search is among bodies; or use constrained_least_squares"
        )
    # Quantities that may be bounded: parameters first, then centres of mass.
    links, p = len(model.robot.links), len(model.layout)
    low, high = np.full((2, p + 3 * links), [[-np.inf], [np.inf]])
    for constraint in constraints:
        if isinstance(constraint, PhysicalConsistency):
            continue
        for fact in _facts(constraint, model, unit):
            low[fact.quantity] = max(low[fact.quantity], fact.low)
            high[fact.quantity] = min(high[fact.quantity], fact.high)
            if low[fact.quantity] > high[fact.quantity] + _EQUAL:
                raise InfeasibleError(
                    f"{fact.label!r} contradicts another constraint on the same "
                    "parameter; correct one of them"
                )
    return _within(low, high, margins[0], model)


class _Fact(NamedTuple):
    """``low <= quantity <= high``, in typical units."""

    quantity: int
    low: float
    high: float
    label: str


def _facts(constraint: Constraint, model: TorqueModel, unit: Vector) -> Iterator[_Fact]:
    """Yield what a constraint says, one quantity at a time, or refuse it."""
    says, n = constraint.lower(model).normalised(unit), model.layout.inertial_size
    labels = [*says.eq_labels, *says.in_labels]
    rows, limits = np.vstack([says.A_eq, says.A_in]), np.append(says.b_eq, says.b_in)
    for index, (row, limit, label) in enumerate(zip(rows, limits, labels, strict=True)):
        is_equal = index < len(says.b_eq)
        last = max(np.flatnonzero(row).tolist(), default=0)
        link, entry = divmod(last, 10)
        alone = np.count_nonzero(row) == 1
        if alone and (entry == MASS or last >= n):
            quantity, value = last, limit / row[last]
        elif is_equal and limit == 0.0 and last < n and _is_offset(row, link, entry):
            quantity = len(row) + 3 * link + entry - 1
            value = -row[10 * link] / row[last]
        else:
            raise _refusal(constraint, label)
        at_least, at_most = is_equal or row[last] < 0.0, is_equal or row[last] > 0.0
        yield _Fact(
            quantity,
            value if at_least else -np.inf,
            value if at_most else np.inf,
            label,
        )
    for block in says.blocks:
        raise _refusal(constraint, block.label)


def _is_offset(row: Vector, link: int, entry: int) -> bool:
    """Return whether a row is ``h_axis - c m`` of a link."""
    rest = np.delete(row, [10 * link, 10 * link + entry])
    return entry in (1, 2, 3) and not rest.any()


def _refusal(constraint: Constraint, label: str) -> ProblemError:
    return ProblemError(
        f"{type(constraint).__name__} says {label!r}, which neither fixes a centre of "
        "mass nor bounds a single mass or drive parameter; use "
        "constrained_least_squares"
    )


def _within(
    low: Vector, high: Vector, margin: float, model: TorqueModel
) -> BodyVariables:
    p, n = len(model.layout), model.layout.inertial_size
    masses = slice(MASS, n, 10)
    for name, most in zip(model.layout.links, high[masses], strict=True):
        if most <= margin:
            raise ProblemError(
                f"{name}: a mass of at most {most:.1e} typical masses, with a margin "
                f"of {margin:.1e}, has no logarithm; use constrained_least_squares"
            )
    known = np.where(high - low <= _EQUAL, high, np.nan)
    free = np.isnan(known[:p])
    for axis in range(3):
        free[1 + axis : n : 10] = np.isnan(known[p + axis :: 3])
    with np.errstate(divide="ignore"):
        low[masses] = np.log(np.maximum(low[masses] - margin, 0.0))
        high[masses] = np.log(high[masses] - margin)
    return BodyVariables(
        links=len(model.robot.links),
        margin=margin,
        known=known[:p],
        centres=known[p:].reshape(-1, 3),
        lower=low[:p][free],
        upper=high[:p][free],
        free=free,
    )
