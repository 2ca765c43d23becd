"""Section: a paper's own parameters, its tables, and the command that does it again."""

import platform
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.tables import Table
from consistent_id.comparison.feasibility import in_words
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import PublishedReport
from consistent_id.report.markup import (
    Html,
    folded,
    grid,
    joined,
    paragraphs,
    table_html,
    tag,
)
from consistent_id.report.report_content import ReportContent, Section


def published_section(content: ReportContent) -> Section | None:
    """Return the section on a paper; None for a problem without one."""
    problem, report = content.problem, content.published
    if problem is None or report is None or problem.table.published is None:
        return None
    first, *others = published_tables(report, problem.table.published)
    body = joined(
        (
            paragraphs(problem.table.published.source),
            table_html(first),
            *(folded(t.title, table_html(t, titled=False)) for t in others),
        )
    )
    return Section("published", "As published", body)


def published_tables(report: PublishedReport, table: Any) -> list[Table]:
    """Return tables on a paper's parametrisation and estimates."""
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
    consistency = Table(
        "Consistent robots with the datasheet's masses and the published parameters",
        ("vector", "answer", "margin", "proven bound", "nearest consistent robot"),
        tuple(
            (
                v.name,
                v.feasibility.answer,
                f"{v.feasibility.proof.margin:.4f}",
                f"{v.feasibility.proof.bound:.4f}",
                v.nearest.certificate.verdict,
            )
            for v in report.vectors
        ),
        (
            "margin: consistency margin, the largest least eigenvalue of J per "
            "typical mass and length; a negative bound proves that no such robot "
            "exists",
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
    return [consistency, change]


_PACKAGES = ("consistent-id", "numpy", "scipy", "clarabel", "pin", "cvxpy", "casadi")
_CHUNK = 1 << 20  # bytes


def reproduce_section(content: ReportContent) -> Section:
    """Return command, seed, versions, files and their hashes."""
    rows: list[tuple[object, object]] = []
    if content.command:
        rows.append(("command", tag("code", content.command)))
    if content.seed is not None:
        rows.append(("seed of the bootstrap", str(content.seed)))
    rows.append(("torque model", tag("code", content.model.fingerprint)))
    seconds = sum(r.estimate.seconds for r in content.comparison.reports)
    rows.append(("estimation", f"{seconds:.1f} s for all estimates"))
    rows.append(("Python", f"{platform.python_version()}, {platform.machine()}"))
    rows += [(name, found) for name in _PACKAGES if (found := _version(name))]
    parts = [grid(("what", "which"), rows)]
    if content.problem is not None:
        parts.append(_files(content.problem))
    return Section("reproduce", "How to reproduce this", joined(parts))


def _files(problem: Problem) -> Html:
    files = problem.files
    rows = [(name, tag("code", _digest(path))) for name, path in files.items()]
    parts = [grid(("file", "SHA-256"), rows)] if rows else []
    about = (problem.table.description, problem.table.source, problem.table.licence)
    parts.insert(0, paragraphs(*(text for text in about if text)))
    if problem.source is not None:
        text = problem.source.read_text(encoding="utf-8", errors="replace")
        parts.append(folded("The problem file", tag("pre", tag("code", text))))
    return joined(parts)


def _version(package: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _digest(path: Path) -> str:
    if not path.is_file():
        return "not there any more"
    digest = sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
