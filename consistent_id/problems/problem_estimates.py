"""A problem's data, recorded or simulated, and its estimates by every method."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from consistent_id._support.executors import single_threaded, worker_threads
from consistent_id._support.tables import some_of
from consistent_id.constraints import PhysicalConsistency
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
from consistent_id.estimation.base_least_squares import unconstrained_estimate
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained import (
    constrained_estimate,
    constrained_least_squares,
)
from consistent_id.estimation.cross_validation import (
    RegularisationPath,
    cross_validated,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.left_out import (
    LeftOutBlock,
    LeftOutFits,
    left_out_fits,
)
from consistent_id.estimation.method import Method, fitted_spans
from consistent_id.estimation.recommendation import SlackChoice, chosen_slack
from consistent_id.estimation.robust import HuberRules, huber_estimate
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import PublishedReport, check_published
from consistent_id.problems.robot_preparation import regression_of
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    UnconstrainedFit,
    noise_levels,
    unconstrained_fit,
)
from consistent_id.regression.torque_along import simulate_torque


def identify(
    problem: Problem,
    training: Sequence[Recording],
    equal: UnconstrainedFit,
    *,
    path: RegularisationPath,
    slacks: Mapping[Method, SlackChoice],
) -> tuple[Estimate, ...]:
    """Estimate a problem's parameters by every method.

    Least squares and the constrained estimate are computed with equal weights for all
    joints, and again weighted by each joint's noise, so that each constrained estimate
    has a counterpart without constraints.  Other methods are robust least squares;
    ``"box-constrained QP"``, the quadratic programme with every constraint except
    physical consistency, which shows the effect of masses, bounds and signs alone; and
    ``"cross-validated"``, the constrained estimate with a `Penalty` whose weight is
    chosen from the training data.  The training data also determine the slack of the
    constrained estimates, unless the problem states it; the quadratic programme has
    that of the constrained estimate.

    A `Study` computes each of the arguments once.  To estimate from other recordings,
    use ``Study(problem, recordings=...).estimates``.

    Parameters
    ----------
    problem : Problem
    training : sequence of Recording
        Prepared.
    equal : UnconstrainedFit
        Least squares on the training recordings, with equal weights; see `Study.free`.
    path : RegularisationPath
        See `regularisation_path`.
    slacks : mapping of Method to SlackChoice
        See `slack_choices`.
    """
    model, constraints = problem.model, problem.constraints
    regression, base = equal.regression, equal.base
    weighted = unconstrained_fit(
        regression.weighted(noise_levels(regression, base)), base
    )
    choice, own = slacks[Method.CONSTRAINED], slacks[Method.WEIGHTED_CONSTRAINED]
    penalty = penalty_of(problem, path)
    linear = [c for c in constraints if not isinstance(c, PhysicalConsistency)]
    estimates = (
        *(
            unconstrained_estimate(model, free, data=free, method=method)
            for method, free in (
                (Method.LEAST_SQUARES, equal),
                (Method.WEIGHTED_LEAST_SQUARES, weighted),
            )
        ),
        huber_estimate(model, training, equal, weighted.solution.x, HuberRules()),
        *(
            constrained_estimate(FitProblem(model, free, kept), chosen, method=method)
            for method, free, kept, chosen in (
                (Method.BOX_CONSTRAINED, equal, linear, choice.prior),
                (Method.CONSTRAINED, equal, constraints, choice.prior),
                (Method.WEIGHTED_CONSTRAINED, weighted, constraints, own.prior),
                (Method.CROSS_VALIDATED, equal, constraints, penalty),
            )
        ),
    )
    spans = fitted_spans(training)
    return tuple(replace(noted(e, slacks), fitted_to=spans) for e in estimates)


@single_threaded  # here, for both threads: the first that ends would give it back
def fits_left_out(
    problem: Problem, folds: Sequence[LeftOutBlock], *, base: BaseParameters
) -> dict[Method, LeftOutFits]:
    """Return the constrained fits without each block, equally weighted and weighted."""

    def fitted(method: Method) -> LeftOutFits:
        return left_out_fits(
            problem.model,
            folds,
            constraints=problem.constraints,
            base=base,
            inside=problem.prior.inside,
            weighted=method == Method.WEIGHTED_CONSTRAINED,
        )

    methods = (Method.CONSTRAINED, Method.WEIGHTED_CONSTRAINED)
    with worker_threads(len(methods)) as pool:  # Clarabel frees the interpreter's lock
        return dict(zip(methods, pool.map(fitted, methods), strict=True))


@single_threaded
def slack_choices(
    problem: Problem, fits: Mapping[Method, LeftOutFits]
) -> dict[Method, SlackChoice]:
    """Return the slacks of the constrained estimates; `fits` of `fits_left_out`."""
    with worker_threads(len(fits)) as pool:
        chosen = pool.map(lambda each: chosen_slack(each, problem.prior), fits.values())
        return dict(zip(fits, chosen, strict=True))


def noted(estimate: Estimate, slacks: Mapping[Method, SlackChoice]) -> Estimate:
    """Return an estimate with notes on its slack, if chosen, and unmeasured joints."""
    more = slack_notes(slacks, estimate.method)
    unmeasured = unmeasured_notes(estimate.model)
    return replace(estimate, notes=(*unmeasured, *estimate.notes, *more))


def unmeasured_notes(model: TorqueModel) -> tuple[str, ...]:
    """Return a note on joints without measured torque; none if the base floats."""
    if model.robot.floating or not model.robot.connected:
        return ()
    names = [j for j in model.robot.joint_names if j not in model.torque_joints]
    if not names:
        return ()
    return (
        f"the torque of {some_of(names)} is not measured: its drive is unknown, and "
        "errors leave it out",
    )


def slack_notes(slacks: Mapping[Method, SlackChoice], method: str) -> tuple[str, ...]:
    """Return notes on how an estimate's slack was chosen; none if it was stated."""
    said = (found.statement for name, found in slacks.items() if name == method)
    return tuple(filter(None, said))


