"""From a problem to its answer: estimates, their comparison, costs, uncertainty."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from consistent_id._support.brief import brief
from consistent_id._support.progress import stages
from consistent_id.comparison.comparison import Comparison, EstimateReport, compare
from consistent_id.comparison.constraint_prices import (
    ConstraintCost,
    ShadowPrice,
    constraint_costs,
    shadow_prices,
)
from consistent_id.constraints import lowered
from consistent_id.constraints.priors import Prior
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.body_slopes import Slopes
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.cross_validation import RegularisationPath
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.expected_error import (
    ErrorForecast,
    ExpectedError,
    error_forecast,
)
from consistent_id.estimation.fit import Fit, fit_of
from consistent_id.estimation.fitted_to import fitted_spans
from consistent_id.estimation.influence import confirmed_slopes
from consistent_id.estimation.judgement import judge
from consistent_id.estimation.left_out import (
    LeftOutBlock,
    LeftOutErrors,
    folds_of,
    left_out_errors,
)
from consistent_id.estimation.method import Method
from consistent_id.estimation.recommendation import Recommendation, recommend
from consistent_id.estimation.slack import SlackChoice
from consistent_id.estimation.uncertainties.parameter_uncertainty import (
    Uncertainty,
    uncertainty,
)
from consistent_id.estimation.verdict import Verdict, confirmed
from consistent_id.problems.drawn_robot import drawn_parts
from consistent_id.problems.log_check import check_problem
from consistent_id.problems.problem import Problem
from consistent_id.problems.problem_estimates import (
    identify,
    penalty_of,
    recordings_of,
    refitted,
    regularisation_path,
    slack_choices,
    slack_notes,
    variant_regressions,
)
from consistent_id.problems.published import (
    PublishedReport,
    check_published,
    published_least_squares,
)
from consistent_id.problems.robot_preparation import segments_of_problem
from consistent_id.problems.weighing import weighed_findings
from consistent_id.recordings.recording import LogFinding, Recording
from consistent_id.regression.base import BaseParameters, Excitation, excitation_of
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.residual_noise import UnconstrainedFit
from consistent_id.regression.rows.contact_free import base_of_recordings
from consistent_id.regression.segments import (
    merged,
    segment_sources,
)
from consistent_id.robot.drawn_parts import DrawnParts


@brief
@dataclass(frozen=True, eq=False)
class Study:
    """The study of a problem: each part is computed once, when first needed.

    Parameters
    ----------
    problem : Problem
    seed : int
        Seed of the bootstrap for `uncertainty`.
    progress : bool
        Whether the bootstrap shows its progress on the standard error.
    accepted : tuple of str
        Kinds of findings and reasons that verdicts ignore.
    recordings : tuple of (training, validation), optional
        Prepared recordings in place of the problem's own; they are not diagnosed.

    Raises
    ------
    ProblemError, NotExcitedError, InfeasibleError, SolverError
        By any part that cannot be computed.
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
    def slacks(self) -> dict[Method, SlackChoice]:
        """How the slack of the constrained estimates was chosen."""
        return slack_choices(self.problem, self.folds, base=self.base)

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

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """Diagnosis of the recordings; None if they are simulated, or given."""
        recorded = self.problem.table.data is not None and self.recordings is None
        return check_problem(self.problem) if recorded else None

    @cached_property
    def findings(self) -> tuple[LogFinding, ...]:
        """Findings that the verdict on the recommended estimate uses, weighed for it.

        Warnings that do not change the recommended estimate are notes.  Verdicts on
        other estimates use those of the diagnosis.
        """
        if self.diagnosis is None:
            return ()
        return weighed_findings(
            self.problem,
            self.diagnosis.findings,
            self._candidate,
            self.training,
            self.validation,
        )

    @property
    def _unweighed(self) -> tuple[LogFinding, ...]:
        return () if self.diagnosis is None else self.diagnosis.findings

    def _findings_for(self, estimate: Estimate) -> tuple[LogFinding, ...]:
        """Return the weighed findings for the estimate that they were weighed for.

        That is the recommended one, or its fit to all data.
        """
        if self.findings == self._unweighed:
            return self.findings
        own = estimate.method == self.recommendation.method
        if own and (
            _same_parameters(self._candidate, estimate)
            or self._delivered_as(estimate) is not None
        ):
            return self.findings
        return self._unweighed

    @cached_property
    def crossed(self) -> Slopes | None:
        """Slopes of doubtful joints' torque on bodies that other joints determine."""
        return confirmed_slopes(self._candidate, self.training)

    @cached_property
    def drawn(self) -> DrawnParts:
        """Shapes of links and nominal drives, of the robot's file."""
        return drawn_parts(self.problem)

    @property
    def _candidate(self) -> Estimate:
        """The recommended estimate, not judged yet."""
        return self.estimate(self.recommendation.method)

    @cached_property
    def left_out(self) -> dict[str, LeftOutErrors]:
        """Errors on blocks of the training data left out, by method."""
        problem = self.problem
        penalised = left_out_errors(
            problem.model,
            self.folds,
            [self.priors[Method.CROSS_VALIDATED]],
            constraints=problem.constraints,
            base=self.base,
        )
        chosen = {str(method): found.chosen for method, found in self.slacks.items()}
        return {**chosen, Method.CROSS_VALIDATED: penalised}

    @cached_property
    def recommendation(self) -> Recommendation:
        """The recommendation of an estimate, from the training data."""
        return recommend(self.left_out)

    @cached_property
    def forecast(self) -> ErrorForecast | None:
        """The error to expect of the recommended estimate; None if it is not known."""
        method, model = self.recommendation.method, self.problem.model
        estimate = self.estimate(method)
        under = estimate.fitted_under
        if under is None:
            return None
        return error_forecast(
            model,
            self.regression.weighted(under.weights),
            self.left_out[method],
            parameters=estimate.parameters,
            prior=self.priors[Method(method)],
            constraints=under.constraints,
            base=self.base,
        )

    def expected_on(self, recording: Recording) -> ExpectedError | None:
        """Return the error to expect of the recommended estimate on a known motion.

        Parameters
        ----------
        recording : Recording
            Prepared: with velocity and acceleration.  Its torque is not used, and need
            not be there.
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

    @property
    def recommended(self) -> EstimateReport:
        """The recommended estimate."""
        return self.comparison[self.recommendation.method]

    @cached_property
    def delivered(self) -> Estimate:
        """The recommended estimate, fitted again to training and validation data.

        Its verdict and its held-out error are those of `recommended`, which was fitted
        to the training data alone.  Without validation data it is the same estimate.
        """
        return self._refitted(self.recommended)

    def _refitted(self, report: EstimateReport) -> Estimate:
        """Return a constrained estimate, fitted again to all data."""
        judged = report.with_verdict
        if not self.validation:
            return judged
        every = (*self.training, *self.validation)
        prior = self.priors[Method(judged.method)]
        estimate = refitted(self.problem, judged, every, prior)
        why = slack_notes(self.slacks, judged.method)
        return replace(estimate, notes=(*estimate.notes, *why))

    @property
    def verdict(self) -> Verdict:
        """Whether the recommended estimate may be used, and why."""
        return self.recommended.verdict

    def verdict_on(self, estimate: Estimate) -> Verdict:
        """Return the verdict on an estimate, from all evidence of the study.

        Recordings that it was fitted to are not held out.  If no others remain, its own
        verdict is used, and the evidence computed now can only make it worse: the fit,
        the error on the data that it was fitted to, bodies, findings.  If it does, but
        the study itself would deliver this estimate, the verdict is the study's.

        Parameters
        ----------
        estimate : Estimate
            An estimate of the problem's model, computed now or loaded from a file.
        """
        kinds = tuple(dict.fromkeys((*estimate.accepted, *self.accepted)))
        own, stated = replace(estimate, accepted=kinds), estimate.judged
        unseen = self.unseen(estimate)
        unjudged = bool(self.validation) and not unseen
        if unjudged:
            own = replace(own, fit=self._fit(estimate))
        found = (
            compare(
                [own],
                unseen or self.validation,
                training=self.training,
                findings=self._findings_for(estimate),
                regression=self.regression,
                crossed=self.crossed,
                drawn=self.drawn,
            )
            .reports[0]
            .verdict
        )
        if stated is None:
            return replace(found, held_out=None) if unjudged else found
        if estimate.fitted_to and not unjudged:
            return stated if _says_more(stated, found) else found
        together = confirmed(stated, found)
        nothing = replace(found, reasons=(), held_out=None)
        if unjudged and together != confirmed(stated, nothing):
            report = self._delivered_as(estimate)
            if report is not None:
                return judge(replace(report.evidence, accepted=kinds))
        return together

    def unseen(self, estimate: Estimate) -> tuple[Recording, ...]:
        """Return the validation recordings that an estimate was not fitted to.

        All, if it does not say what it was fitted to.
        """
        # Logs of different folders may have one name: training data go by themselves.
        others = Counter(estimate.fitted_to) - Counter(fitted_spans(self.training))
        spans = zip(self.validation, fitted_spans(self.validation), strict=True)
        return tuple(r for r, own in spans if not any(own.overlaps(o) for o in others))

    def _fit(self, estimate: Estimate) -> Fit:
        """Return the errors of an estimate on the training data."""
        model = self.problem.model
        known = lowered(self.problem.constraints, model).A_eq
        x, own = estimate.parameters, estimate.fit
        fit = fit_of(model, self.free, x, known=known)
        # Its own optimum shows whether constraints contradict its data.
        if own is None:
            return fit
        # So does what its prior may cause: the fit does not show what it pulled to.
        return replace(fit, excess=own.excess, prior_errors=own.prior_errors)

    def _delivered_as(self, estimate: Estimate) -> EstimateReport | None:
        """Return the report behind an estimate that the study itself would deliver."""
        if estimate.method not in self.recommendation.candidates:
            return None
        report = self.comparison[estimate.method]
        same = _same_parameters(self._refitted(report), estimate)
        return report if same else None

    def answer(self, verdict: Verdict | None = None) -> dict[str, Any]:
        """Return the verdict in the form of every command's JSON.

        Parameters
        ----------
        verdict : Verdict, optional
            On an estimate that was given; by default on the recommended one.

        Returns
        -------
        dict
            `Verdict.to_dict`, with ``findings`` of the recordings; and
            ``recommended``: why this estimate, and ``expected_error``: on a motion not
            seen, with its range; None for an estimate that was given.
        """
        own = self.verdict if verdict is None else verdict
        recommended = self.recommendation if verdict is None else None
        expected = None if recommended is None else recommended.expected
        return {
            **own.to_dict(),
            "recommended": None if recommended is None else recommended.statement,
            "expected_error": None if expected is None else expected.to_dict(),
            "findings": [asdict(finding) for finding in self.findings],
        }

    def run(self, *, costs: bool = True) -> Self:
        """Compute everything but the uncertainty now; return the study.

        Parameters
        ----------
        costs : bool
            Whether to compute the costs of constraints now, not when needed.
        """
        parts = {**_STAGES, **_COSTS} if costs else _STAGES
        with stages(len(parts), self.progress) as begin:
            for stage, part in parts.items():
                begin(stage)
                getattr(self, part)
        return self

    def estimate(self, method: str) -> Estimate:
        """Return the estimate by a method; without a verdict from held-out data."""
        return next(e for e in self.estimates if e.method == method)

    @property
    def constrained(self) -> Estimate:
        """The constrained estimate, computed alone if the others are not needed yet."""
        if "estimates" not in self.__dict__:
            return self._constrained
        return self.estimate(Method.CONSTRAINED)

    @cached_property
    def comparison(self) -> Comparison:
        """The comparison of all estimates."""
        found = compare(
            self.estimates,
            self.validation,
            training=self.training,
            findings=self._unweighed,
            regression=self.regression,
            crossed=self.crossed,
            drawn=self.drawn,
        )
        best = self.recommendation.method
        reports = (
            replace(report, findings=self.findings)
            if report.estimate.method == best
            else report
            for report in found.reports
        )
        return replace(found, reports=tuple(reports))

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
        return replace(estimate, accepted=self.accepted, fitted_to=spans)


def _same_parameters(one: Estimate, other: Estimate) -> bool:
    return one.parameters.shape == other.parameters.shape and np.allclose(
        one.parameters, other.parameters, rtol=1e-6, atol=1e-9
    )


def _says_more(stated: Verdict | None, found: Verdict) -> bool:
    """Return whether a stated verdict is the found one, with more worth knowing.

    Further findings of a comparison of all estimates are not computed again.
    """
    if stated is None:
        return False
    shared = tuple(r for r in stated.reasons if r in found.reasons or r.word != "use")
    return replace(stated, reasons=shared) == found


_STAGES = {
    "recordings": "training",
    "faults of the recordings": "diagnosis",
    "weight of the prior": "path",
    "slack": "slacks",
    "estimates": "estimates",
    "recommendation": "recommendation",
    "comparison": "comparison",
}
_COSTS = {"costs of constraints": "costs", "shadow prices": "prices"}


def run_study(
    problem: Problem,
    *,
    seed: int = 0,
    progress: bool = False,
    accepted: Sequence[str] = (),
    costs: bool = True,
) -> Study:
    """Work a problem through: its paper if it has one, estimates, comparison.

    Parameters
    ----------
    problem : Problem
    seed : int
        Seed of the bootstrap, if the study's `uncertainty` is needed.
    progress : bool
        Show how far it is, on the standard error.
    accepted : sequence of str
        Kinds of findings and reasons that verdicts ignore.
    costs : bool
        Whether to compute the costs of constraints now, not when needed.

    Returns
    -------
    Study
        With everything else computed but its `uncertainty`.

    Raises
    ------
    ProblemError
        If the problem has neither recordings nor a simulated experiment.
    """
    study = Study(problem, seed=seed, progress=progress, accepted=tuple(accepted))
    return study.run(costs=costs)
