"""From a problem to its answer: identify, compare, with everything that was found."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.progress import stages
from consistent_id.comparison.comparison import Comparison, compare
from consistent_id.comparison.constraint_prices import ShadowPrice, shadow_prices
from consistent_id.comparison.fit_costs import ConstraintCost, constraint_costs
from consistent_id.constraints import PhysicalConsistency
from consistent_id.errors import ProblemError
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.cross_validation import (
    RegularisationPath,
    cross_validated,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.least_squares import (
    least_squares,
    weighted_least_squares,
)
from consistent_id.estimation.robust import huber
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import PublishedReport, check_published
from consistent_id.problems.published_estimate import published_least_squares
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import (
    BaseParameters,
    ConditionNumber,
    base_parameters,
    condition_number,
    linear_combination,
)
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.segments import segment_regressions
from consistent_id.regression.simulation import simulate_torque


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """How well the training data excite the robot.

    Parameters
    ----------
    structural_rank : int
        Number of base parameters, from random motions.
    data_rank : int
        Of them, determined by the data.
    condition : tuple of ConditionNumber
        Of the base regressor, unscaled and with unit columns.
    undetermined : tuple of str
        Combinations of base parameters that the data leave open.
    """

    structural_rank: int
    data_rank: int
    condition: tuple[ConditionNumber, ...]
    undetermined: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """A problem worked through.

    Parameters
    ----------
    problem : Problem
    base : BaseParameters
    training, validation : tuple of Recording
    excitation : Excitation
    comparison : Comparison
    costs : tuple of ConstraintCost
        What each constraint costs in fit, with equal weights for all joints.
    path : RegularisationPath
        By which the weight of the cross-validated estimate's prior was chosen.
    prices : tuple of ShadowPrice
        What each single row or body costs, likewise.
    published : PublishedReport, optional
        If the problem has a paper.
    """

    problem: Problem
    base: BaseParameters
    training: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    excitation: Excitation
    comparison: Comparison
    costs: tuple[ConstraintCost, ...]
    prices: tuple[ShadowPrice, ...]
    path: RegularisationPath
    published: PublishedReport | None

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """The estimates, in the order compared."""
        return tuple(report.estimate for report in self.comparison.reports)


def identify(
    problem: Problem,
    training: Sequence[Recording] | None = None,
    *,
    base: BaseParameters | None = None,
    path: RegularisationPath | None = None,
) -> tuple[Estimate, ...]:
    """Estimate a problem's parameters by every method there is.

    Least squares and the constrained estimate come with equal weights for all joints,
    and both again weighted by each joint's noise, so that each constrained estimate has
    a twin without constraints.  Besides come robust least squares, and ``"bounded"``:
    the quadratic programme with every constraint but physical consistency, which shows
    what masses, bounds and signs buy by themselves, and ``"cross-validated"``: the
    constrained estimate with a `Penalty` whose weight is chosen from the training data.

    Parameters
    ----------
    problem : Problem
    training : sequence of Recording, optional
        By default the problem's own.
    base : BaseParameters, optional
    path : RegularisationPath, optional
        By default `regularisation_path` of the problem.
    """
    model = problem.model
    training = problem.training if training is None else training
    base = base_parameters(model) if base is None else base
    regression = build_regression(model, training)
    weighted = regression.weighted(joint_noise(model, regression, base=base))
    constraints, prior = problem.constraints, problem.prior
    if path is None:
        path = regularisation_path(problem, training, base=base)
    without_bodies = [c for c in constraints if not isinstance(c, PhysicalConsistency)]
    return (
        least_squares(model, regression, base=base),
        weighted_least_squares(model, regression, base=base),
        huber(model, training, base=base),
        constrained_least_squares(
            model,
            regression,
            constraints=without_bodies,
            prior=prior,
            base=base,
            method="bounded",
        ),
        constrained_least_squares(
            model, regression, constraints=constraints, prior=prior, base=base
        ),
        constrained_least_squares(
            model,
            weighted,
            constraints=constraints,
            prior=prior,
            base=base,
            method="weighted constrained",
        ),
        constrained_least_squares(
            model,
            regression,
            constraints=constraints,
            prior=path.penalty,
            base=base,
            method="cross-validated",
        ),
    )


def regularisation_path(
    problem: Problem,
    training: Sequence[Recording],
    *,
    base: BaseParameters | None = None,
) -> RegularisationPath:
    """Cross-validate the weight of the problem's distance on its training data."""
    return cross_validated(
        problem.model,
        segment_regressions(problem.model, training),
        constraints=problem.constraints,
        distance=problem.prior.distance,
        base=base,
    )


def run_study(problem: Problem, *, progress: bool = False) -> Study:
    """Work a problem through: its paper if it has one, estimates, comparison.

    Parameters
    ----------
    problem : Problem
    progress : bool
        Show how far it is, on the standard error.

    Raises
    ------
    ProblemError
        If the problem has neither recordings nor a simulated experiment.
    """
    with stages(6, progress) as begin:
        return _run_study(problem, begin)


def _run_study(problem: Problem, begin: Callable[[str], None]) -> Study:
    begin("recordings")
    published = None if problem.table.published is None else check_published(problem)
    training, validation = recordings_of(problem, published)
    base = base_parameters(problem.model)
    begin("weight of the prior")
    path = regularisation_path(problem, training, base=base)
    begin("estimates")
    estimates = identify(problem, training, base=base, path=path)
    if published is not None:
        estimates = (
            published_least_squares(problem, training[0], base=base),
            *estimates,
        )
    regression = build_regression(problem.model, training)
    excitation = excitation_of(regression, base)
    begin("comparison")
    comparison = compare(estimates, validation, training=training)
    begin("costs of constraints")
    costs = constraint_costs(problem.model, regression, problem.constraints, base=base)
    begin("shadow prices")
    prices = shadow_prices(problem.model, regression, problem.constraints, base=base)
    return Study(
        problem=problem,
        base=base,
        training=training,
        validation=validation,
        excitation=excitation,
        comparison=comparison,
        costs=costs,
        prices=prices,
        path=path,
        published=published,
    )


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
        undetermined=tuple(
            linear_combination(direction, base.names)
            for direction in solution.null_space.T
        ),
    )


def simulated_experiment(
    problem: Problem, published: PublishedReport
) -> tuple[Recording, Recording]:
    """Return simulated training and validation recordings, from the file's seed.

    The truth is the consistent robot nearest to the published mean.
    """
    table = problem.table.simulation
    if table is None:
        raise ProblemError(f"problem {problem.name!r} has no [simulation] table")
    truth = published.vectors[0].nearest.parameters
    rng = np.random.default_rng(table.seed)
    training, validation = (
        simulate_torque(
            problem.model, truth, problem.motion(name), noise=table.noise, rng=rng
        )
        for name in (table.training, table.validation)
    )
    return training, validation


def recordings_of(
    problem: Problem, published: PublishedReport | None = None
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Return a problem's training and validation recordings, real or simulated."""
    if problem.table.data is not None:
        return problem.training, problem.validation
    if not problem.has_data:
        raise ProblemError(
            f"problem {problem.name!r} has neither [data] nor a [simulation] with a "
            "[published] truth; there is nothing to learn from"
        )
    published = check_published(problem) if published is None else published
    training, validation = simulated_experiment(problem, published)
    return (training,), (validation,)
