"""Both stages of a constrained estimate: the best fit, then what the prior settles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
)
from consistent_id.constraints.distances import NominalDistance, nominal_distance
from consistent_id.constraints.priors import Penalty, PointToSet, Prior
from consistent_id.errors import InfeasibleError
from consistent_id.estimation.audit import Proof
from consistent_id.estimation.best_fit import BestFit
from consistent_id.estimation.contradiction import contradiction
from consistent_id.estimation.inside import inner_fit
from consistent_id.estimation.mass_bound import attained_fit
from consistent_id.estimation.nearest import DISTANCE_GAP, nearest_within
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit
from consistent_id.estimation.scaled_fit import REFERENCE
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_noise

SLACK_GAP = 0.01
"""Share of the slack by which the least misfit may be unknown."""

_ALLOWED = (
    f"{GAP_TOLERANCE:.0e} of the final estimate, {DISTANCE_GAP:.0e}, {SLACK_GAP:.0e} "
    f"and {FEASIBILITY_TOLERANCE:.0e}"
)


@dataclass(frozen=True, slots=True, eq=False)
class ConstrainedFit:
    """What both stages found.

    Parameters
    ----------
    final : PenalisedFit
        The final point.
    slack : float
        Relative misfit given up for the prior, at the most.
    distance_gap : float
        Bound on the relative excess of the squared distance, under `PointToSet`.
    slack_gap : float
        Bound on the relative error of the slack, because the least misfit is known up
        to its own gap; zero under `Penalty`, which has no slack.
    note : str
        How the prior was used.
    """

    best: BestFit
    distance: NominalDistance
    final: PenalisedFit
    slack: float
    distance_gap: float
    slack_gap: float
    note: str

    @property
    def parameters(self) -> Vector:
        """The final parameters, in original units."""
        return self.final.solution.u * self.best.scaled.unit

    @property
    def certified(self) -> bool:
        """Whether the final optimum is, within a slack that is known well enough."""
        final = self.final.optimality.verdict == "certified"
        return (
            final and self.distance_gap <= DISTANCE_GAP and self.slack_gap <= SLACK_GAP
        )

    @property
    def proof(self) -> Proof:
        """What was proven of both optima."""
        fit, final = self.best.optimality, self.final.optimality
        figures = {
            "fit: relative gap": fit.gap,
            "fit: violation": fit.violation,
            "prior: relative gap": final.gap,
            "prior: relative gap of the squared distance": self.distance_gap,
            "prior: violation": final.violation,
            "slack": self.slack,
            "slack: relative uncertainty": self.slack_gap,
            "weight of the prior": self.final.weight,
        }
        return Proof(self.certified, self._statement, _ALLOWED, figures)

    @property
    def _statement(self) -> str:
        fit, final = self.best.optimality, self.final.optimality
        violation = max(fit.violation, final.violation)
        if not self.certified:
            return (
                f"relative gap of the best fit {fit.gap:.1e} and of the final estimate "
                f"{final.gap:.1e}, of the squared distance {self.distance_gap:.1e}, of "
                f"the slack {self.slack_gap:.1e}, violation {violation:.1e}"
            )
        second = (
            "a compromise with the prior"
            if self.distance_gap == 0.0
            else f"squared distance to nominal to {self.distance_gap:.1e}"
        )
        size = 1.0 + float(np.linalg.norm(self.distance.nominal))
        reach = min(fit.radius, final.radius) / size
        return (
            f"best fit proven to a relative {fit.gap:.1e}, final estimate to "
            f"{final.gap:.1e}, {second}, constraints "
            f"violated by at most {violation:.1e}, among robots up to {reach:.0f} "
            "times the nominal"
        )


def constrained_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    prior: Prior | None,
    base: BaseParameters,
    *,
    weight: float | None = None,
) -> ConstrainedFit:
    """Fit under constraints, then let the prior choose where the data do not.

    Where a weight of the prior is searched for, `weight` is tried first: that of nearly
    the same data.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    prior = PointToSet() if prior is None else prior
    try:
        attained = attained_fit(model, regression, constraints, base=base)
    except InfeasibleError:
        found = contradiction(model, regression, constraints, base=base)
        if found is None:
            raise
        raise InfeasibleError(found.sentence) from None
    noise = residual_noise(regression, base)
    inner = inner_fit(
        model,
        regression,
        attained.constraints,
        attained.best,
        share=prior.inside,
        noise=noise,
        base=base,
    )
    best = inner.best
    distance = nominal_distance(model, prior.distance, best.scaled.unit)
    notes = tuple(filter(None, (inner.note, attained.note)))
    if isinstance(prior, Penalty):
        return _compromise(best, distance, prior, notes)
    # A misfit below a millionth of the torque counts as that: see `ScaledFit`.
    least = max(best.misfit, best.scaled.size) ** 2
    left = noise.one_error * (1.0 - inner.move) ** 2
    slack = prior.relative_slack(left, least)
    return _nearest(best, distance, prior, slack, notes, weight)


def _nearest(
    best: BestFit,
    distance: NominalDistance,
    prior: PointToSet,
    slack: float,
    notes: tuple[str, ...],
    weight: float | None,
) -> ConstrainedFit:
    near = nearest_within(best, distance, slack, first=weight)
    note = (
        f"nearest to nominal ({prior.distance} distance) among estimates whose misfit "
        f"is within {slack:.2g} (relative) of the best constrained fit"
        + (
            ""
            if prior.slack
            else ": what the data determine moves by one standard "
            "error at the most, in all"
        )
    )
    optimality = best.optimality
    gap = 2.0 * optimality.gap * max(optimality.objective, REFERENCE)
    slack_gap = 0.0 if optimality.verdict == "certified" else gap / near.allowed
    return ConstrainedFit(
        best,
        distance,
        near.fit,
        slack,
        near.distance_gap,
        slack_gap,
        "; ".join((note, *notes)),
    )


def _compromise(
    best: BestFit, distance: NominalDistance, prior: Penalty, notes: tuple[str, ...]
) -> ConstrainedFit:
    fit = penalised_fit(best.scaled, distance, prior.weight)
    least = best.scaled.excess(best.solution.u) + best.scaled.residual**2
    total = fit.excess + best.scaled.residual**2
    # Misfits below one, a millionth of the torque, count as none: see `ScaledFit`.
    given = max(float(np.sqrt(max(total, 1.0) / max(least, 1.0))) - 1.0, 0.0)
    note = (
        f"compromise of misfit and {prior.distance} distance to nominal, weight "
        f"{prior.weight:.3g}; its misfit is {given:.2%} above the best constrained fit"
    )
    said = "; ".join((note, *notes))
    return ConstrainedFit(best, distance, fit, given, 0.0, 0.0, said)
