"""Findings of the lint for people, for programs, and as SARIF 2.1.0."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from consistent_id.export.lint.described import LintFinding
from consistent_id.export.lint.rules import RULES

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
Findings = Mapping[str, Sequence[LintFinding]]


def lint_text(found: Findings) -> str:
    """Return a line for each finding, and their number."""
    lines = [
        f"{path}:{f.line}: {f.severity}: {f.sentence} [{f.rule}]"
        for path, findings in found.items()
        for f in findings
    ]
    errors = sum(f.severity == "error" for of in found.values() for f in of)
    files = f"{len(found)} file{'s' * (len(found) != 1)}"
    lines.append(f"{files}: {errors} errors, {len(lines) - errors} warnings")
    return "\n".join(lines)


def lint_record(found: Findings) -> dict[str, Any]:
    """Return findings as plain values, ready for JSON."""
    return {
        "format": "consistent_id lint 1",
        "files": {path: [asdict(f) for f in of] for path, of in found.items()},
    }


def sarif(found: Findings, version: str) -> dict[str, Any]:
    """Return findings as SARIF 2.1.0, which code hosts show beside the lines."""
    rules = [{"id": k, "shortDescription": {"text": v}} for k, v in RULES.items()]
    driver = {"name": "consistent-id", "version": version, "rules": rules}
    results = [_result(path, f) for path, of in found.items() for f in of]
    run = {"tool": {"driver": driver}, "results": results}
    return {"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}


def _result(path: str, finding: LintFinding) -> dict[str, Any]:
    place = {
        "artifactLocation": {"uri": path.replace("\\", "/")},
        "region": {"startLine": finding.line},
    }
    return {
        "ruleId": finding.rule,
        "level": finding.severity,
        "message": {"text": finding.sentence},
        "locations": [{"physicalLocation": place}],
    }
