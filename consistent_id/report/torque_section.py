"""Section: measured against predicted torque."""

import json

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.recordings.recording import Recording
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.report.markup import Html, folded, joined, paragraphs, tag
from consistent_id.report.plot import (
    Frame,
    buckets,
    extremes,
    instants,
    line,
    packed,
    plot,
    spanning,
)
from consistent_id.report.report_content import ReportContent, Section

_MOST = 6000  # points embedded for zooming
_STATIC = 360  # points drawn before the script has run

_BUTTONS = (("in", "+"), ("out", "-"), ("left", "◀"), ("right", "▶"), ("all", "all"))


def torque_section(content: ReportContent) -> Section | None:
    """Return a zoomable plot for each joint of each recording; None without any."""
    if not content.held_out:
        return None
    where = "held-out" if content.validation else "training"
    shown = [
        folded(f"On {recording.name}", _zoomable(content, recording), open_=i == 0)
        for i, recording in enumerate(content.held_out)
    ]
    hint = tag(
        "p",
        "Drag across a plot to zoom in, double-click for all of it; the buttons do the "
        "same. All joints of a recording move together.",
        class_="script",
    )
    lead = paragraphs(
        f"Torque along {where} motion. The lower plots show measured minus predicted "
        "torque."
    )
    return Section(
        "torque", "Measured and predicted torque", joined((lead, hint, *shown))
    )


def _zoomable(content: ReportContent, recording: Recording) -> Html:
    names = [content.main.estimate.method]
    traces = [content.main.estimate.predict(recording)]
    if content.plain is not None:
        names.append(content.plain.estimate.method)
        traces.append(content.plain.estimate.predict(recording))
    if recording.torque is None and not content.model.robot.floating:
        return paragraphs("This recording has no torque.")
    measured = motion_of(content.model, recording, None).torque
    panels = []
    for column, name, unit, _ in content.rows:
        torque = measured[:, column]
        predicted = [trace[:, column] for trace in traces]
        rests = [torque - trace for trace in predicted]
        rms = np.sqrt(np.mean(rests[0] ** 2))
        caption = f"{name} (RMS error {rms:.3g} {unit})"
        above = _panel(recording.time, [torque, *predicted], unit, "above")
        below = _panel(recording.time, rests, unit, "below")
        panels.append(tag("div", tag("h4", caption), above, below, class_="pair"))
    return joined(
        (
            tag("div", _legend(names), _buttons(), class_="tools"),
            tag("div", _times(recording.time), *panels, class_="zoomable"),
        )
    )


def _panel(time: Vector, traces: list[Vector], unit: str, place: str) -> Html:
    """Return one plot: a coarse drawing, and finer numbers for the script."""
    names = ["measured", "main", "plain"] if place == "above" else ["main", "plain"]
    styled = list(zip(names, traces, strict=False))
    # The last curve is on top: the estimate in use.
    styled.sort(key=lambda pair: ("measured", "plain", "main").index(pair[0]))
    coarse = buckets(len(time), _STATIC)
    height, bottom = (140, 6) if place == "above" else (120, 32)
    frame = Frame((time[0], time[-1]), spanning(traces), 720, height, bottom)
    drawn = [
        line(frame, instants(time, coarse), extremes(values, coarse), f"curve {name}")
        for name, values in styled
    ]
    fine = buckets(len(time), _MOST)
    record = [{"name": n, **packed(extremes(v, fine))} for n, v in styled]
    across = "time [s]" if place == "below" else ""
    return tag(
        "div",
        plot(frame, *drawn, across=across, down=f"[{unit}]"),
        _data(record, "trace"),
        class_=f"zoom {place}",
        data_height=height,
        data_bottom=bottom,
        data_unit=f"[{unit}]",
    )


def _times(time: Vector) -> Html:
    return _data(packed(instants(time, buckets(len(time), _MOST))), "times")


def _data(record: object, kind: str) -> Html:
    """Return numbers for the script; no text in them can end the element."""
    content = json.dumps(record).replace("<", "\\u003c")
    return tag("script", Html(content), type="application/json", class_=kind)


def _legend(names: list[str]) -> Html:
    shown = zip(("measured", "main", "plain"), ("measured", *names), strict=False)
    return tag(
        "span",
        *(
            tag("span", tag("i", class_=f"key {style}"), name, class_="entry")
            for style, name in shown
        ),
    )


def _buttons() -> Html:
    return tag(
        "span",
        *(
            tag(
                "button", sign, type="button", data_zoom=what, aria_label=f"zoom {what}"
            )
            for what, sign in _BUTTONS
        ),
        class_="script",
    )
