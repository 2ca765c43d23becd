"""Sections on data: findings of the diagnosis, and what the motion identifies."""

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
    table_html,
    tag,
)
from consistent_id.report.plot import (
    Frame,
    buckets,
    extremes,
    instants,
    line,
    plot,
    spanning,
)
from consistent_id.report.report_content import ReportContent, Section, angle_unit
from consistent_id.report.summary import excitation_table

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


_POINTS = 400


def excitation_section(content: ReportContent) -> Section | None:
    """Return rank, condition and motion; None where they are not known."""
    if content.excitation is None:
        return None
    drawn = [_motion(content, recording) for recording in content.training]
    body = joined(
        (
            paragraphs(
                "The structural rank counts the parameters that any motion could "
                "determine. The data rank counts those that this motion determines. A "
                "small condition number means that noise is not amplified."
            ),
            table_html(excitation_table(content.excitation, content.training)),
            *(
                folded(f"Motion of {recording.name}", panels)
                for recording, panels in zip(content.training, drawn, strict=True)
            ),
        )
    )
    return Section("excitation", "Excitation and rank", body)


def _motion(content: ReportContent, recording: Recording) -> Html:
    robot = content.model.robot
    if not len(robot):
        return paragraphs("The motion is that of the arm that carries the sensor.")
    log = recording.of(robot.joint_names)
    starts = buckets(len(log), _POINTS)
    time = instants(log.time, starts)
    panels = []
    for j, joint in enumerate(robot.driven):
        q = extremes(log.position[:, j], starts)
        frame = Frame((time[0], time[-1]), spanning([q]), height=130)
        curve = line(frame, time, q, "curve main")
        unit = f"[{angle_unit(joint)}]"
        panels.append(
            plot(frame, curve, across="time [s]", down=unit, title=joint.name)
        )
    return tag("div", *panels, class_="panels")
