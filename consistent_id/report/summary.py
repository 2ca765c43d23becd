"""A study in tables, for people."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from consistent_id._support.run import kept_going
from consistent_id._support.tables import Table
from consistent_id.comparison.comparison import (
    Comparison,
    EstimateReport,
    counted,
    verdict_table,
)
from consistent_id.comparison.constraint_prices import ConstraintCost, ShadowPrice
from consistent_id.diagnosis.findings import diagnosis_table
from consistent_id.estimation.cross_validation import RegularisationPath
from consistent_id.estimation.expected_error import ExpectedError
from consistent_id.estimation.method import Method
from consistent_id.estimation.recommendation import SlackChoice
from consistent_id.estimation.verdict import percent
from consistent_id.problems.log_entries import FoundDrives
from consistent_id.problems.opening import Opened
from consistent_id.problems.problem_estimates import unmeasured_notes
from consistent_id.problems.study import Study
from consistent_id.regression.base import Excitation
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.report.published_section import published_tables
from consistent_id.report.report_content import advise

_PRICES = 12  # single constraints shown
_COSTLY = 0.02  # of the misfit, from which on a constraint is named
_NAMED = 3  # single constraints that are named
_LATE = 1e-3  # s, error of a delay from which on a rollout finds it more closely
_RECORDINGS = 2  # validation recordings whose expected error is printed one by one


def headline_tables(study: Study) -> list[Table]:
    """Return the verdict in one line, its weightiest reasons, and all estimates."""
    advice = advise(study.comparison, recommendation=study.recommendation)
    table = verdict_table(study.comparison)
    costly: tuple[str, ...] = ()
    if any(reason.kind == "contradiction" for reason in advice.verdict.reasons):
        costly = costly_constraints(study.costs, study.prices)
    return [
        Table(
            advice.headline,
            (),
            (),
            (
                *unmeasured_notes(study.problem.model),
                *advice.expected,
                *expected_lines(study),
                *advice.verdict.brief,
                *costly,
                *(table.title for table in study.problem.drives.tables()),
                *delay_line(study.problem.drives),
                *delivery_line(study),
            ),
        ),
        replace(table, notes=(*table.notes, *advice.reasons, *advice.also)),
    ]


def identified_tables(opened: Opened, study: Study) -> list[Table]:
    """Return the text of ``identify``: verdict, faults, and the reading of logs."""
    found = study.diagnosis
    return [
        *headline_tables(study),
        *opened.tables(),
        *study.problem.drives.tables(),
        excitation_table(study.excitation, study.training),
        *([] if found is None else [diagnosis_table(found)]),
        study.delivered.table(),
    ]


def expected_lines(study: Study) -> tuple[str, ...]:
    """Return the error that was to be expected on each validation recording."""
    pairs = zip(study.recommended.validation, study.expected_held_out, strict=True)
    known = [
        (error, expected)
        for error, expected in pairs
        if expected is not None and expected.predicts
    ]
    if len(known) > _RECORDINGS:
        inside = sum(expected.contains(error.stacked) for error, expected in known)
        return (
            f"{inside} of {len(known)} held-out errors are in the range expected there",
        )
    return tuple(
        f"expected on {error.recording}: {expected.range}; measured "
        f"{percent(error.stacked)}" + _beyond(expected, error.stacked)
        for error, expected in known
    )


def _beyond(expected: ExpectedError, error: float) -> str:
    if expected.contains(error):
        return ""
    return ", less than expected" if error < expected.low else ", more than expected"


def delay_line(drives: FoundDrives) -> tuple[str, ...]:
    """Say how late commands are taken to be, if that was found and is not exact."""
    known = drives.calibration
    if not known.delay_error or drives.tables():
        return ()
    closely = "; consistent-id rollout finds the delay more closely"
    return (
        f"commands are taken to be {1e3 * known.delay:.2g} ms late, "
        f"+- {1e3 * NORMAL * known.delay_error:.2g} ms (95 %); intervals of drives "
        "contain this error" + closely * (known.delay_error > _LATE),
    )


def delivery_line(study: Study) -> tuple[str, ...]:
    """Say what is taken away, written or not; nothing without validation data."""
    if not study.validation:
        return ()
    return (
        f"delivered estimate: {study.recommendation.method}, fitted again to "
        "training and validation data; verdict and errors are those from the training "
        "data alone",
    )


def study_tables(study: Study) -> list[Table]:
    """Return everything that a study found, table by table, the verdict first."""
    found = list[Table]()
    for name, make in _TABLES.items():
        made: Sequence[Table] = ()
        with kept_going(f"table {name}") as faults:
            made = make(study)
        said = [f"{name}: this table could not be made: {why}" for why in faults]
        found += [*made, *(Table(line, (), ()) for line in said)]
    return found


def excitation_table(excitation: Excitation, training: Sequence[Any]) -> Table:
    """Return rank and condition of the training data."""
    names = ", ".join(f"{r.name} ({len(r)} samples)" for r in training)
    open_ended = excitation.undetermined
    note = f"not identifiable from these data: {'; '.join(open_ended)}"
    return Table(
        "Training data",
        ("quantity", "value"),
        (
            ("recordings", names),
            ("base parameters (structural rank)", str(excitation.structural_rank)),
            ("determined by the data (data rank)", str(excitation.data_rank)),
            *(("condition number", str(number)) for number in excitation.condition),
        ),
        (note,) if open_ended else (),
    )


def cost_table(costs: Sequence[ConstraintCost], joints: Sequence[str]) -> Table:
    """Return the cost of each constraint in fit to the training data."""
    return Table(
        "What each constraint costs in fit (training data, all others kept)",
        ("constraint", "misfit", *joints, "verdict"),
        tuple(
            (
                cost.name,
                f"{max(cost.increase, 0.0):.3%}",
                *(f"{d:.4f}" for d in cost.rms_with - cost.rms_without + 0.0),
                cost.verdict,
            )
            for cost in costs
        ),
        (
            "misfit: relative increase of the best fit's norm; per joint: change of "
            "the RMS residual in N m (N if it slides)",
        ),
    )


def costly_constraints(
    costs: Sequence[ConstraintCost], prices: Sequence[ShadowPrice]
) -> tuple[str, ...]:
    """Name what disagrees with the data: constraints, and their costliest parts.

    Parameters
    ----------
    prices : sequence of ShadowPrice
        The largest first.

    Returns
    -------
    tuple of str
        A line; none if no constraint costs anything by itself.
    """
    costly = sorted(
        (c for c in costs if c.increase >= _COSTLY), key=lambda c: -c.increase
    )
    parts = [p.label for p in prices[:_NAMED] if p.cost > 0.0]
    if not costly:
        return ()
    named = ", ".join(f"{c.name} (misfit {_grown(c.increase)})" for c in costly)
    single = f"; most of all {', '.join(parts)}" if parts else ""
    return (f"constraints that increase the misfit, each alone: {named}{single}",)


def _grown(increase: float) -> str:
    """Return a relative increase as text: ``+30%``, or ``1.9e+03 times``."""
    return f"{increase:+.0%}" if increase < 1.0 else f"{1.0 + increase:.2g} times"


def price_table(prices: Sequence[ShadowPrice]) -> Table:
    """Return shadow prices: what single constraints cost in fit, the largest first."""
    shown = prices[:_PRICES]
    return Table(
        "Shadow prices of single constraints (training data, all others kept)",
        ("constraint", "without it [N m]", "one percent more [N m]", "verdict"),
        tuple(
            (p.label, f"{-p.cost + 0.0:.2g}", f"{p.price:+.2e}", p.verdict)
            for p in shown
        ),
        (
            "change of the RMS residual over all joints; one percent of a typical "
            "mass, length or torque",
            f"the {len(shown)} largest of {len(prices)}; all others cost nothing",
        ),
    )


def path_table(path: RegularisationPath) -> Table:
    """Return the choice of the prior's weight, in words."""
    shown = sorted({*range(0, len(path.weights), 2), path.best})
    return Table(
        f"Weight of the prior ({path.distance} distance), by cross-validation",
        ("weight", "left-out error", "misfit", "distance", "chosen"),
        tuple(
            (
                f"{path.weights[i]:.1e}",
                f"{path.error[i]:.4f}",
                f"{path.misfits[i]:.4f}",
                f"{path.distances[i]:.3g}",
                "<" if i == path.best else "",
            )
            for i in shown
        ),
        (
            f"errors: RMS torque in N m (N if it slides); left out: "
            f"{path.errors.shape[1]} runs of the training data, one at a time",
            "misfit and distance to nominal: with all training data fitted",
        ),
    )


