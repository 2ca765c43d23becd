"""The best fit among physically consistent parameters.

The search is in the standard parameters, in which consistency is defined:

1. the least weighted misfit ``||R x - z||`` over the constraints;
2. among all constrained ``x`` whose misfit is within a slack of it, the one nearest to
   the nominal robot.  So the prior determines the parameters that the data do not, not
   the solver.

Both are cone programmes on the compressed regression; both optima are certified.  If
constraints exclude each other, `contradiction` computes the cost of giving up each.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import (
    Constraint,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
)
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    RADIUS,
    Optimality,
    OptimumProof,
    ball_about,
    proven_within,
    solve_certified,
)
from consistent_id.constraints.cones.interior import irreducible_conflict
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.constraints.priors import (
    NominalDistance,
    Penalty,
    PointToSet,
    Prior,
    nominal_distance,
)
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.best_fit import (
    REFERENCE,
    BestFit,
    FitProblem,
    ScaledFit,
    attained_fit,
    inner_fit,
)
from consistent_id.estimation.nearest import DISTANCE_GAP, NearestFit, nearest_within
from consistent_id.estimation.penalised import PenalisedFit, penalised_fit
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies

SLACK_GAP = 0.01
"""Largest uncertainty of the least misfit, as a share of the slack."""

_EQUAL = 10.0 * GAP_TOLERANCE
"""Relative increase of the squared misfit within which estimates fit equally well.

The proof of the best fit leaves a tenth of it open.  Where the constraints cost much
more than one standard error, as with torque of another robot or of the wrong sign, that
error is less, and no solver could use it up.
"""

_AGAIN = 2  # times that the best fit is solved again in reach of the final estimate

_OTHER_SIZE = 100.0
"""Ratio to the nominal robot's torque beyond which a unit is likely to be wrong."""

_ALLOWED = (
    f"{GAP_TOLERANCE:.0e} of the final estimate, {DISTANCE_GAP:.0e}, {SLACK_GAP:.0e} "
    f"and {FEASIBILITY_TOLERANCE:.0e}"
)

DEFAULT_CONSTRAINTS: tuple[Constraint, ...] = (
    PhysicalConsistency(),
    FixedMasses(),
    NonNegativeDrive(),
)
"""Links physically consistent, masses of the datasheet, friction that dissipates."""


@dataclass(frozen=True, slots=True, eq=False)
class ConstrainedFit:
    """The results of both stages.

    Parameters
    ----------
    final : PenalisedFit
        The final point.
    slack : float
        Largest relative increase of the misfit for the prior.
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
        """Whether the final optimum is certified, with an accurate enough slack."""
        final = self.final.optimality.verdict == "certified"
        return (
            final and self.distance_gap <= DISTANCE_GAP and self.slack_gap <= SLACK_GAP
        )

    @property
    def proof(self) -> OptimumProof:
        """The proofs about both optima."""
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
        return OptimumProof(self.certified, self._statement, _ALLOWED, figures)

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
            f"violated by at most {violation:.1e}, searched among robots with "
            f"parameters up to {reach:.0f} times the nominal ones"
        )


@dataclass(frozen=True, slots=True, eq=False)
class BestInside:
    """The first stage: the best fit with links inside; every prior starts from it.

    Parameters
    ----------
    one_error : float
        Squared misfit of one standard error, less what the share inside has used.
    notes : tuple of str
        How the best fit was found.
    """

    best: BestFit
    one_error: float
    notes: tuple[str, ...]

    def slack(self, prior: PointToSet) -> float:
        """Return the relative increase of the misfit that a prior allows."""
        # A misfit below a millionth of the torque counts as that: see `ScaledFit`.
        least = max(self.best.misfit, self.best.scaled.size) ** 2
        return prior.relative_slack(max(self.one_error, _EQUAL * least), least)


def constrained_fit(problem: FitProblem, prior: Prior | None) -> ConstrainedFit:
    """Fit under constraints; the prior determines what the data do not.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    try:
        return _fitted(problem, PointToSet() if prior is None else prior)
    except SolverError as failure:
        raise SolverError(f"{failure}{_of_torque_size(problem)}") from None


