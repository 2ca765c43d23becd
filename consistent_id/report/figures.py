"""Figures in files: joint motion, and measured and predicted torque, as SVG.

A picture of Matplotlib, such as that of a designed motion, is written as PNG.
"""

import logging
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from consistent_id._support.arrays import Vector
from consistent_id._support.run import kept_going
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.regression.row_names import in_newton
from consistent_id.regression.torque_along import measured_torque
from consistent_id.report.markup import Html, joined, tag
from consistent_id.report.plot import (
    Frame,
    axes_with,
    buckets,
    extremes,
    instants,
    line,
    spanning,
)
from consistent_id.robot.model import RobotModel

_log = logging.getLogger(__name__)
_POINTS = 900  # drawn per curve; more would not be visible
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_MEASURED = "#999"
_WIDTH, _HEIGHT, _GAP, _HEAD, _BELOW = 470, 120, 14, 44, 20  # pixels
_MARK = "<!-- consistent-id: figure -->\n"
_STYLE = """
text { font: 10.5px sans-serif; fill: #444; text-anchor: middle; }
text.end { text-anchor: end; } text.title { font-size: 14px; fill: #000; }
path { fill: none; stroke-width: 1; stroke-linejoin: round; }
.grid { stroke: #ddd; } .zero { stroke: #aaa; }
.measured { stroke: #999; stroke-width: 2.6; }
"""


def motion_figure(robot: RobotModel, recording: Recording) -> Html:
    """Return the joints' positions over time, as SVG."""
    recording = recording.of(robot.joint_names)
    panels = [
        [_panel(recording.time, [("c0", q)], f"{joint.name} [{unit}]")]
        for joint, q, unit in zip(
            robot.driven,
            recording.position.T,
            ("m" if joint.kind == "prismatic" else "rad" for joint in robot.driven),
            strict=True,
        )
    ]
    return _figure(f"joint motion: {recording.name}", panels, ())


def torque_figure(estimates: Sequence[Estimate], recording: Recording) -> Html:
    """Return measured and predicted torque, and their difference, as SVG.

    A row of panels for each joint with torque.
    """
    model, time = estimates[0].model, recording.time
    measured = measured_torque(model, recording)
    predicted = [estimate.predict(recording) for estimate in estimates]
    panels = []
    for j, name in enumerate(model.torque_joints):
        unit = "N" if in_newton(model.robot, name) else "N m"
        own = [(f"c{k}", values[:, j]) for k, values in enumerate(predicted)]
        rests = [(style, measured[:, j] - values) for style, values in own]
        left = _panel(time, [("measured", measured[:, j]), *own], f"{name} [{unit}]")
        panels.append([left, _panel(time, rests, "measured less predicted")])
    names = [("measured", _MEASURED)]
    names += [(e.method, _colour(k)) for k, e in enumerate(estimates)]
    return _figure(f"torque: {recording.name}", panels, names)


def write_figure(figure: Html, path: Path) -> Path:
    """Write a figure as SVG, whole or not at all."""
    from consistent_id._support.files import write_atomically

    return write_atomically(path, _MARK + figure + "\n")


def draw_figure(draw: Callable[[], Any], path: Path) -> list[Path]:
    """Write a figure of Matplotlib as PNG; return the file, if it could be drawn.

    Other results do not depend on it.  Without Matplotlib, the log says how to get it.
    """
    import io

    from consistent_id._support.files import write_atomically

    if find_spec("matplotlib") is None:
        _log.warning(
            "%s is not drawn; it needs matplotlib: pip install 'consistent-id[plots]'",
            path.name,
        )
        return []
    with kept_going(f"figure {path.name}"):
        buffer = io.BytesIO()
        draw().savefig(
            buffer,
            format="png",
            dpi=110,
            metadata={"Software": "consistent-id: figure"},
            pil_kwargs={"compress_level": 1},
        )
        return [write_atomically(path, buffer.getvalue())]
    return []


def _panel(time: Vector, curves: Sequence[tuple[str, Vector]], label: str) -> Html:
    """Return axes with curves, each with its style, the last one on top."""
    starts = buckets(len(time), _POINTS)
    frame = Frame(
        (float(time[0]), float(time[-1])),
        spanning(values for _, values in curves),
        _WIDTH,
        _HEIGHT,
        20,
    )
    drawn = [
        line(frame, instants(time, starts), extremes(values, starts), style)
        for style, values in curves
    ]
    return axes_with(frame, *drawn, down=label)


def _figure(
    title: str, rows: Sequence[Sequence[Html]], names: Sequence[tuple[str, str]]
) -> Html:
    """Return rows of panels below a title and a legend of names and their colours."""
    width = max((len(row) for row in rows), default=1) * (_WIDTH + _GAP)
    height = _HEAD + len(rows) * (_HEIGHT + _GAP) + _BELOW
    head = [tag("text", title, x=width / 2, y=16, class_="title")]
    for k, (name, colour) in enumerate(names):
        x = (k + 0.5) * width / len(names)
        head.append(tag("text", name, x=f"{x:.0f}", y=34, style=f"fill: {colour}"))
    across, down = _WIDTH + _GAP, _HEIGHT + _GAP
    placed = [
        tag("g", panel, transform=f"translate({i * across} {_HEAD + j * down})")
        for j, row in enumerate(rows)
        for i, panel in enumerate(row)
    ]
    colours = "".join(f".c{k} {{ stroke: {_colour(k)}; }}\n" for k in range(len(names)))
    style = _STYLE + (colours or f".c0 {{ stroke: {_colour(0)}; }}\n")
    foot = tag("text", "time [s]", x=width / 2, y=height - 5)
    return tag(
        "svg",
        tag("style", Html(style)),
        tag("rect", width="100%", height="100%", fill="white"),
        joined((*head, *placed, foot)),
        xmlns="http://www.w3.org/2000/svg",
        width=width,
        height=height,
        viewBox=f"0 0 {width} {height}",
    )


def _colour(k: int) -> str:
    return _COLOURS[k % len(_COLOURS)]