def slack_table(slacks: Mapping[Method, SlackChoice]) -> Table:
    """Return the choice of the constrained estimates' slack, in words."""
    shown = {method: found for method, found in slacks.items() if found.slacks}
    names = next((found.slacks for found in shown.values()), ())
    return Table(
        "Slack of the prior, by the error on blocks left out",
        ("slack", *shown),
        tuple(
            (
                name,
                *(
                    f"{found.left_out.pooled[i]:.2%}" + " <" * (i == found.best)
                    for found in shown.values()
                ),
            )
            for i, name in enumerate(names)
        ),
        (
            "slack: relative increase of the misfit's norm in favour of the nominal "
            "robot; default: one standard error of the determined parameters",
            "error: all joints, squares pooled over the training data; <: least, used",
        )
        if shown
        else ("the problem states the prior; no slack was chosen",),
    )


def link_table(comparison: Comparison) -> Table:
    """Return the links' directions on the boundary of the consistency cone."""
    reports = [r for r in comparison.reports if all(r.consistent_links)]
    return Table(
        "Links on the boundary of the consistency cone",
        ("link", *(report.estimate.method for report in reports)),
        tuple(
            (name, *(report.links[k].edge or "inside" for report in reports))
            for k, name in enumerate(comparison.model.layout.links)
        )
        if reports
        else (),
        (
            "a link on the boundary means that data and constraints disagree, or that "
            "data are few",
        ),
    )


