"""The best fit where masses are free: attained, because total mass is bounded.

Physical consistency of a link asks for a mass of ``h^T S^-1 h`` or more, ``h`` its
first moment and ``S`` its second.  Data that want a first moment with next to no
inertia, as noise does of joints that move little, want that mass without end: the least
misfit is approached as the mass grows, but by no robot.  A bound on the total mass lets
it be reached, and proven.  The bound is raised as long as the data ask for more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id.constraints import Constraint, PhysicalConsistency, TotalMass
from consistent_id.constraints.rows import lowered
from consistent_id.errors import InfeasibleError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_noise
from consistent_id.robot.scaling import link_scales

BOUNDS = (10.0, 100.0, 1000.0)
"""Bounds tried, in units of the links' typical masses together: a model's masses are
seldom wrong by a factor of ten, but placeholders may be."""

_RAISED = 10.0  # times the bound: what more mass would bring is judged up to there
_SIGNIFICANT = 3.84  # chi^2 of one parameter that chance exceeds once in twenty times
_REACHED = 0.99  # share of the bound from which it counts as reached


@dataclass(frozen=True, slots=True, eq=False)
class AttainedFit:
    """The best fit, and the bound on total mass under which it was found.

    Parameters
    ----------
    constraints : tuple of Constraint
        Those given, and the bound if there is one.
    note : str
        Which mass the data leave open, where the bound is reached; else empty.
    """

    best: BestFit
    constraints: tuple[Constraint, ...]
    note: str = ""


def attained_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters,
) -> AttainedFit:
    """Return the least misfit over the constraints, and over bounded masses.

    A bound is put on the total mass where no constraint bounds all masses.  It is the
    least of `BOUNDS` beyond which ten times the mass would not lower the squared misfit
    significantly.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    given = tuple(constraints)
    consistent = any(isinstance(c, PhysicalConsistency) for c in given)
    if not consistent or _bounded(model, given).all():
        return AttainedFit(best_fit(model, regression, given, base=base), given)
    noise = residual_noise(regression, base)
    allowed = _SIGNIFICANT * float(np.trace(noise.inflation)) / noise.rank
    typical = float(link_scales(model.robot).mass.sum())
    found: AttainedFit | None = None
    for times in BOUNDS:
        total = TotalMass(0.0, times * typical)
        try:
            best = best_fit(model, regression, (*given, total), base=base)
        except InfeasibleError:
            continue
        note = _note(model, best, total, times)
        found = AttainedFit(best, (*given, total), note)
        if _gain(best, total) <= allowed:
            return found
    if found is not None:
        return found
    return AttainedFit(best_fit(model, regression, given, base=base), given)


def _bounded(model: TorqueModel, constraints: Sequence[Constraint]) -> np.ndarray:
    """Return for each link whether a row bounds its mass from above."""
    rows_only = [c for c in constraints if not isinstance(c, PhysicalConsistency)]
    layout, known = model.layout, lowered(rows_only, model)
    masses = [layout.index(f"{link}.m") for link in layout.links]
    rows = np.vstack([known.A_in, known.A_eq])
    others = np.delete(rows, masses, axis=1)
    sums = (rows >= 0.0).all(axis=1) & ~others.any(axis=1)
    return np.asarray((rows[sums][:, masses] > 0.0).any(axis=0))


def _gain(best: BestFit, total: TotalMass) -> float:
    """Bound what `_RAISED` times the total mass lowers the squared misfit by.

    The least of half the square is convex in the bound ``b``; its slope is less the
    row's multiplier.
    """
    domain = best.scaled.domain
    row = domain.in_labels.index(_label(total))
    price = float(best.solution.multipliers.at_most[row])
    more = (_RAISED - 1.0) * float(domain.b_in[row])
    return 2.0 * price * more * best.scaled.size**2


def _label(total: TotalMass) -> str:
    return f"total mass <= {total.upper_bound:g} kg"


def _note(model: TorqueModel, best: BestFit, total: TotalMass, times: float) -> str:
    links = best.parameters[: model.layout.inertial_size].reshape(-1, 10)
    masses = links[:, 0]
    if masses.sum() < _REACHED * total.upper_bound:
        return ""
    heaviest = int(np.argmax(masses / link_scales(model.robot).mass))
    return (
        f"the data leave the mass of {model.layout.links[heaviest]} open upwards: the "
        "heavier it is, with its centre of mass nearer the joint, the better it fits. "
        f"Total mass is bounded by {total.upper_bound:.3g} kg, {times:g} times what "
        "the links typically weigh: state masses, or a total mass"
    )
