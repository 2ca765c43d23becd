"""A study in tables, for people."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from consistent_id._arrays import Array
from consistent_id.base_feasibility import in_words
from consistent_id.comparison import Comparison, EstimateReport
from consistent_id.constraint_costs import ConstraintCost
from consistent_id.published import PublishedReport
from consistent_id.study import Excitation, Study
from consistent_id.tables import Table


def study_tables(study: Study) -> list[Table]:
    """Return everything that a study found, table by table."""
    tables = []
    if study.published is not None:
        tables += published_tables(study.published, study.problem.table.published)
    tables.append(excitation_table(study.excitation, study.training))
    tables += comparison_tables(study.comparison)
    tables.append(cost_table(study.costs, study.problem.model.torque_joints))
    return tables


def excitation_table(excitation: Excitation, training: Sequence[Any]) -> Table:
    """Return rank and condition of the training data."""
    names = ", ".join(f"{r.name} ({len(r)} samples)" for r in training)
    open_ended = excitation.undetermined
    left_open = (f"left open by the data: {'; '.join(open_ended)}",)
    return Table(
        "Training data",
        ("quantity", "value"),
        (
            ("recordings", names),
            ("base parameters (structural rank)", str(excitation.structural_rank)),
            ("determined by the data (data rank)", str(excitation.data_rank)),
            *(("condition number", str(number)) for number in excitation.condition),
        ),
        left_open if open_ended else (),
    )


def cost_table(costs: Sequence[ConstraintCost], joints: Sequence[str]) -> Table:
    """Return what each constraint costs in fit to the training data."""
    return Table(
        "What each constraint costs in fit (training data, the others held)",
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


def comparison_tables(comparison: Comparison) -> list[Table]:
    """Return held-out errors, consistency and certificates of all estimates."""
    joints = comparison.model.torque_joints
    reports = comparison.reports
    tables = []
    for i, error in enumerate(reports[0].validation):
        where = f"on {error.recording} (validation)"
        tables.append(_error_table(f"Torque {where}", joints, reports, i))
        tables.append(_mse_table(f"Mean squared error {where}", joints, reports, i))
    tables.append(
        Table(
            "Physical consistency",
            (
                "estimate",
                "verdict",
                "links that are bodies",
                "any body with its base parameters",
                "least eigenvalue of M(q)",
                "median distance to nominal",
            ),
            tuple(
                (
                    report.estimate.method,
                    report.verdict,
                    f"{sum(report.consistent_links)} of {len(report.consistent_links)}",
                    report.base_feasibility.answer,
                    f"{report.least_mass_eigenvalue:.4g}",
                    f"{np.median(report.distance_to_nominal):.3g}",
                )
                for report in reports
            ),
            (
                "links: of the standard parameters as they stand (for least squares "
                "the smallest of many)",
                "least eigenvalue over 10 000 random poses; distance: "
                "||J0^-1/2 (J - J0) J0^-1/2|| per link",
            ),
        )
    )
    tables.append(
        Table(
            "Why",
            (),
            (),
            tuple(
                f"{report.estimate.method}: {report.verdict}; {_reason(report)}"
                for report in reports
            ),
        )
    )
    return tables


def _reason(report: EstimateReport) -> str:
    if report.base_feasibility.answer == "impossible":
        return report.base_feasibility.summary
    return report.estimate.certificate.reason


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
        ("estimate", "stacked", *joints),
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


def published_tables(report: PublishedReport, table: Any) -> list[Table]:
    """Return what was found of a paper's parametrisation and estimates."""
    mine = report.parametrisation
    digits = table.decimals
    parameters = Table(
        "Parameters of the paper, their meaning, and the mean of its experiments",
        ("parameter", "meaning", "unit", "mean", "standard deviation"),
        tuple(
            (c.name, c.meaning, c.unit, f"{m:.{digits}f}", f"{s:.{digits}f}")
            for c, m, s in zip(
                mine.combinations, report.mean, report.standard_deviation, strict=True
            )
        ),
        tuple(
            f"{name}: differs from the printed table by at most {value:.1e}"
            for name, value in report.largest_differences.items()
        ),
    )
    inertia = Table(
        "Inertia about the centre of mass, from the mean",
        ("link", "A", "B", "C", "D", "E", "F"),
        tuple(
            # Adding zero turns a rounded -0.0 into 0.0.
            (link, *(f"{np.round(value, digits) + 0.0:.{digits}f}" for value in values))
            for link, values in report.central_inertia.items()
        ),
        tuple(
            f"as printed, {link}: {in_words(x)}"
            for link, x in report.mean_links.items()
            if x[0] > 0.0
        ),
    )
    return [parameters, inertia, _rank_table(report), *_vector_tables(report, table)]


def _rank_table(report: PublishedReport) -> Table:
    ranks = (report.all_columns, report.free_columns)
    return Table(
        "Rank of the paper's regressor along its verification motion",
        ("columns", "rank", "least non-zero singular value", "next"),
        tuple(
            (
                f"{len(rank.columns)} parameters",
                f"{rank.rank}",
                f"{rank.singular_values[rank.rank - 1]:.2e}",
                _next(rank.singular_values, rank.rank),
            )
            for rank in ranks
        ),
        (
            "Y^T Y is singular: the paper's eq. (6) has no unique solution. No torque "
            "changes along",
            *(f"  {direction}" for direction in report.free_columns.null_directions),
            "singular values of the regressor with unit columns, relative to the "
            "largest",
        ),
    )


def _next(singular_values: Array, rank: int) -> str:
    return f"{singular_values[rank]:.0e}" if rank < len(singular_values) else "-"


def _vector_tables(report: PublishedReport, table: Any) -> list[Table]:
    joints = report.parametrisation.model.robot.joint_names
    bodies = Table(
        "Bodies with the datasheet's masses and the published parameters",
        ("vector", "answer", "depth", "proven bound", "nearest body"),
        tuple(
            (
                v.name,
                v.feasibility.answer,
                f"{v.feasibility.proof.depth:.4f}",
                f"{v.feasibility.proof.bound:.4f}",
                v.nearest.certificate.verdict,
            )
            for v in report.vectors
        ),
        (
            "depth: largest least eigenvalue of J per typical mass and length; a "
            "negative bound proves that there is no body",
            *(f"{v.name}: {v.feasibility.summary}" for v in report.vectors),
        ),
    )
    printed = table.mean_squared_errors
    rows = [
        (v.name, *(f"{c:.4f} ({c**2:.4f})" for c in v.torque_change))
        for v in report.vectors
    ]
    rows += [
        (f"printed error {i}", *(f"{np.sqrt(e):.4f} ({e:.4f})" for e in row))
        for i, row in enumerate(printed, start=1)
    ]
    change = Table(
        "Torque change to the nearest consistent robot, beside the printed errors",
        ("vector", *joints),
        tuple(rows),
        ("RMS in N m along the verification motion; mean square in brackets",),
    )
    return [bodies, change]
