"""The advice on which estimate to use, and why."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from consistent_id._support.tables import brief
from consistent_id.comparison.comparison import Comparison, EstimateReport
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.method import Method
from consistent_id.estimation.recommendation import Recommendation
from consistent_id.estimation.verdict import Verdict, Word, percent

_FIRST = (Method.CONSTRAINED, Method.WEIGHTED_CONSTRAINED, Method.CROSS_VALIDATED)
_NOTABLE = 0.02  # relative difference of held-out errors


@brief
@dataclass(frozen=True, slots=True)
class Advice:
    """The advice on the estimates.

    Parameters
    ----------
    verdict : Verdict
        On the estimate that is recommended.
    method : str
        Method of the estimate to use; empty for none.
    headline : str
        The verdict in one line, with the held-out error.
    expected : tuple of str
        The error to expect on a motion not seen, with its range; empty without a
        recommendation.
    reasons : tuple of str
        Reasons for this one.
    cautions : tuple of str
        The verdict's reasons, with advice.
    also : tuple of str
        Other usable estimates.
    """

    verdict: Verdict
    method: str
    headline: str
    expected: tuple[str, ...]
    reasons: tuple[str, ...]
    cautions: tuple[str, ...]
    also: tuple[str, ...] = ()

    @property
    def level(self) -> Word:
        """The verdict's word."""
        return self.verdict.word


def advise(
    comparison: Comparison,
    diagnosis: Diagnosis | None = None,
    *,
    recommendation: Recommendation | None = None,
) -> Advice:
    """Return the advice on which estimate to use.

    It is the recommended one; without a recommendation the first of constrained,
    weighted constrained, cross-validated and any other that may be used.  Held-out data
    are not used for the choice, so it does not bias the error on them.

    Parameters
    ----------
    comparison : Comparison
    diagnosis : Diagnosis, optional
        Diagnosis of the recordings, if the comparison was made without.
    recommendation : Recommendation, optional
        Chosen from the training data.
    """
    if diagnosis is not None:
        found = diagnosis.findings
        reports = tuple(replace(r, findings=found) for r in comparison.reports)
        comparison = replace(comparison, reports=reports)
    chosen = (
        _first(comparison)
        if recommendation is None
        else comparison[recommendation.method]
    )
    verdict = chosen.verdict
    rivals = [r for r in comparison.reports if r is not chosen]
    plain = next((r for r in rivals if _is_plain(r)), None)
    expected = () if recommendation is None else (recommendation.statement,)
    others = "" if recommendation is None else recommendation.others
    return Advice(
        verdict,
        chosen.estimate.method if verdict.usable else "",
        verdict.compared(None if plain is None else plain.held_out_error),
        expected,
        (
            *((others,) if others else ()),
            *(() if plain is None else (_against(plain),)),
        ),
        verdict.lines,
        _better(chosen, rivals),
    )


def _first(comparison: Comparison) -> EstimateReport:
    """Return the report to use if nothing was recommended."""
    usable = list(comparison.usable)
    named = {r.estimate.method: r for r in usable}
    first = [named[method] for method in _FIRST if method in named]
    constrained = [r for r in comparison.reports if r.estimate.method in _FIRST]
    return next(iter([*first, *usable, *constrained, *comparison.reports]))


def _is_plain(report: EstimateReport) -> bool:
    return report.estimate.method == Method.LEAST_SQUARES


def _against(report: EstimateReport) -> str:
    """Return the reasons against least squares."""
    verdict = report.verdict
    grounds = ", ".join(dict.fromkeys(r.kind for r in verdict.grounds))
    why = grounds or "every link is consistent here, but no constraint ensures it"
    return f"{report.estimate.method}: {verdict.word} ({why})"


def _better(
    chosen: EstimateReport, others: Sequence[EstimateReport]
) -> tuple[str, ...]:
    own = chosen.held_out_error
    rivals = [(r.held_out_error, r) for r in others if r.verdict.usable]
    said = [
        f"{r.estimate.method} ({percent(error)})"
        for error, r in rivals
        if own and error is not None and error < (1 - _NOTABLE) * own
    ]
    if not said:
        return ()
    return (
        f"also usable, with a smaller held-out error: {', '.join(said)}; held-out "
        "recordings are not used to choose",
    )
