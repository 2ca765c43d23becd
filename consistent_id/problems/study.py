"""The study of a problem: estimates, their comparison, and the verdict."""

from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from consistent_id._support.executors import FEW_SAMPLES, beside
from consistent_id._support.progress import stages
from consistent_id._support.tables import brief
from consistent_id.comparison.comparison import Comparison, EstimateReport, compare
from consistent_id.diagnosis import Diagnosis
from consistent_id.errors import (
    ConsistentIdError,
    InfeasibleError,
    NotExcitedError,
    SolverError,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.estimate_plot import draw_parameters, parameter_bars
from consistent_id.estimation.influence import confirmed_slopes
from consistent_id.estimation.judgement import judge
from consistent_id.estimation.method import Method
from consistent_id.estimation.slope_reasons import doubtful_joints
from consistent_id.estimation.torque_error import Slopes
from consistent_id.estimation.verdict import Verdict, confirmed
from consistent_id.problems.log_check import check_problem
from consistent_id.problems.problem import Problem, require_problem
from consistent_id.problems.problem_estimates import (
    noted,
    refitted,
)
from consistent_id.problems.stated_model import drawn_parts
from consistent_id.problems.study_fits import StudyFits
from consistent_id.problems.weighed_findings import weighed_findings
from consistent_id.recordings.recording import LogFinding, Recording
from consistent_id.robot.solids import DrawnParts


@brief
@dataclass(frozen=True, eq=False)
class Study(StudyFits):
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
        Raised by any part that cannot be computed.

    Examples
    --------
    >>> import consistent_id as ci
    >>> study = ci.Study(ci.load_problem("problems/rx60"))
    >>> study.excitation.data_rank  # estimates are not computed for it
    15
    """

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """Diagnosis of the recordings; None if they are simulated, or given."""
        return None if self._recorded is None else check_problem(self._recorded)

    def _checked(self) -> Diagnosis | None:
        return self.diagnosis

    @property
    def _recorded(self) -> Problem | None:
        """The problem, if its recordings are neither simulated nor given."""
        recorded = self.problem.table.data is not None and self.recordings is None
        return self.problem if recorded else None

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
            lambda: self._candidate,
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
        """Return a constrained estimate, fitted again to all data, with its verdict."""
        if not self.validation:
            return report.with_verdict
        own = report.estimate.method == self.recommendation.method
        again = self._refit if own else self._fitted_to_all(report.estimate)
        return replace(again, judged=report.verdict)

    @cached_property
    def _refit(self) -> Estimate:
        """The recommended estimate, fitted to all data, which needs no verdict yet."""
        return self._fitted_to_all(self._candidate)

    @property
    def _refit_ahead(self) -> Estimate | None:
        """The same, while the log is checked; who needs it hears why there is none."""
        with suppress(ConsistentIdError):
            return self._refit
        return None

    def _fitted_to_all(self, estimate: Estimate) -> Estimate:
        """Return an estimate fitted again to training and validation data, if any."""
        if not self.validation:
            return estimate
        every = (*self.training, *self.validation)
        prior = self.priors[Method(estimate.method)]
        return noted(refitted(self.problem, estimate, every, prior), self.slacks)

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
        doubtful = own.fit is None or bool(doubtful_joints(own.fit))
        found = (
            compare(
                [own],
                unseen or self.validation,
                training=self.training,
                findings=self._findings_for(estimate),
                regression=self.regression,
                crossed=self.crossed if doubtful else None,
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
            Verdict on a given estimate; by default that on the recommended one.

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
        parts = {**_FITS, **(_COSTS if costs else {}), **_JUDGEMENT}
        with stages(1 + len(parts), self.progress) as begin:
            begin("recordings")
            samples = sum(len(recording.time) for recording in self.training)
            with (
                beside(check_problem, self._recorded)
                if self._recorded is not None and samples <= FEW_SAMPLES
                else nullcontext()
            ) as diagnosis:
                check = diagnosis or self._checked
                try:
                    for stage, part in parts.items():
                        begin(stage)
                        if part == "diagnosis":
                            self.__dict__.setdefault(part, check())
                        getattr(self, part)
                except (InfeasibleError, NotExcitedError, SolverError) as failure:
                    with suppress(ConsistentIdError):
                        _explain(failure, check())
                    raise
        return self

    @cached_property
    def comparison(self) -> Comparison:
        """The comparison of all estimates."""
        best = self.recommendation.method
        reports = (
            replace(
                report,
                findings=self.findings
                if report.estimate.method == best
                else self._unweighed,
            )
            for report in self._undiagnosed.reports
        )
        return replace(self._undiagnosed, reports=tuple(reports))

    @cached_property
    def _undiagnosed(self) -> Comparison:
        """The comparison without findings, which can be made before the diagnosis."""
        return compare(
            self.estimates,
            self.validation,
            training=self.training,
            regression=self.regression,
            crossed=self.crossed,
            drawn=self.drawn,
        )

    def plot_torque(
        self,
        recording: Recording | None = None,
        *,
        joints: Sequence[str] | None = None,
        axes: Any = None,
    ) -> Any:
        """Draw measured torque, least squares' and the recommended estimate's.

        Parameters
        ----------
        recording : Recording, optional
            Prepared; by default the first validation recording, which neither estimate
            was fitted to, or the first training recording if there is none.
        joints, axes
            See `Estimate.plot`.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (joints,)
        """
        if recording is None:
            recording = (*self.validation, *self.training)[0]
        methods = dict.fromkeys((Method.LEAST_SQUARES, self.recommendation.method))
        for method in methods:
            axes = self.estimate(method).plot(recording, joints=joints, axes=axes)
        return axes

    def plot_parameters(
        self, names: Sequence[str] | None = None, *, axes: Any = None
    ) -> Any:
        """Draw the delivered parameters with 95 % bars, one axes for each unit.

        Bars are `Estimate.half_intervals` either way.  Parameters that the data do not
        determine are hollow, without a bar.

        Parameters
        ----------
        names : sequence of str, optional
            Parameters, or bodies and joints whose parameters are all drawn.
        axes : matplotlib.axes.Axes or array_like of it, shape (units,), optional
            Axes to draw in; by default those of a new figure of `matplotlib.pyplot`.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (units,)

        Raises
        ------
        ProblemError
            If a name is unknown, or the number of axes is not that of the units.
        """
        own = self.delivered
        bars = parameter_bars(
            own.model.layout, own.parameters, own.half_intervals, names
        )
        return draw_parameters(bars, own.method, axes)


def _explain(failure: ConsistentIdError, diagnosis: Diagnosis | None) -> None:
    """Note the gravest fault of each kind, for which no estimate may exist."""
    gravest: dict[str, LogFinding] = {}
    for fault in () if diagnosis is None else diagnosis.faults:
        gravest.setdefault(fault.kind, fault)
    for fault in gravest.values():
        failure.add_note(
            f"{fault.kind} ({fault.recording}): {fault.statement}. To do: "
            f"{fault.advice}"
        )


def _same_parameters(one: Estimate, other: Estimate) -> bool:
    return one.parameters.shape == other.parameters.shape and np.allclose(
        one.parameters, other.parameters, rtol=1e-6, atol=1e-9
    )


def _says_more(stated: Verdict | None, found: Verdict) -> bool:
    """Return whether a stated verdict is the computed one, perhaps with more notes.

    Further findings of a comparison of all estimates are not computed again.
    """
    if stated is None:
        return False
    shared = tuple(r for r in stated.reasons if r in found.reasons or r.word != "use")
    return replace(stated, reasons=shared) == found


_FITS = {
    "weight of the prior": "path",
    "slack": "slacks",
    "estimates": "estimates",
    "recommendation": "recommendation",
}
_JUDGEMENT = {
    "comparison": "_undiagnosed",
    "fit to all data": "_refit_ahead",
    "faults of the recordings": "diagnosis",
    "verdict": "comparison",
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
    """Compute the study of a problem: its paper if it has one, estimates, comparison.

    Parameters
    ----------
    problem : Problem
    seed : int
        Seed of the bootstrap, if the study's `uncertainty` is needed.
    progress : bool
        Whether to show the progress on the standard error.
    accepted : sequence of str
        Kinds of findings and reasons that verdicts ignore.
    costs : bool
        Whether to compute the costs of constraints now, not when needed.

    Returns
    -------
    Study
        The study, in which everything but `uncertainty` is computed.

    Raises
    ------
    ProblemError
        If the problem has neither recordings nor a simulated experiment.

    Examples
    --------
    >>> import consistent_id as ci
    >>> study = ci.run_study(ci.load_problem("problems/rx60"), costs=False)
    >>> study.verdict.word, study.recommendation.method
    ('use', 'constrained')
    """
    require_problem(problem, "run_study")
    study = Study(problem, seed=seed, progress=progress, accepted=tuple(accepted))
    return study.run(costs=costs)
