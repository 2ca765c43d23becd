"""Links that stay inside the cone of physical consistency, where data allow it.

Where data are poor, the best fit is mostly on the boundary of the cone: links without
thickness, which no robot has.  Therefore each link is to contain a share of its nominal
body, as large as the data allow: what they determine is to move by a small part of a
standard error at the most.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from consistent_id.constraints import Constraint, PhysicalConsistency, lowered
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    solve_certified,
)
from consistent_id.errors import SolverError
from consistent_id.estimation.best_fit import BestFit
from consistent_id.estimation.scaled_fit import REFERENCE
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import ResidualNoise

MOVE = 0.25
"""Standard errors by which the share may move all that the data determine, together."""

_AIM = 0.9  # of `MOVE`, at which a smaller share aims
_LESS = 0.1  # of a share that other constraints do not allow
_TRIES = 3
_LEAST = 1e-5  # share below which a link is on the boundary all the same


@dataclass(frozen=True, slots=True, eq=False)
class InnerFit:
    """The best fit with links inside.

    Parameters
    ----------
    share : float
        Of its nominal body that every link contains, at the least.
    move : float
        Standard errors by which that moves what the data determine, all together.
    """

    best: BestFit
    share: float = 0.0
    move: float = 0.0

    @property
    def note(self) -> str:
        """The share in words; empty if there is none."""
        if not self.share:
            return ""
        return (
            f"every link contains {self.share:.2g} of its nominal body or more, which "
            f"moves what the data determine by {self.move:.2g} standard errors, in all"
        )


def inner_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    best: BestFit,
    *,
    share: float,
    noise: ResidualNoise,
    base: BaseParameters,
) -> InnerFit:
    """Return the best fit whose links contain a share of their nominal bodies.

    Parameters
    ----------
    constraints : sequence of Constraint
        Of `best`; without `PhysicalConsistency` nothing is changed.
    share : float
        Wanted; as much of it is taken as moves the best fit by no more than `MOVE`.
    noise : ResidualNoise
        Of the regression.
    """
    if not any(isinstance(c, PhysicalConsistency) for c in constraints):
        return InnerFit(best)
    A = regression.stacked()[:, list(base.independent)]
    score = (A @ noise.steps).T @ A @ best.scaled.projection
    for _ in range(_TRIES):
        if share < _LEAST:
            break
        found = _containing(model, constraints, best, share)
        if found is None:  # another constraint does not allow it
            share *= _LESS
            continue
        move = noise.errors(score @ (found.solution.u - best.solution.u))
        if move <= MOVE:
            return InnerFit(found, share, move)
        # The best fit moves nearly in proportion.
        share *= _AIM * MOVE / move
    return InnerFit(best)


def _containing(
    model: TorqueModel, constraints: Sequence[Constraint], best: BestFit, share: float
) -> BestFit | None:
    """Return the best fit with a share, as well proven; None if there is none."""
    inner = [
        replace(c, share=max(c.share, share))
        if isinstance(c, PhysicalConsistency)
        else c
        for c in constraints
    ]
    possible = lowered(inner, model)
    scaled = replace(
        best.scaled,
        constraints=possible,
        domain=possible.normalised(best.scaled.unit),
    )
    try:
        solution, optimality = solve_certified(
            scaled.problem, scaled.centre, reference=REFERENCE
        )
    except SolverError:
        return None
    gap = max(GAP_TOLERANCE, best.optimality.gap)
    if optimality.violation > FEASIBILITY_TOLERANCE or optimality.gap > gap:
        return None
    return BestFit(scaled, solution, optimality)