def _fitted(problem: FitProblem, prior: Prior) -> ConstrainedFit:
    first = best_inside(problem, prior.inside)
    best = first.best
    distance = nominal_distance(problem.model, prior.distance, best.scaled.unit)
    if isinstance(prior, Penalty):
        return _compromise(best, distance, prior, first.notes)
    near = nearest_within(best, distance, first.slack(prior))
    found = _nearest(best, distance, prior, near, first.notes)
    if found.slack_gap <= SLACK_GAP:
        return found
    return _in_reach(first, distance, prior, near) or found


def _in_reach(
    first: BestInside, distance: NominalDistance, prior: PointToSet, near: NearestFit
) -> ConstrainedFit | None:
    """Return the estimate of the best fit within reach; None if it is not proven.

    With poor data, the least misfit may be that of a robot of a million times the
    nominal parameters, or of none.  The certificate is about robots of up to `RADIUS`
    times the nominal ones and the estimate's: among them, there is a best fit.
    """
    best, nominal = first.best, distance.nominal
    for _ in range(_AGAIN):
        again = _best_in_reach(best, near, nominal)
        if again.optimality.verdict != "certified":
            return None
        if again.solution is not best.solution:
            slack = replace(first, best=again).slack(prior)
            near = nearest_within(again, distance, slack)
        if again.optimality.radius >= RADIUS * _away(near, nominal):
            found = _nearest(again, distance, prior, near, first.notes)
            return found if found.certified else None
        best = again
    return None


def _away(near: NearestFit, nominal: Vector) -> float:
    """Return how far the estimate is from the nominal robot."""
    return float(np.linalg.norm(near.fit.solution.u - nominal))


def _best_in_reach(best: BestFit, near: NearestFit, nominal: Vector) -> BestFit:
    """Return the best fit in a ball that reaches `RADIUS` times as far as the estimate.

    The ball is twice as large, as the estimate may move.
    """
    u = near.fit.solution.u
    ball = ball_about(nominal, 2.0 * RADIUS * _away(near, nominal))
    inside = float(np.linalg.norm(best.solution.u - nominal)) <= ball.radius
    proven = proven_within(
        best.scaled.problem,
        best.solution,
        ball,
        start=best.solution.u if inside else u,
        reference=REFERENCE,
    )
    return BestFit(best.scaled, *proven)


def best_inside(problem: FitProblem, inside: float) -> BestInside:
    """Return the first stage, with links that contain a share of nominal bodies.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    try:
        attained = attained_fit(problem)
    except InfeasibleError as refused:
        if not refused.members:
            raise
        found = _resolved(problem, refused.members)
        raise InfeasibleError(found.sentence, refused.members) from None
    attained_problem = replace(problem, constraints=attained.constraints)
    inner = inner_fit(attained_problem, attained.best, share=inside)
    left = problem.free.noise.one_error * (1.0 - inner.move) ** 2
    notes = tuple(filter(None, (inner.note, attained.note)))
    return BestInside(inner.best, left, notes)


def _of_torque_size(problem: FitProblem) -> str:
    """Return advice where the torque is not of the nominal robot's size."""
    R, bodies = problem.free.regression.stacked(), reference_bodies(problem.model.robot)
    expected = float(np.linalg.norm(R[:, : bodies.size] @ bodies.ravel()))
    ratio = float(np.linalg.norm(R[:, -1])) / max(expected, 1e-300)
    if 1.0 / _OTHER_SIZE <= ratio <= _OTHER_SIZE:
        return ""
    return (
        f"; the torque is {ratio:.1e} times that of the nominal robot in this motion, "
        "and parameters of such sizes cannot be computed together: check the torque's "
        "unit and its gain, and the model's masses"
    )


def _nearest(
    best: BestFit,
    distance: NominalDistance,
    prior: PointToSet,
    near: NearestFit,
    notes: tuple[str, ...],
) -> ConstrainedFit:
    slack = near.slack
    delivered = best.misfit_of(near.fit.solution.u)
    note = (
        f"nearest to nominal ({prior.distance} distance) among estimates whose misfit "
        f"is at most {slack:.2g} of the least misfit above it; squared weighted "
        f"residuals {delivered**2:.7g}, least within the constraints "
        f"{best.misfit**2:.7g}"
        + (
            ""
            if prior.slack
            else ": parameters that data determine move by one standard error at most"
        )
    )
    return ConstrainedFit(
        best,
        distance,
        near.fit,
        slack,
        near.distance_gap,
        _slack_gap(best.optimality, near.allowed),
        "; ".join((note, *notes)),
    )


