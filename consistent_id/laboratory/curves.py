"""Curves in space that a robot writes, as exact functions of a parameter.

A curve runs from ``u = 0`` to ``u = 1``.  Circle, ellipse, bulb, ellipsoid and helix
are all of one form,

    c(u) = offset + slope u + sum_k  sine_k sin(w_k u) + cosine_k cos(w_k u)

so one text differentiates them all; a path through points of one's own is a spline.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, checked, freeze_arrays
from consistent_id.errors import ProblemError
from consistent_id.recordings.joint_paths import sinusoids

_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_PIECES = 400  # of a curve whose length is measured, each with a rule of eight points
_REFITS = 8  # of a spline's knots to its own lengths


class Curve(Protocol):
    """A smooth curve in space, from ``u = 0`` to ``u = 1``."""

    def evaluate(self, u: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and derivatives by `u`, (derivatives + 1, samples, 3), [m].

        A curve must have two continuous derivatives.
        """


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicCurve:
    """A straight line, and sines and cosines about it.

    Parameters
    ----------
    rates : array_like, shape (terms,), [rad]
        Rates of each term's angle over the whole curve.
    sine, cosine : array_like, shape (terms, 3), [m]
    offset, slope : array_like, shape (3,), [m]
    """

    rates: Vector
    sine: Matrix
    cosine: Matrix
    offset: Vector
    slope: Vector

    def __post_init__(self) -> None:
        terms = len(np.atleast_1d(self.rates))
        shapes = {"rates": (terms,), "sine": (terms, 3), "cosine": (terms, 3)}
        freeze_arrays(self, shapes | {"offset": (3,), "slope": (3,)}, "curve")

    def evaluate(self, u: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and derivatives by `u`, (derivatives + 1, samples, 3)."""
        u = checked(u, (None,), "u")
        values = sinusoids(u, self.rates, self.sine, self.cosine, derivatives)
        values[0] += self.offset + np.outer(u, self.slope)
        if derivatives:
            values[1] += self.slope
        return values


@dataclass(frozen=True, slots=True, eq=False)
class SplineCurve:
    """A cubic spline, with its derivatives."""

    spline: Any

    def evaluate(self, u: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and derivatives by `u`, (derivatives + 1, samples, 3)."""
        u = checked(u, (None,), "u")
        return np.array([self.spline(u, order) for order in range(derivatives + 1)])


def circle(
    radius: float,
    *,
    centre: ArrayLike,
    along: ArrayLike = _X,
    across: ArrayLike = _Y,
    turns: float = 1.0,
) -> HarmonicCurve:
    """Return a circle that starts at ``centre + radius along``, towards `across`.

    Parameters
    ----------
    radius : float, [m]
    centre : array_like, shape (3,), [m]
    along, across : array_like, shape (3,)
        Directions that span the plane; `across` is made perpendicular to `along`.

    Examples
    --------
    >>> drawn = circle(0.1, centre=[0.4, 0, 0.3], across=[0, 0, 1])
    >>> drawn.evaluate([0, 0.25])[0].round(3).tolist()
    [[0.5, 0.0, 0.3], [0.4, 0.0, 0.4]]
    """
    semi_axes = (radius, radius)
    return ellipse(semi_axes, centre=centre, along=along, across=across, turns=turns)


def ellipse(
    semi_axes: tuple[float, float],
    *,
    centre: ArrayLike,
    along: ArrayLike = _X,
    across: ArrayLike = _Y,
    turns: float = 1.0,
) -> HarmonicCurve:
    """Return an ellipse that starts at the end of its first semi-axis; see `circle`."""
    return bulb(
        semi_axes, taper=0.0, centre=centre, along=along, across=across, turns=turns
    )


def bulb(
    semi_axes: tuple[float, float],
    *,
    taper: float = 0.5,
    centre: ArrayLike,
    along: ArrayLike = _X,
    across: ArrayLike = _Y,
    turns: float = 1.0,
) -> HarmonicCurve:
    """Return the outline of a bulb: an ellipse that narrows towards one end.

    ``a cos(phi) along + b sin(phi) (1 + taper cos(phi)) across``, and
    ``sin(phi) cos(phi) = sin(2 phi) / 2``.

    Parameters
    ----------
    semi_axes : (float, float), [m]
        ``a`` and ``b``.
    taper : float
        From 0, an ellipse, up to but not 1, where the thin end becomes a cusp.
    centre, along, across, turns
        See `circle`.
    """
    if not 0.0 <= taper < 1.0:
        raise ProblemError(f"bulb: taper is {taper}, expected 0 or more, and below 1")
    a, b = (_positive(value, "semi-axis") for value in semi_axes)
    rate = 2.0 * np.pi * _positive(turns, "turns")
    sine = [[0.0, b, 0.0], [0.0, b * taper / 2.0, 0.0]]
    cosine = [[a, 0.0, 0.0], [0.0, 0.0, 0.0]]
    drawn = _about_origin([rate, 2.0 * rate], sine, cosine)
    return _placed(drawn, centre, along, across)


def ellipsoid(
    semi_axes: tuple[float, float, float],
    *,
    centre: ArrayLike,
    along: ArrayLike = _X,
    across: ArrayLike = _Y,
    turns: float = 3.0,
    latitude: float = np.pi / 3,
) -> HarmonicCurve:
    """Return a spiral on an ellipsoid, from one latitude up to its opposite.

    ``(a cos(theta) cos(phi), b cos(theta) sin(phi), c sin(theta))``, with ``theta``
    from ``-latitude`` to ``latitude`` and ``phi`` from 0 over the turns.

    Parameters
    ----------
    semi_axes : (float, float, float), [m]
        Along `along`, `across` and their normal.
    latitude : float, [rad]
        Up to a right angle, which is the pole.
    centre, along, across, turns
        See `circle`.
    """
    if not 0.0 < latitude <= np.pi / 2:
        raise ProblemError(
            f"ellipsoid: latitude is {latitude} rad, expected above 0 up to pi / 2"
        )
    a, b, c = (_positive(value, "semi-axis") for value in semi_axes)
    phi = 2.0 * np.pi * _positive(turns, "turns")
    theta, s0, c0 = 2.0 * latitude, np.sin(latitude), np.cos(latitude)
    # cos(theta) cos(phi) = (cos(phi + theta) + cos(phi - theta)) / 2, and so on;
    # phi + theta starts at -latitude, phi - theta at latitude.
    sine = [
        [a * s0 / 2, b * c0 / 2, 0.0],
        [-a * s0 / 2, b * c0 / 2, 0.0],
        [0.0, 0.0, c * c0],
    ]
    cosine = [
        [a * c0 / 2, -b * s0 / 2, 0.0],
        [a * c0 / 2, b * s0 / 2, 0.0],
        [0.0, 0.0, -c * s0],
    ]
    drawn = _about_origin([phi + theta, phi - theta, theta], sine, cosine)
    return _placed(drawn, centre, along, across)


def helix(
    radius: float,
    height: float,
    *,
    centre: ArrayLike,
    along: ArrayLike = _X,
    across: ArrayLike = _Y,
    turns: float = 3.0,
) -> HarmonicCurve:
    """Return a helix that climbs by `height` along the normal of its turns.

    Parameters
    ----------
    radius, height : float, [m]
        Half of the height is below the centre.
    centre, along, across, turns
        See `circle`.
    """
    r = _positive(radius, "radius")
    climb = np.array([0.0, 0.0, _positive(height, "height")])
    rate = 2.0 * np.pi * _positive(turns, "turns")
    drawn = _about_origin([rate], [[0.0, r, 0.0]], [[r, 0.0, 0.0]], climb)
    return _placed(drawn, centre, along, across)


def through_points(points: ArrayLike, *, closed: bool = False) -> SplineCurve:
    """Return a smooth path through points, by nearly its own length.

    A cubic spline with two continuous derivatives, whose knots are moved until they
    are where its own arc length puts them.

    Parameters
    ----------
    points : array_like, shape (points, 3), [m]
        Three or more.
    closed : bool
        Come back to the first point, without a corner.

    Examples
    --------
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> path = through_points(square, closed=True)
    >>> abs(path.evaluate([0, 0.25, 0.5])[0].round(12)).tolist()
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
    """
    from scipy.interpolate import CubicSpline

    p = checked(points, (None, 3), "points")
    if closed:
        p = np.vstack([p, p[:1]])
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    if len(p) < 3 + closed or not steps.all():
        raise ProblemError(
            f"path through {len(p) - closed} points, the shortest step of which is "
            f"{steps.min(initial=0.0):g} m; expected three or more, each apart from "
            "the one before"
        )
    ends = "periodic" if closed else "not-a-knot"
    for _ in range(_REFITS):
        knots = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
        knots[-1] = 1.0
        curve = SplineCurve(CubicSpline(knots, p, bc_type=ends))
        steps = np.diff(arc_length(curve, knots))
    return curve


def arc_length(curve: Curve, u: ArrayLike) -> Vector:
    """Return the length of a curve from its start up to each `u`, [m]."""
    u = checked(u, (None,), "u")
    edges = np.union1d(np.linspace(0.0, 1.0, _PIECES + 1), u)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    half = np.diff(edges) / 2.0
    inner = edges[:-1, None] + half[:, None] * (1.0 + nodes)
    speed = np.linalg.norm(curve.evaluate(inner.ravel(), 1)[1], axis=1)
    pieces = half * (speed.reshape(inner.shape) @ weights)
    length = np.concatenate([[0.0], np.cumsum(pieces)])
    return np.asarray(length[np.searchsorted(edges, u)])


def _about_origin(
    rates: Sequence[float],
    sine: Sequence[Sequence[float]],
    cosine: Sequence[Sequence[float]],
    slope: ArrayLike = (0.0, 0.0, 0.0),
) -> HarmonicCurve:
    """Return a curve about the origin, in the plane of x and y; it climbs along z."""
    climb = np.asarray(slope)
    return HarmonicCurve(
        np.asarray(rates), np.asarray(sine), np.asarray(cosine), -climb / 2.0, climb
    )


def _placed(
    drawn: HarmonicCurve, centre: ArrayLike, along: ArrayLike, across: ArrayLike
) -> HarmonicCurve:
    """Turn and move a curve that was drawn about the origin."""
    x = checked(along, (3,), "along")
    y = checked(across, (3,), "across")
    normal = np.cross(x, y)
    if not np.linalg.norm(normal) > 1e-9 * np.linalg.norm(x) * np.linalg.norm(y):
        raise ProblemError(
            f"along = {x.tolist()} and across = {y.tolist()} span no plane; give two "
            "different directions"
        )
    x, z = x / np.linalg.norm(x), normal / np.linalg.norm(normal)
    axes = np.array([x, np.cross(z, x), z])
    return HarmonicCurve(
        rates=drawn.rates,
        sine=drawn.sine @ axes,
        cosine=drawn.cosine @ axes,
        offset=checked(centre, (3,), "centre") + drawn.offset @ axes,
        slope=drawn.slope @ axes,
    )


def _positive(value: float, what: str) -> float:
    if not 0.0 < value < np.inf:
        raise ProblemError(f"{what} is {value}, expected more than 0")
    return value
