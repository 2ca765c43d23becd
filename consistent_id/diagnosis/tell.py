"""A diagnosis in a table, for people, and in plain text for JSON."""

from dataclasses import asdict
from typing import Any

from consistent_id.diagnosis.findings import Diagnosis
from consistent_id.tables import Table


def diagnosis_table(found: Diagnosis) -> Table:
    """Return the findings, the gravest first, with what to do about each."""
    if not found.findings:
        return Table("Nothing suspicious was found", (), ())
    return Table(
        "What was found",
        ("gravity", "kind", "where"),
        tuple((f.severity, f.kind, f.where) for f in found.findings),
        tuple(
            f"{f.kind} ({f.where}): {f.statement}. {f.advice}" for f in found.findings
        ),
    )


def diagnosis_record(found: Diagnosis) -> dict[str, Any]:
    """Return the findings as plain numbers and text."""
    return {
        "format": "consistent_id diagnosis 1",
        "findings": [asdict(f) for f in found.findings],
    }
