"""Which estimate to use, and why: the first thing a reader wants to know."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from consistent_id.comparison.comparison import Comparison, EstimateReport
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.method import Method

_FIRST = (Method.CONSTRAINED, Method.WEIGHTED_CONSTRAINED, Method.CROSS_VALIDATED)
_NOTABLE = 0.02  # relative difference of held-out errors
_SUSPICIOUS = 0.2  # by which constraints may make the prediction worse than without

Level = Literal["use", "care", "none"]


@dataclass(frozen=True, slots=True)
class Advice:
    """What to do with the estimates.

    Parameters
    ----------
    level : {"use", "care", "none"}
        ``"care"``: there is an estimate to use, but the log is faulty or the
        constraints contradict the data; ``"none"``: there is none to use.
    method : str
        Of the estimate to use; empty for none.
    reasons : tuple of str
        Why this one.
    cautions : tuple of str
        What to know before using it.
    """

    level: Level
    method: str
    reasons: tuple[str, ...]
    cautions: tuple[str, ...]


def advise(comparison: Comparison, diagnosis: Diagnosis | None = None) -> Advice:
    """Choose the estimate to use.

    It is the first of constrained, weighted constrained, cross-validated and any other
    that is certified and has physically consistent links only.  Held-out data do not
    enter the choice: the error on them is that of a choice made without them.

    Parameters
    ----------
    comparison : Comparison
    diagnosis : Diagnosis, optional
        Of the recordings.
    """
    faults = () if diagnosis is None else diagnosis.faults
    wrong = tuple(f"{f.where}: {f.statement}. To do: {f.advice}" for f in faults)
    chosen = _chosen(comparison)
    if chosen is None:
        why = tuple(f"{r.estimate.method}: {_refusal(r)}" for r in comparison.reports)
        return Advice("none", "", why, wrong)
    others = [r for r in comparison.reports if r is not chosen]
    contradicted = _contradicted(chosen, others)
    return Advice(
        "care" if wrong or contradicted else "use",
        chosen.estimate.method,
        (_own_merits(chosen), *_against(chosen, others)),
        (*wrong, *contradicted, *_better(chosen, others), *_undetermined(chosen)),
    )


def is_usable(report: EstimateReport) -> bool:
    """Return whether an estimate is certified and all its links are consistent."""
    return report.verdict == "certified" and all(report.consistent_links)


def held_out_error(report: EstimateReport) -> float | None:
    """Return the relative torque error over all validation recordings.

    The root of the mean square over recordings; None without any.
    """
    errors = [error.stacked for error in report.validation]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else None


def _chosen(comparison: Comparison) -> EstimateReport | None:
    usable = [r for r in comparison.reports if is_usable(r)]
    named = {r.estimate.method: r for r in usable}
    first = [named[method] for method in _FIRST if method in named]
    return next(iter([*first, *usable]), None)


def _own_merits(report: EstimateReport) -> str:
    links, error = len(report.links), held_out_error(report)
    said = f"all {links} links are physically consistent, and its optimum is certified"
    if error is None:
        return said
    return f"{said}; its torque error on held-out motion is {error:.2%}"


def _against(
    chosen: EstimateReport, others: Sequence[EstimateReport]
) -> tuple[str, ...]:
    """Say why not least squares."""
    found = [r for r in others if r.estimate.method == Method.LEAST_SQUARES]
    return tuple(f"least squares: {_refusal(r)}{_compared(r)}" for r in found)


def _compared(report: EstimateReport) -> str:
    error = held_out_error(report)
    return "" if error is None else f"; held-out error {error:.2%}"


def _refusal(report: EstimateReport) -> str:
    """Say why an estimate cannot be used."""
    links = report.possible_links
    said = []
    if report.base_feasibility.answer == "impossible":
        said.append("no physically consistent robot has its base parameters (proven)")
        if report.consistency is not None:
            said.append(report.consistency.sentence)
    elif report.verdict != "certified":
        said.append(f"{report.verdict} ({report.estimate.certificate.reason})")
    if not all(links):
        wrong = len(links) - sum(links)
        said.append(f"{wrong} of {len(links)} links cannot be consistent")
    return ", ".join(said) or "every link is consistent here, but nothing ensures it"


def _contradicted(
    chosen: EstimateReport, others: Sequence[EstimateReport]
) -> tuple[str, ...]:
    own = held_out_error(chosen)
    for report in others:
        error = held_out_error(report)
        plain = report.estimate.method == Method.LEAST_SQUARES
        if plain and own and error and own > (1 + _SUSPICIOUS) * error:
            return (
                f"held-out torque is predicted {own / error - 1:.0%} worse than by "
                "least squares: data and constraints disagree. See what each "
                "constraint costs, and check the datasheet's masses and the geometry",
            )
    return ()


def _better(
    chosen: EstimateReport, others: Sequence[EstimateReport]
) -> tuple[str, ...]:
    own = held_out_error(chosen)
    rivals = [(held_out_error(r), r) for r in others if is_usable(r)]
    said = [
        f"{r.estimate.method} ({error:.2%})"
        for error, r in rivals
        if own and error is not None and error < (1 - _NOTABLE) * own
    ]
    if not said:
        return ()
    return (
        f"equally consistent, and nearer to this held-out torque: {', '.join(said)}. "
        "The choice between them is not made on held-out data",
    )


def _undetermined(chosen: EstimateReport) -> tuple[str, ...]:
    open_ended = chosen.estimate.undetermined
    boundary = [link.link for link in chosen.links if link.edge]
    said = []
    if open_ended:
        said.append(
            f"{len(open_ended)} combinations of base parameters are not identifiable "
            "from the data and come from the prior"
        )
    if boundary:
        said.append(
            f"on the boundary of the consistency cone: {', '.join(boundary)}. The "
            "torque prediction stays valid; do not rely on single inertias of them"
        )
    return tuple(said)
