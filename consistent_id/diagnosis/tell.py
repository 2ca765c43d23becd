"""A diagnosis in a table, for people, and in plain text for JSON."""

from dataclasses import asdict
from typing import Any

from consistent_id.diagnosis.findings import Diagnosis
from consistent_id.tables import Table

_LOOKED_FOR = (
    "clocks, units, signs, exchanged channels, zeros, lags, dead and saturated "
    "channels, rests, joints that did not move, and validation that repeats training"
)


def diagnosis_table(found: Diagnosis) -> Table:
    """Return the findings, the gravest first, with what to do about each."""
    where = f" in {', '.join(found.recordings)}" if found.recordings else ""
    if not found.findings:
        title = f"Nothing suspicious was found{where}"
        return Table(title, (), (), (f"looked for: {_LOOKED_FOR}",))
    return Table(
        f"What was found{where}",
        ("gravity", "kind", "where", "recording"),
        tuple((f.severity, f.kind, f.where, f.recording) for f in found.findings),
        tuple(
            f"{f.kind} ({f.where}): {f.statement}. To do: {f.advice}"
            for f in found.findings
        ),
    )


def diagnosis_record(found: Diagnosis) -> dict[str, Any]:
    """Return the findings as plain numbers and text."""
    return {
        "format": "consistent_id diagnosis 1",
        "recordings": list(found.recordings),
        "findings": [asdict(f) for f in found.findings],
    }
