"""The parts of a study that use the training data: estimates, costs, uncertainty."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from consistent_id.comparison.constraint_prices import (
    ConstraintCost,
    ShadowPrice,
    constraint_costs,
    shadow_prices,
)
from consistent_id.constraints import lowered
from consistent_id.constraints.priors import Prior
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.cross_validation import RegularisationPath
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.expected_error import (
    ErrorForecast,
    ExpectedError,
    error_forecast,
)
from consistent_id.estimation.fit import Fit, fit_of
from consistent_id.estimation.left_out import (
    LeftOutBlock,
    LeftOutErrors,
    LeftOutFits,
    folds_of,
    left_out_errors,
)
from consistent_id.estimation.method import Method, fitted_spans
from consistent_id.estimation.recommendation import (
    Recommendation,
    SlackChoice,
    recommend,
)
from consistent_id.estimation.uncertainties.parameter_uncertainty import (
    Uncertainty,
    uncertainty,
)
from consistent_id.problems.problem import Problem
from consistent_id.problems.problem_estimates import (
    fits_left_out,
    identify,
    noted,
    penalty_of,
    recordings_of,
    regularisation_path,
    slack_choices,
    variant_regressions,
)
from consistent_id.problems.published import (
    PublishedReport,
    check_published,
    published_least_squares,
)
from consistent_id.problems.robot_preparation import segments_of_problem
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters, Excitation, excitation_of
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.residual_noise import UnconstrainedFit
from consistent_id.regression.rows.contact_free import base_of_recordings
from consistent_id.regression.segments import (
    merged,
    segment_sources,
)


@dataclass(frozen=True, eq=False)
class StudyFits:
    """The fits of a study to the training data, and the recommended one.

    Each part is computed once, when first needed.  See `Study` for the parameters.
    """

    problem: Problem
    seed: int = 0
    progress: bool = False
    accepted: tuple[str, ...] = ()
    recordings: tuple[tuple[Recording, ...], tuple[Recording, ...]] | None = None

    @cached_property
    def published(self) -> PublishedReport | None:
        """The paper's printed estimates, checked, if the problem has a paper."""
        has_paper = self.problem.table.published is not None
        return check_published(self.problem) if has_paper else None

    @property
    def training(self) -> tuple[Recording, ...]:
        """Prepared training recordings."""
        return self._recordings[0]

    @property
    def validation(self) -> tuple[Recording, ...]:
        """Prepared validation recordings."""
        return self._recordings[1]

    @cached_property
    def base(self) -> BaseParameters:
        """The model's base parameters."""
        return base_of_recordings(self.problem.model, self.training)

    @cached_property
    def segments(self) -> tuple[Regression, ...]:
        """The training data in consecutive segments, compressed."""
        problem = self.problem
        return segments_of_problem(problem.table, problem.model, self.training)

    @cached_property
    def regression(self) -> Regression:
        """All training data, compressed."""
        return merged(self.segments)

    @cached_property
    def excitation(self) -> Excitation:
        """Rank and condition of the base regressor in the training data."""
        return excitation_of(self.regression, self.base)

    @cached_property
    def free(self) -> UnconstrainedFit:
        """Least squares on the training data, with equal weights for all joints."""
        model = self.problem.model
        return FitProblem.of(model, self.regression, (), self.base).free

    @cached_property
    def path(self) -> RegularisationPath:
        """The search for the weight of the cross-validated estimate's prior."""
        return regularisation_path(self.problem, self.segments, base=self.base)

    @cached_property
    def folds(self) -> tuple[LeftOutBlock, ...]:
        """Blocks of the training data, each with all other data."""
        return folds_of(self.segments)

    @cached_property
    def _left_out_fits(self) -> dict[Method, LeftOutFits]:
        """The fits without each block, from which all priors start."""
        return fits_left_out(self.problem, self.folds, base=self.base)

    @cached_property
    def slacks(self) -> dict[Method, SlackChoice]:
        """Choices of the slacks of the constrained estimates."""
        return slack_choices(self.problem, self._left_out_fits)

    @property
    def priors(self) -> dict[Method, Prior]:
        """The prior of each method that can be recommended."""
        chosen = {method: found.prior for method, found in self.slacks.items()}
        return {**chosen, Method.CROSS_VALIDATED: penalty_of(self.problem, self.path)}

    @cached_property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates by every method, the paper's first."""
        problem, training = self.problem, self.training
        own = identify(problem, training, self.free, path=self.path, slacks=self.slacks)
        if self.published is not None:
            recording = self.training[0]
            first = published_least_squares(self.problem, recording, base=self.base)
            own = (replace(first, fitted_to=fitted_spans([recording])), *own)
        return tuple(replace(e, accepted=self.accepted) for e in own)

    def estimate(self, method: str) -> Estimate:
        """Return the estimate by a method, without a verdict from held-out data."""
        return next(e for e in self.estimates if e.method == method)

    @property
    def constrained(self) -> Estimate:
        """The constrained estimate, computed alone if the others are not needed yet."""
        if "estimates" not in self.__dict__:
            return self._constrained
        return self.estimate(Method.CONSTRAINED)

    @cached_property
    def left_out(self) -> dict[str, LeftOutErrors]:
        """Errors on blocks of the training data left out, by method."""
        penalty = self.priors[Method.CROSS_VALIDATED]
        equal = self._left_out_fits[Method.CONSTRAINED]
        penalised = left_out_errors(equal, [penalty])
        chosen = {str(method): found.chosen for method, found in self.slacks.items()}
        return {**chosen, Method.CROSS_VALIDATED: penalised}

    @cached_property
    def recommendation(self) -> Recommendation:
        """The recommendation of an estimate, from the training data."""
        return recommend(self.left_out)

    @cached_property
    def forecast(self) -> ErrorForecast | None:
        """The error to expect of the recommended estimate; None if it is not known."""
        method = self.recommendation.method
        estimate = self.estimate(method)
        under = estimate.fitted_under
        if under is None:
            return None
        return error_forecast(
            FitProblem.of(
                self.problem.model,
                self.regression.weighted(under.weights),
                under.constraints,
                self.base,
            ),
            self.left_out[method],
            parameters=estimate.parameters,
            prior=self.priors[Method(method)],
        )

    def expected_on(self, recording: Recording) -> ExpectedError | None:
        """Return the error to expect of the recommended estimate on a known motion.

        Parameters
        ----------
        recording : Recording
            Prepared, with velocity and acceleration.  Torque is not needed.
        """
        if self.forecast is None:
            return None
        if recording.torque is None:
            recording = replace(recording, torque=np.zeros_like(recording.position))
        rows = build_regression(self.problem.model, recording, noise=False)
        return self.forecast.on(rows)

    @cached_property
    def expected_held_out(self) -> tuple[ExpectedError | None, ...]:
        """The error to expect on each validation recording."""
        return tuple(map(self.expected_on, self.validation))

    @cached_property
    def costs(self) -> tuple[ConstraintCost, ...]:
        """The cost of each constraint in fit, with equal weights for all joints."""
        problem = self.problem
        return constraint_costs(
            problem.model, self.regression, problem.constraints, base=self.base
        )

    @cached_property
    def prices(self) -> tuple[ShadowPrice, ...]:
        """The cost of each single row or link condition, likewise."""
        problem = self.problem
        return shadow_prices(
            problem.model, self.regression, problem.constraints, base=self.base
        )

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """The uncertainty of each parameter of the constrained estimate."""
        return uncertainty(
            self.problem.model,
            self.segments,
            constraints=self.problem.constraints,
            prior=self.slacks[Method.CONSTRAINED].prior,
            base=self.base,
            seed=self.seed,
            progress=self.progress,
            sources=segment_sources(self.training),
            variants=variant_regressions(self.problem, self.training),
        )

    def unseen(self, estimate: Estimate) -> tuple[Recording, ...]:
        """Return the validation recordings that an estimate was not fitted to.

        All of them, if the estimate does not name the recordings of its fit.
        """
        # Logs of different folders may have one name, so training logs are compared as
        # objects.
        others = Counter(estimate.fitted_to) - Counter(fitted_spans(self.training))
        spans = zip(self.validation, fitted_spans(self.validation), strict=True)
        return tuple(r for r, own in spans if not any(own.overlaps(o) for o in others))

    @property
    def _candidate(self) -> Estimate:
        """The recommended estimate, not judged yet."""
        return self.estimate(self.recommendation.method)

    def _fit(self, estimate: Estimate) -> Fit:
        """Return the errors of an estimate on the training data."""
        model = self.problem.model
        known = lowered(self.problem.constraints, model).A_eq
        x, own = estimate.parameters, estimate.fit
        fit = fit_of(model, self.free, x, known=known)
        # Its own optimum shows whether constraints contradict its data.
        if own is None:
            return fit
        # Effects of the prior are shown likewise, because the fit does not show its
        # goal.
        return replace(fit, excess=own.excess, prior_errors=own.prior_errors)

    @cached_property
    def _recordings(self) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
        if self.recordings is not None:
            return self.recordings
        recorded = self.problem.table.data is not None
        return recordings_of(self.problem, None if recorded else self.published)

    @cached_property
    def _constrained(self) -> Estimate:
        problem = self.problem
        estimate = constrained_least_squares(
            problem.model,
            self.regression,
            constraints=problem.constraints,
            prior=self.slacks[Method.CONSTRAINED].prior,
            base=self.base,
        )
        spans = fitted_spans(self.training)
        own = noted(estimate, self.slacks)
        return replace(own, accepted=self.accepted, fitted_to=spans)
