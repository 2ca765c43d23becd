"""Small line plots as SVG: axes, and what is drawn between them.

Colours are classes of the page's style sheet, so that they follow light and dark.
"""

import base64
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector
from consistent_id.report.markup import Html, joined, tag

_LEFT, _RIGHT, _TOP = 46, 8, 8


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
    pairs = zip(frame.across(x), frame.down(y), strict=True)
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
