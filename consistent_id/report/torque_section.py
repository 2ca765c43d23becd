"""Sections on torque: measured against predicted, and friction over velocity."""

import json

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.torque_along import measured_torque, predicted_torque
from consistent_id.report.markup import Html, folded, grid, joined, paragraphs, tag
from consistent_id.report.plot import (
    Frame,
    buckets,
    dots,
    extremes,
    instants,
    line,
    packed,
    plot,
    spanning,
)
from consistent_id.report.report_content import (
    ReportContent,
    Section,
    angle_unit,
    torque_unit,
)

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
    measured = measured_torque(content.model, recording)
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


_DOTS = 500


def friction_section(content: ReportContent) -> Section | None:
    """Return a friction curve for each joint; None without friction or recordings."""
    model, estimate = content.model, content.main.estimate
    columns = friction_columns(model)
    recordings = content.training or content.validation
    if not len(columns) or not recordings:
        return None
    found = [observed_friction(estimate, r, columns) for r in recordings]
    seen, said, dq = (np.concatenate(parts) for parts in zip(*found, strict=True))
    panels = []
    for j, (_, joint) in enumerate(content.joint_rows):
        thin = slice(None, None, max(1, len(seen) // _DOTS))
        x, y, f = dq[thin, j], seen[thin, j], said[thin, j]
        frame = Frame(spanning([x]), spanning([y, f]), height=200)
        panels.append(
            plot(
                frame,
                dots(frame, x, y, "measured"),
                dots(frame, x, f, "main fine"),
                across=f"velocity [{angle_unit(joint)}/s]",
                down=f"friction [{torque_unit(joint)}]",
                title=joint.name,
            )
        )
    lead = paragraphs(
        "The coloured curve is the identified friction, offsets included. Grey dots "
        "are the measured torque minus all that is not friction. Friction that depends "
        "on the load or on another joint's rate is not a single curve."
    )
    rows = [
        (estimate.model.layout.names[i], f"{estimate.parameters[i]:.4g}", unit)
        for i, unit in zip(columns, _units(model, columns), strict=True)
    ]
    body = joined(
        (
            lead,
            tag("div", *panels, class_="panels"),
            folded("Coefficients", grid(("coefficient", "value", "unit"), rows)),
        )
    )
    return Section("friction", "Friction", body)


def friction_columns(model: TorqueModel) -> IntArray:
    """Return the indices of the parameters of friction and offsets."""
    start = model.layout.inertial_size
    places = [i for i, t in enumerate(model.column_terms, start) if t.friction]
    return np.array(places, dtype=np.intp)


def observed_friction(
    estimate: Estimate, recording: Recording, columns: IntArray
) -> tuple[Array, Array, Array]:
    """Return observed and identified friction, and the joints' rates.

    Observed is ``tau - Y x + Y_f x_f``, with ``f`` the friction's columns.  All of
    shape (samples, joints with torque).
    """
    model = estimate.model
    alone = np.zeros_like(estimate.parameters)
    alone[columns] = estimate.parameters[columns]
    identified = predicted_torque(model, alone, recording)
    rest = measured_torque(model, recording) - estimate.predict(recording)
    of_joints = {name: k for k, name in enumerate(model.robot.joint_names)}
    rows = [c for c, j in enumerate(model.torque_joints) if j in of_joints]
    joints = [of_joints[model.torque_joints[c]] for c in rows]
    seen = rest + identified
    speed = velocities(recording.of(model.robot.joint_names))
    return seen[:, rows], identified[:, rows], speed[:, joints]


def _units(model: TorqueModel, columns: IntArray) -> list[str]:
    return [model.layout.units[i] for i in columns]
