"""From a problem to its answer: estimates, their comparison, costs, uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from consistent_id._support.progress import stages
from consistent_id.comparison.comparison import Comparison, EstimateReport, compare
from consistent_id.comparison.constraint_prices import ShadowPrice, shadow_prices
from consistent_id.comparison.fit_costs import ConstraintCost, constraint_costs
from consistent_id.comparison.parameter_uncertainty import Uncertainty, uncertainty
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.cross_validation import RegularisationPath
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.estimation.recommendation import Candidate, Recommendation, recommend
from consistent_id.estimation.verdict import Verdict
from consistent_id.problems.experiment_data import recordings_of
from consistent_id.problems.log_check import check_problem
from consistent_id.problems.problem import Problem
from consistent_id.problems.problem_estimates import (
    identify,
    penalty_of,
    refitted,
    regularisation_path,
)
from consistent_id.problems.published import PublishedReport, check_published
from consistent_id.problems.published_fit import published_least_squares
from consistent_id.problems.sensor_drift_preparation import segments_of_problem
from consistent_id.problems.variants import variant_regressions
from consistent_id.recordings.finding import Finding
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.data_rank import Excitation, excitation_of
from consistent_id.regression.regression import Regression
from consistent_id.regression.rows.contact_free import base_of_recordings
from consistent_id.regression.segments import (
    merged,
    segment_sources,
)


@dataclass(frozen=True, eq=False)
class Study:
    """A problem worked through: each part is computed once, when first asked for.

    Parameters
    ----------
    problem : Problem
    seed : int
        Of the bootstrap behind `uncertainty`.
    progress : bool
        Whether the bootstrap shows on the standard error how far it is.
    accepted : tuple of str
        Kinds of findings and reasons that verdicts are to overlook.

    Raises
    ------
    ProblemError, NotExcitedError, InfeasibleError, SolverError
        Any part, if it cannot be computed.
    """

    problem: Problem
    seed: int = 0
    progress: bool = False
    accepted: tuple[str, ...] = ()

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
        """How well the training data excite the robot."""
        return excitation_of(self.regression, self.base)

    @cached_property
    def path(self) -> RegularisationPath:
        """How the weight of the cross-validated estimate's prior was chosen."""
        return regularisation_path(self.problem, self.segments, base=self.base)

    @cached_property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates by every method, the paper's first."""
        own = identify(
            self.problem,
            self.training,
            base=self.base,
            path=self.path,
            regression=self.regression,
        )
        if self.published is not None:
            recording = self.training[0]
            first = published_least_squares(self.problem, recording, base=self.base)
            own = (first, *own)
        return tuple(replace(e, accepted=self.accepted) for e in own)

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """What is wrong with the recordings; None if they are simulated."""
        recorded = self.problem.table.data is not None
        return check_problem(self.problem) if recorded else None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong with the recordings, as verdicts take it."""
        return () if self.diagnosis is None else self.diagnosis.findings

    @cached_property
    def recommendation(self) -> Recommendation:
        """Which estimate to use, chosen from the training data."""
        problem = self.problem
        return recommend(
            problem.model,
            self.segments,
            (
                Candidate(Method.CONSTRAINED, False, problem.prior),
                Candidate(Method.WEIGHTED_CONSTRAINED, True, problem.prior),
                Candidate(
                    Method.CROSS_VALIDATED, False, penalty_of(problem, self.path)
                ),
            ),
            constraints=problem.constraints,
            base=self.base,
        )

    @property
    def recommended(self) -> EstimateReport:
        """The recommended estimate."""
        return self.comparison[self.recommendation.method]

    @cached_property
    def delivered(self) -> Estimate:
        """The recommended estimate, fitted again to training and validation data.

        Its verdict and its held-out error are those of `recommended`, which had seen
        the training data alone.  Without validation data it is the same estimate.
        """
        judged = self.recommended.judged
        if not self.validation:
            return judged
        crossed = judged.method == Method.CROSS_VALIDATED
        prior = self.path.penalty if crossed else self.problem.prior
        every = (*self.training, *self.validation)
        return refitted(self.problem, judged, every, prior)

    @property
    def verdict(self) -> Verdict:
        """Whether the recommended estimate may be used, and why."""
        return self.recommended.verdict

    def judged(self, estimate: Estimate) -> Verdict:
        """Return the verdict on an estimate, with all that the study knows.

        Parameters
        ----------
        estimate : Estimate
            Of the problem's model, computed now or loaded from a file.
        """
        kinds = dict.fromkeys((*estimate.accepted, *self.accepted))
        own = replace(estimate, accepted=tuple(kinds))
        found = compare([own], self.validation, findings=self.findings)
        return found.reports[0].verdict

    @property
    def constrained(self) -> Estimate:
        """The constrained estimate; alone, if the others have not been asked for."""
        if "estimates" not in self.__dict__:
            return self._constrained
        return next(e for e in self.estimates if e.method == Method.CONSTRAINED)

    @cached_property
    def comparison(self) -> Comparison:
        """The estimates side by side."""
        return compare(
            self.estimates,
            self.validation,
            training=self.training,
            findings=self.findings,
            regression=self.regression,
        )

    @cached_property
    def costs(self) -> tuple[ConstraintCost, ...]:
        """What each constraint costs in fit, with equal weights for all joints."""
        problem = self.problem
        return constraint_costs(
            problem.model, self.regression, problem.constraints, base=self.base
        )

    @cached_property
    def prices(self) -> tuple[ShadowPrice, ...]:
        """What each single row or link condition costs, likewise."""
        problem = self.problem
        return shadow_prices(
            problem.model, self.regression, problem.constraints, base=self.base
        )

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """How well each parameter of the constrained estimate is determined."""
        return uncertainty(
            self.problem.model,
            self.segments,
            constraints=self.problem.constraints,
            prior=self.problem.prior,
            base=self.base,
            seed=self.seed,
            progress=self.progress,
            sources=segment_sources(self.training),
            variants=variant_regressions(self.problem, self.training),
        )

    @cached_property
    def _recordings(self) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
        recorded = self.problem.table.data is not None
        return recordings_of(self.problem, None if recorded else self.published)

    @cached_property
    def _constrained(self) -> Estimate:
        problem = self.problem
        estimate = constrained_least_squares(
            problem.model,
            self.regression,
            constraints=problem.constraints,
            prior=problem.prior,
            base=self.base,
        )
        return replace(estimate, accepted=self.accepted)


_STAGES = {
    "recordings": "training",
    "faults of the recordings": "diagnosis",
    "weight of the prior": "path",
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
        Of the bootstrap, if the study's `uncertainty` is asked for.
    progress : bool
        Show how far it is, on the standard error.
    accepted : sequence of str
        Kinds of findings and reasons that verdicts are to overlook.
    costs : bool
        Whether to compute what constraints cost, instead of when it is asked for.

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
    parts = {**_STAGES, **_COSTS} if costs else _STAGES
    with stages(len(parts), progress) as begin:
        for stage, part in parts.items():
            begin(stage)
            getattr(study, part)
    return study