def _slack_gap(best: Optimality, allowed: float) -> float:
    """Return the slack's relative error, because the least misfit has a gap."""
    gap = 2.0 * best.gap * max(best.objective, REFERENCE)
    return 0.0 if best.verdict == "certified" else gap / allowed


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


@dataclass(frozen=True, slots=True)
class Resolution:
    """The best fit without one of the contradictory constraints.

    Parameters
    ----------
    label : str
        Label of the constraint that is left out.
    rms : float, [N m or N], or in units of the joints' `sigma`
        Root-mean-square residual of the best fit without it; infinite if other
        constraints still contradict each other, nan if it could not be computed.
    values : dict of str to float
        Values that the constrained parameters then have.
    """

    label: str
    rms: float
    values: dict[str, float]

    @property
    def sentence(self) -> str:
        """The resolution in words."""
        if np.isnan(self.rms):
            return f"The best fit without ({self.label}) could not be computed"
        if np.isinf(self.rms):
            return f"Without ({self.label}) others still contradict each other"
        then = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"Without ({self.label}) the best fit leaves {self.rms:.4g} RMS" + (
            f", with {then}" if then else ""
        )


@brief
@dataclass(frozen=True, slots=True)
class Contradiction:
    """An irreducible set of constraints without a common point.

    Parameters
    ----------
    resolutions : tuple of Resolution
        One for each member, that with the best fit first.
    unconstrained_rms : float
        Root-mean-square residual of least squares.
    """

    resolutions: tuple[Resolution, ...]
    unconstrained_rms: float

    @property
    def sentence(self) -> str:
        """The contradiction in words."""
        members = "; ".join(r.label for r in self.resolutions)
        ways = ". ".join(r.sentence for r in self.resolutions)
        return (
            f"no parameters satisfy these together: {members}. {ways}. "
            f"Least squares leaves {self.unconstrained_rms:.4g} RMS. Check the "
            "datasheet values and the margin, or loosen one"
        )


@single_threaded
def contradiction(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters | None = None,
) -> Contradiction | None:
    """Find the constraints that exclude each other, and the cost of each in torque.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
    constraints : sequence of Constraint
    base : BaseParameters, optional

    Returns
    -------
    Contradiction or None
        None if no contradiction is proven.

    Raises
    ------
    ProblemError, NotExcitedError
        If the regression does not fit the model, or is empty.
    """
    base = base_parameters(model) if base is None else base
    problem = FitProblem.of(model, regression, constraints, base)
    members = irreducible_conflict(problem.scaled().domain)
    return _resolved(problem, members) if members else None


def _resolved(problem: FitProblem, members: Sequence[int]) -> Contradiction:
    """Return the best fit without each member of an irreducible conflict."""
    scaled = problem.scaled()
    to_rms = scaled.size / np.sqrt(sum(problem.free.regression.counts))
    names = problem.model.layout.names
    found = [_without(scaled, m, to_rms, names) for m in members]
    return Contradiction(
        tuple(sorted(found, key=lambda r: np.nan_to_num(r.rms, nan=np.inf))),
        scaled.residual * float(to_rms),
    )


def _without(
    scaled: ScaledFit,
    member: int,
    to_rms: float,
    names: tuple[str, ...],
) -> Resolution:
    label, fewer = scaled.domain.labels[member], scaled.domain.without(member)
    problem = LeastNorm(scaled.M, scaled.z, fewer)
    try:
        u = solve_certified(problem, scaled.centre, reference=REFERENCE)[0].u
        empty = fewer.violation(u) > FEASIBILITY_TOLERANCE
    except SolverError:
        empty = True
    if empty:
        others = irreducible_conflict(fewer)
        return Resolution(label, np.inf if others else np.nan, {})
    rms = float(np.sqrt(scaled.excess(u) + scaled.residual**2) * to_rms)
    dropped = scaled.domain.only([member])
    tied = np.flatnonzero(np.vstack([dropped.A_eq, dropped.A_in]).any(axis=0))
    return Resolution(label, rms, {names[i]: float((u * scaled.unit)[i]) for i in tied})
