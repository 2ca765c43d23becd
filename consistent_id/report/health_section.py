"""Section: the diagnosis of the recordings."""

from collections.abc import Sequence

from consistent_id.diagnosis.findings import Diagnosis, LogFinding, diagnosis_table
from consistent_id.recordings.recording import Recording
from consistent_id.report.markup import (
    Html,
    folded,
    grid,
    joined,
    listed,
    paragraphs,
    tag,
)
from consistent_id.report.report_content import ReportContent, Section

_STYLE = {"fault": "bad", "warning": "care", "note": "muted"}


def health_section(content: ReportContent) -> Section | None:
    """Return recordings and their faults; None without recordings."""
    if not content.training and not content.validation:
        return None
    parts = [_recordings(content)]
    found = content.diagnosis
    if found is None:
        parts.append(paragraphs("These recordings were not examined for faults."))
    else:
        parts.append(tag("p", tag("strong", _in_short(found))))
        parts.append(_findings(found.suspicious))
        notes = [f for f in found.findings if f.severity == "note"]
        said = [f"{f.recording}, {f.where}: {f.statement}" for f in notes]
        if said:
            parts.append(folded(f"Notes ({len(said)})", listed(said)))
        if not found.suspicious:
            parts.append(paragraphs(diagnosis_table(found).notes[-1], class_="notes"))
    return Section("health", "Health of the data", joined(parts))


def _recordings(content: ReportContent) -> Html:
    rows = [
        *(_row(r, "training") for r in content.training),
        *(_row(r, "held out") for r in content.validation),
    ]
    header = ("recording", "role", "samples", "duration [s]", "rate [Hz]", "from [s]")
    return grid(header, rows)


def _row(recording: Recording, role: str) -> list[object]:
    return [
        recording.name,
        role,
        str(len(recording)),
        f"{recording.duration:.4g}",
        f"{recording.rate:.4g}",
        f"{recording.time[0]:.4g}",
    ]


def _in_short(found: Diagnosis) -> str:
    faults = len(found.faults)
    warnings = len(found.suspicious) - faults
    if not found.suspicious:
        return "Nothing suspicious was found."
    return f"Found: {faults} faults, which make estimates wrong, {warnings} warnings."


def _findings(found: Sequence[LogFinding]) -> Html:
    if not found:
        return Html()
    rows = [
        (
            tag("span", f.severity, class_=_STYLE[f.severity]),
            f.kind,
            f"{f.recording}, {f.where}",
            f.statement,
            f.advice,
        )
        for f in found
    ]
    return grid(("severity", "kind", "where", "seen", "to do"), rows, class_="prose")
