"""Section: what the training motion can tell."""

from consistent_id.recordings.recording import Recording
from consistent_id.report.findings import Findings, Section, angle_unit
from consistent_id.report.markup import (
    Html,
    folded,
    joined,
    paragraphs,
    table_html,
    tag,
)
from consistent_id.report.plot import Frame, line, plot, spanning
from consistent_id.report.summary import excitation_table
from consistent_id.report.thinning import buckets, extremes, instants

_POINTS = 400


def excitation_section(findings: Findings) -> Section | None:
    """Return rank, condition and motion; None where they are not known."""
    if findings.excitation is None:
        return None
    drawn = [_motion(findings, recording) for recording in findings.training]
    body = joined(
        (
            paragraphs(
                "The structural rank is what any motion could determine; the data "
                "rank is what this one does. A small condition number means that "
                "noise is not amplified."
            ),
            table_html(excitation_table(findings.excitation, findings.training)),
            *(
                folded(f"Motion of {recording.name}", panels)
                for recording, panels in zip(findings.training, drawn, strict=True)
            ),
        )
    )
    return Section("excitation", "Excitation and rank", body)


def _motion(findings: Findings, recording: Recording) -> Html:
    robot = findings.model.robot
    log = recording.of(robot.joint_names)
    starts = buckets(len(log), _POINTS)
    time = instants(log.time, starts)
    panels = []
    for j, joint in enumerate(robot.joints):
        q = extremes(log.position[:, j], starts)
        frame = Frame((time[0], time[-1]), spanning([q]), height=130)
        curve = line(frame, time, q, "curve main")
        unit = f"[{angle_unit(joint)}]"
        panels.append(
            plot(frame, curve, across="time [s]", down=unit, title=joint.name)
        )
    return tag("div", *panels, class_="panels")
