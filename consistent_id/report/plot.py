"""Plots as SVG: axes, what is drawn between them, and whole figures in files.

Colours of a page's small plots are classes of its style sheet, so that they follow
light and dark.  A figure in a file has its own.  A picture of Matplotlib, such as that
of a designed motion, is written as PNG.
"""

import base64
import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector
from consistent_id._support.run import kept_going
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.regression.row_names import in_newton
from consistent_id.regression.torque_along import measured_torque
from consistent_id.report.markup import Html, joined, tag
from consistent_id.robot.model import RobotModel

_LEFT, _RIGHT, _TOP = 46, 8, 8

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


@dataclass(frozen=True, slots=True)
class Frame:
    """The ranges of a plot, and its size in pixels.

    Parameters
    ----------
    x, y : (float, float)
        Least and largest value shown.
    width, height, bottom : int
        Numbers along the horizontal axis need a `bottom` of 32.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    width: int = 250
    height: int = 160
    bottom: int = 32

    def across(self, values: Vector | float) -> Vector:
        """Return horizontal places, in pixels."""
        low, high = self.x
        share = (np.asarray(values) - low) / (high - low)
        return np.asarray(_LEFT + share * (self.width - _LEFT - _RIGHT))

    def down(self, values: Vector | float) -> Vector:
        """Return vertical places, in pixels."""
        low, high = self.y
        share = (np.asarray(values) - low) / (high - low)
        return np.asarray(
            self.height - self.bottom - share * (self.height - _TOP - self.bottom)
        )


def spanning(values: Iterable[Vector], margin: float = 0.05) -> tuple[float, float]:
    """Return a range that contains all values, with some margin."""
    arrays = [np.ravel(v) for v in values]
    low = min((float(a.min()) for a in arrays if a.size), default=0.0)
    high = max((float(a.max()) for a in arrays if a.size), default=1.0)
    spread = high - low or abs(high) or 1.0
    return low - margin * spread, high + margin * spread


def ticks(span: tuple[float, float], most: int = 5) -> list[float]:
    """Return round numbers within a range, at most so many.

    Examples
    --------
    >>> ticks((-0.3, 2.2))
    [0.0, 0.5, 1.0, 1.5, 2.0]
    """
    low, high = span
    rough = (high - low) / most
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(float(power * m) for m in (1, 2, 5, 10) if power * m >= rough)
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    return [round(i * step, 12) + 0.0 for i in range(first, last + 1)]


def line(frame: Frame, x: Vector, y: Vector, style: str) -> Html:
    """Return a curve through points."""
    return _path("M" + "L".join(_points(frame, x, y)), style)


def dots(frame: Frame, x: Vector, y: Vector, style: str) -> Html:
    """Return a dot for each point: short strokes with round ends."""
    return _path("".join(f"M{p}h0" for p in _points(frame, x, y)), f"dots {style}")


def band(frame: Frame, x: Vector, low: Vector, high: Vector, style: str) -> Html:
    """Return the area between two curves."""
    there, back = _points(frame, x, low), _points(frame, x, high)
    return _path("M" + "L".join([*there, *reversed(back)]) + "Z", style)


def stems(frame: Frame, x: Vector, y: Vector, style: str) -> Html:
    """Return vertical lines from zero to each point."""
    foot = float(frame.down(0.0))
    places = zip(frame.across(x), frame.down(y), strict=True)
    return _path("".join(f"M{a:.1f} {foot:.1f}V{b:.1f}" for a, b in places), style)


def plot(
    frame: Frame, *marks: Html, across: str = "", down: str = "", title: str = ""
) -> Html:
    """Return a figure: axes with ticks and labels, and the marks."""
    drawing = tag(
        "svg",
        axes_with(frame, *marks, across=across, down=down),
        viewBox=f"0 0 {frame.width} {frame.height}",
        role="img",
        aria_label=title or f"{down} against {across}",
        class_="plot",
    )
    return tag("figure", tag("figcaption", title) if title else "", drawing)


def axes_with(frame: Frame, *marks: Html, across: str = "", down: str = "") -> Html:
    """Return the elements of a plot: axes with ticks and labels, and the marks."""
    middle = _LEFT + (frame.width - _LEFT - _RIGHT) / 2
    centre = (frame.height - frame.bottom) / 2 + 4
    label = (
        tag("text", down, transform=f"translate(10 {centre:g})rotate(-90)")
        if down
        else ""
    )
    below = _text(middle, frame.height - 3, across, "label")
    return joined((_grid(frame), *marks, below, label))


def _grid(frame: Frame) -> Html:
    right, bottom = frame.width - _RIGHT, frame.height - frame.bottom
    parts: list[Html] = []
    for value in ticks(frame.x):
        a = float(frame.across(value))
        parts.append(_path(f"M{a:.1f} {_TOP}V{bottom}", "grid"))
        if frame.bottom > 13:
            parts.append(_text(a, bottom + 13, f"{value:g}"))
    for value in ticks(frame.y, 4):
        b = float(frame.down(value))
        parts.append(_path(f"M{_LEFT} {b:.1f}H{right}", "grid"))
        parts.append(_text(_LEFT - 4, b + 3.5, f"{value:g}", "end"))
    if frame.y[0] < 0.0 < frame.y[1]:
        parts.append(_path(f"M{_LEFT} {float(frame.down(0.0)):.1f}H{right}", "zero"))
    return joined(parts)


def _points(frame: Frame, x: Vector, y: Vector) -> list[str]:
    # Floats of Python are turned into text in half the time that NumPy's take.
    pairs = zip(frame.across(x).tolist(), frame.down(y).tolist(), strict=True)
    return [f"{a:.1f} {b:.1f}" for a, b in pairs]


def _path(d: str, style: str) -> Html:
    return tag("path", d=d, class_=style)


def _text(x: float, y: float, content: str, style: str | None = None) -> Html:
    if not content:
        return Html()
    return tag("text", content, x=f"{x:.1f}", y=f"{y:.1f}", class_=style)


_LEVELS = 65535


def buckets(samples: int, most: int) -> IntArray:
    """Return the starts of buckets of samples that give at most so many points.

    Each bucket gives two points, see `extremes`; where there are few enough samples
    each is a bucket of its own and gives one.
    """
    size = 1 if samples <= most else int(np.ceil(2 * samples / most))
    return np.arange(0, samples, size)


def extremes(values: Vector, starts: IntArray) -> Vector:
    """Return the least and the largest value of every bucket, in the order of time.

    Parameters
    ----------
    values : ndarray, shape (samples,)
    starts : ndarray, shape (buckets,)
        See `buckets`.

    Returns
    -------
    ndarray, shape (2 buckets,), or (samples,) if each sample is a bucket

    Examples
    --------
    >>> extremes(np.array([1.0, 5.0, 2.0, 0.0, 3.0, 3.0]), np.array([0, 3]))
    array([1., 5., 0., 3.])
    """
    if len(starts) == len(values):
        return values
    size = int(starts[1] - starts[0]) if len(starts) > 1 else len(values)
    # The last bucket is filled up with its own last value, which is no new extreme.
    whole = np.pad(values, (0, size * len(starts) - len(values)), mode="edge")
    each = whole.reshape(len(starts), size)
    pairs = np.column_stack([each.min(axis=1), each.max(axis=1)])
    falling = each.argmin(axis=1) > each.argmax(axis=1)
    pairs[falling] = pairs[falling, ::-1]
    return np.asarray(pairs.ravel())


def instants(time: Vector, starts: IntArray) -> Vector:
    """Return when the points of `extremes` are drawn, shape as there, [s].

    A bucket's two points stand at its start and its middle.
    """
    if len(starts) == len(time):
        return time
    ends = np.append(starts[1:], len(time))
    places = np.empty(2 * len(starts), dtype=np.intp)
    places[0::2], places[1::2] = starts, (starts + ends) // 2
    return np.asarray(time[places])


def packed(values: Array) -> dict[str, object]:
    """Return numbers in 16 bits each, as text: ``low + step * unsigned``.

    The rounding is below a hundred thousandth of the range.
    """
    low, high = float(values.min()), float(values.max())
    step = (high - low) / _LEVELS
    counts = np.zeros(len(values)) if step == 0.0 else (values - low) / step
    data = np.rint(counts).astype("<u2").tobytes()
    return {"low": low, "step": step, "data": base64.b64encode(data).decode()}


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
