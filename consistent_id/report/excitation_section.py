"""Section: the parameters that the training motion makes identifiable."""

from consistent_id.recordings.recording import Recording
from consistent_id.report.markup import (
    Html,
    folded,
    joined,
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
