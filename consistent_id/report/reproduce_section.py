"""Section: how to get the same figures again."""

import platform
from hashlib import sha256
from pathlib import Path

from consistent_id.problems.problem import Problem
from consistent_id.report.markup import Html, folded, grid, joined, paragraphs, tag
from consistent_id.report.report_content import ReportContent, Section

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