def comparison_tables(comparison: Comparison) -> list[Table]:
    """Return held-out errors, consistency and certificates of all estimates."""
    joints = comparison.model.torque_joints
    reports = comparison.reports
    tables = []
    for i, error in enumerate(reports[0].validation):
        where = f"error on {error.recording}, joint by joint"
        tables.append(_error_table(f"Held-out {where}", joints, reports, i))
        tables.append(_mse_table(f"Mean squared held-out {where}", joints, reports, i))
    tables.append(_consistency_table(reports))
    return [*tables, _reasons_table(reports)]


def _reasons_table(reports: Sequence[EstimateReport]) -> Table:
    """Return the reasons for each verdict, and what is proven of each optimum."""
    whys = []
    for report in reports:
        verdict, own = report.verdict, report.estimate.certificate
        whys.append(verdict.sentence)
        whys += [f"  {line}" for line in verdict.lines]
        whys.append(f"  optimum {own.verdict}: {own.reason}")
    return Table("Why", (), (), tuple(whys))


def _consistency_table(reports: Sequence[EstimateReport]) -> Table:
    return Table(
        "Physical consistency",
        (
            "estimate",
            "verdict",
            "links that base parameters rule out",
            "any consistent robot with its base parameters",
            "torque change to the nearest consistent robot",
            "least eigenvalue of M(q)",
            "median distance to nominal",
        ),
        tuple(
            (
                report.estimate.method,
                report.verdict.word,
                counted([not possible for possible in report.possible_links]),
                report.base_feasibility.answer,
                _to_nearest(report),
                f"{report.least_mass_eigenvalue:.4g}",
                f"{np.median(report.distance_to_nominal):.3g}",
            )
            for report in reports
        ),
        (
            "ruled out: no consistent body of the link has these base parameters, "
            "whatever the other links are",
            "nearest consistent robot: relative RMS change of the torque along "
            "random motions",
            "least eigenvalue over 10 000 random poses; distance: "
            "||J0^-1/2 (J - J0) J0^-1/2|| per link",
        ),
    )


def _to_nearest(report: EstimateReport) -> str:
    nearest = report.base_feasibility.nearest
    return "-" if nearest is None else f"{nearest.torque_change:.2%}"


def _error_table(
    title: str, joints: Sequence[str], reports: Sequence[EstimateReport], which: int
) -> Table:
    rows = []
    for report in reports:
        error = report.validation[which]
        rows.append(
            (
                report.estimate.method,
                f"{error.stacked:.2%}",
                *(
                    f"{rms:.4g} ({share:.1%})"
                    for rms, share in zip(error.rms, error.relative, strict=True)
                ),
            )
        )
    return Table(
        title,
        ("estimate", "all joints", *joints),
        tuple(rows),
        ("per joint: RMS error in N m (N if it slides), and over the RMS torque",),
    )


def _mse_table(
    title: str, joints: Sequence[str], reports: Sequence[EstimateReport], which: int
) -> Table:
    return Table(
        title,
        ("estimate", *joints),
        tuple(
            (r.estimate.method, *(f"{mse:.4g}" for mse in r.validation[which].mse))
            for r in reports
        ),
        ("(N m)^2, or N^2 for sliding joints",),
    )


def _published(study: Study) -> Sequence[Table]:
    if study.published is None:
        return ()
    return published_tables(study.published, study.problem.table.published)


_TABLES: dict[str, Callable[[Study], Sequence[Table]]] = {
    "verdict": headline_tables,
    "published": _published,
    "drives": lambda study: study.problem.drives.tables(),
    "excitation": lambda s: [excitation_table(s.excitation, s.training)],
    "comparison": lambda study: comparison_tables(study.comparison),
    "links": lambda study: [link_table(study.comparison)],
    "costs": lambda s: [cost_table(s.costs, s.problem.model.torque_joints)],
    "prices": lambda study: [price_table(study.prices)],
    "path": lambda study: [path_table(study.path)],
    "slack": lambda study: [slack_table(study.slacks)],
}
"""The tables of a study, in their order; one that cannot be made loses only itself."""