def penalty_of(problem: Problem, path: RegularisationPath) -> Prior:
    """Return the prior with the weight of a path, and the problem's other settings."""
    return replace(path.penalty, inside=problem.prior.inside)


def regularisation_path(
    problem: Problem,
    segments: Sequence[Regression],
    *,
    base: BaseParameters,
) -> RegularisationPath:
    """Cross-validate the weight of the problem's distance on its training data."""
    return cross_validated(
        problem.model,
        segments,
        constraints=problem.constraints,
        distance=problem.prior.distance,
        base=base,
    )


def refitted(
    problem: Problem, estimate: Estimate, recordings: Sequence[Recording], prior: Prior
) -> Estimate:
    """Fit a constrained estimate again, to more data than it is judged with.

    The verdict is to be that of the estimate from the training data alone; the fit, the
    certificate and all errors are those of the new one.

    Parameters
    ----------
    estimate : Estimate
        The estimate of a constrained method.
    recordings : sequence of Recording
        All recordings: training and validation.
    prior : PointToSet or Penalty
        The prior of that estimate.
    """
    model, base = problem.model, estimate.base
    regression = regression_of(problem.table, model, recordings)
    if estimate.method == Method.WEIGHTED_CONSTRAINED:
        regression = regression.weighted(noise_levels(regression, base))
    again = constrained_least_squares(
        model,
        regression,
        constraints=problem.constraints,
        prior=prior,
        base=base,
        method=estimate.method,
    )
    names = ", ".join(dict.fromkeys(recording.name for recording in recordings))
    note = (
        f"fitted again, after its verdict, to all recordings ({names}); verdict and "
        "held-out error are those of the estimate from the training data alone"
    )
    return replace(
        again,
        notes=(note, *again.notes),
        accepted=estimate.accepted,
        judged=estimate.judged,
        fitted_to=fitted_spans(recordings),
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
            "[published] truth; there are no training data"
        )
    published = check_published(problem) if published is None else published
    training, validation = simulated_experiment(problem, published)
    return (training,), (validation,)


def variant_regressions(
    problem: Problem, training: Sequence[Recording]
) -> list[Regression]:
    """Return training data with each estimated setting changed by its standard error.

    They are the `variants` of `uncertainty`.
    """
    if problem.table.data is None:
        return []
    varied = problem.found_in_training.varied(training)
    return [build_regression(problem.model, logs) for logs in varied]
