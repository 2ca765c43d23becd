"""Sections on links: whether they are physically consistent, and what constraints cost.

The robot is drawn with its joints and each link's inertia ellipsoid, in the base frame.
Elements carry what the page's script needs to turn them: points ``data-p``, [m], and of
an ellipsoid the upper half of ``Q``, ``data-q``, [m^2].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.comparison.comparison import EstimateReport, counted
from consistent_id.comparison.constraint_prices import ShadowPrice
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
from consistent_id.report.report_content import ReportContent, Section
from consistent_id.report.summary import cost_table, path_table, price_table
from consistent_id.robot.inertia import InertialParameters, second_moments
from consistent_id.robot.kinematics import link_places
from consistent_id.robot.model import RobotModel

AZIMUTH, ELEVATION = -60.0, 20.0  # degrees

_CANDIDATES = 200


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse in the picture: centre, semi-axes [m], angle of the first [deg]."""

    x: float
    y: float
    rx: float
    ry: float
    angle: float


@dataclass(frozen=True, slots=True, eq=False)
class InertiaEllipsoid:
    """A link's equimomental ellipsoid: of even density, with the same moments.

    `centre`, shape (3,), [m]; `Q`, shape (3, 3), [m^2], whose eigenvalues are the
    squares of its semi-axes.
    """

    centre: Vector
    Q: Matrix


def equimomental(body: InertialParameters) -> InertiaEllipsoid | None:
    """Return a link's ellipsoid in its frame; None if it is not consistent.

    ``Q = 5 Sigma_c / m``, ``Sigma_c`` the second moment about the centre of mass.
    """
    if body.mass <= 0.0:
        return None
    Q = 5.0 / body.mass * second_moments(body.central_inertia)
    least, *_, largest = np.linalg.eigvalsh(Q)
    if least < -1e-6 * abs(largest):
        return None
    return InertiaEllipsoid(body.com, Q)


def view(azimuth: float = AZIMUTH, elevation: float = ELEVATION) -> Matrix:
    """Return ``P``, shape (2, 3), of a viewer; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    right = (-np.sin(a), np.cos(a), 0.0)
    up = (-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e))
    return np.array([right, up])


def outline(ellipsoid: InertiaEllipsoid, P: Matrix) -> Ellipse:
    """Return an ellipsoid's outline in a view."""
    squares, axes = np.linalg.eigh(P @ ellipsoid.Q @ P.T)
    (minor, major), along = np.sqrt(np.maximum(squares, 0.0)), axes[:, 1]
    x, y = P @ ellipsoid.centre
    angle = np.degrees(np.arctan2(along[1], along[0]))
    return Ellipse(float(x), float(y), float(major), float(minor), float(angle))


def spread_pose(robot: RobotModel, recordings: tuple[Recording, ...]) -> Vector:
    """Return the recorded pose in which the joints are farthest from each other.

    That is, with the largest product of distances; zeros without any recording.
    """
    if not recordings or not len(robot):
        return np.zeros(len(robot))
    q = np.concatenate([r.of(robot.joint_names).position for r in recordings])
    q = q[:: max(1, len(q) // _CANDIDATES)]
    places: Array = link_places(robot, q).translation
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    pairs = np.triu_indices(len(robot.links), 1)
    spread = np.log(apart[:, pairs[0], pairs[1]] + 1e-3).sum(axis=1)
    return np.asarray(q[int(np.argmax(spread))])


_SIZE = 360  # pixels
_MARGIN = 1.05
_THINNEST = 1.5  # least pixels of a semi-axis, to be visible


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLink:
    """A link, its joint and that of its parent.

    Parameters
    ----------
    joint, parent : ndarray, shape (3,), [m]
    possible : bool
        Whether the link is physically consistent.
    body : InertiaEllipsoid, optional
        None where that is not so, or without mass.
    """

    name: str
    joint: Vector
    parent: Vector
    possible: bool
    body: InertiaEllipsoid | None


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A ball around the drawn bodies: its middle and radius, [m]."""

    middle: Vector
    reach: float


def drawn_links(report: EstimateReport, q: Vector) -> tuple[DrawnLink, ...]:
    """Return one estimate's links at a pose.

    Parameters
    ----------
    q : ndarray, shape (joints,), [rad or m]
    """
    robot = report.estimate.model.robot
    places = link_places(robot, q[None])
    found = []
    for k, (link, joint) in enumerate(zip(report.links, robot.joints, strict=True)):
        R, t = places.rotation[0, k], places.translation[0, k]
        body = InertialParameters(report.estimate.links[k])
        inside = equimomental(body) if link.consistent else None
        if inside is not None:
            inside = InertiaEllipsoid(R @ inside.centre + t, R @ inside.Q @ R.T)
        start = np.zeros(3) if joint.parent < 0 else places.translation[0, joint.parent]
        found.append(DrawnLink(link.link, t, start, link.consistent, inside))
    return tuple(found)


def window_around(links: Sequence[DrawnLink]) -> Window:
    """Return a ball around all joints and ellipsoids, from their box's corners."""
    corners = [p for link in links for p in (link.joint, link.parent)]
    for link in links:
        if link.body is not None:
            # Half the extents of an ellipsoid along the axes.
            half = np.sqrt(np.maximum(np.diag(link.body.Q), 0.0))
            corners += [link.body.centre - half, link.body.centre + half]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    middle = (low + high) / 2
    reach = max(float(np.linalg.norm(c - middle)) for c in corners)
    return Window(middle, reach or 1.0)


def robot_view(links: Sequence[DrawnLink], window: Window, title: str) -> Html:
    """Return a drawing of links, numbered from one.

    Consistent links are ellipses, other links are crosses.
    """
    scale = _SIZE / 2 / (_MARGIN * window.reach)
    middle, half = window.middle, _SIZE / 2
    parts = [
        *(_bone(np.array([a.parent, a.joint]) - middle, scale) for a in links),
        *(_joint(a.joint - middle, scale) for a in links),
        *(_body(a.name, a.body, middle, scale) for a in links if a.body is not None),
        # Numbers and crosses last: nothing hides them.
        *(_mark(k, a, middle, scale) for k, a in enumerate(links, start=1)),
    ]
    return tag(
        "svg",
        joined(parts),
        viewBox=f"{-half:g} {-half:g} {_SIZE} {_SIZE}",
        class_="robot",
        data_scale=f"{scale:.5g}",
        role="img",
        aria_label=title,
    )


def _seen(point: Vector, scale: float) -> tuple[float, float]:
    x, y = view() @ point * scale
    return float(x), -float(y)  # SVG counts downwards


def _numbers(values: Array) -> str:
    return " ".join(f"{v:.4g}" for v in np.ravel(values))


def _bone(ends: Array, scale: float) -> Html:
    (x1, y1), (x2, y2) = (_seen(end, scale) for end in ends)
    return tag(
        "line",
        x1=f"{x1:.1f}",
        y1=f"{y1:.1f}",
        x2=f"{x2:.1f}",
        y2=f"{y2:.1f}",
        data_p=_numbers(ends),
        class_="bone",
    )


def _joint(point: Vector, scale: float) -> Html:
    x, y = _seen(point, scale)
    place = {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": 3}
    return tag("circle", **place, data_p=_numbers(point), class_="joint")


def _body(name: str, body: InertiaEllipsoid, middle: Vector, scale: float) -> Html:
    centred = InertiaEllipsoid(body.centre - middle, body.Q)
    e = outline(centred, view())
    x, y = e.x * scale, -e.y * scale
    return tag(
        "ellipse",
        tag("title", name),
        cx=f"{x:.1f}",
        cy=f"{y:.1f}",
        rx=f"{max(e.rx * scale, _THINNEST):.1f}",
        ry=f"{max(e.ry * scale, _THINNEST):.1f}",
        transform=f"rotate({-e.angle:.1f} {x:.1f} {y:.1f})",
        data_p=_numbers(centred.centre),
        data_q=_numbers(body.Q[np.triu_indices(3)]),
        class_="body",
    )


def _mark(number: int, link: DrawnLink, middle: Vector, scale: float) -> Html:
    """Return a link's number at its centre; for an inconsistent link a cross."""
    point = link.joint if link.body is None else link.body.centre
    x, y = _seen(point - middle, scale)
    if link.possible:
        parts = [tag("text", number)]
    else:
        parts = [
            tag("title", f"{link.name}: not physically consistent"),
            tag("path", d="M-7 -7L7 7M-7 7L7 -7"),
            tag("text", number, x=11, y=4),
        ]
    return tag(
        "g",
        *parts,
        transform=f"translate({x:.1f} {y:.1f})",
        data_p=_numbers(point - middle),
        class_="place" if link.possible else "place cross",
    )


def links_section(content: ReportContent) -> Section:
    """Return the robot with its inertia ellipsoids, and each link's condition."""
    plain = content.plain
    shown = [content.main] if plain is None else [content.main, plain]
    q = spread_pose(content.model.robot, content.training)
    # Of the main estimate: least squares' ellipsoids may be anywhere.
    window = window_around(drawn_links(content.main, q))
    views = [_captioned(report, drawn_links(report, q), window) for report in shown]
    turn = tag(
        "label",
        "view from ",
        tag("input", type="range", min=-180, max=180, value=f"{AZIMUTH:g}"),
        class_="turn script",
    )
    body = joined(
        (
            paragraphs(
                "Each ellipsoid is equimomental: it has even density and the link's "
                "identified mass, centre of mass and inertia. The pose was recorded. A "
                "red cross marks a link that is not physically consistent: it has no "
                "ellipsoid. Numbers are those of the table."
            ),
            tag("div", *views, class_="views"),
            turn,
            _table(content.main, plain),
            *(_impossible(report) for report in shown),
        )
    )
    return Section("links", "Link by link: is it physically consistent?", body)


def _captioned(
    report: EstimateReport, links: Sequence[DrawnLink], window: Window
) -> Html:
    found = counted(report.consistent_links)
    text = f"{report.estimate.method}: {found} consistent links"
    drawing = robot_view(links, window, f"inertia ellipsoids, {text}")
    return tag("figure", tag("figcaption", text), drawing)


def _table(main: EstimateReport, plain: EstimateReport | None) -> Html:
    columns = ["link", "mass [kg]", "centre of mass [m]", "moments of inertia [kg m^2]"]
    columns += ["least eigenvalue"]
    if plain is not None:
        columns += ["least squares: mass [kg]", "least eigenvalue", "consistent"]
    columns += ["on the boundary"]
    rows = []
    for k, link in enumerate(main.links):
        body = InertialParameters(main.estimate.links[k])
        row: list[object] = [
            f"{k + 1} {link.link}",
            f"{body.mass:.4g}",
            _vector(body.com) if body.mass else "-",
            _vector(np.linalg.eigvalsh(body.central_inertia)) if body.mass else "-",
            f"{link.least_eigenvalue:.2g}",
        ]
        if plain is not None:
            other = plain.links[k]
            row += [
                f"{plain.estimate.links[k][0]:.4g}",
                f"{other.least_eigenvalue:.2g}",
                _marked(other.consistent),
            ]
        where = link.edge or ("inside" if link.consistent else _marked(False))
        row.append(tag("span", where, class_="wrapped"))
        rows.append(row)
    note = (
        "Least eigenvalue of the pseudo-inertia, per typical mass and length of the "
        "link. A negative one is not physically consistent. For least squares, the "
        "standard parameters are the smallest of the many that fit alike."
    )
    return joined((grid(columns, rows), paragraphs(note, class_="notes")))


def _marked(yes: bool) -> Html:
    text = "yes" if yes else "inconsistent"
    return tag("span", text, class_="good" if yes else "bad")


def _vector(values: object) -> str:
    return ", ".join(f"{v + 0.0:.3g}" for v in np.asarray(values))


def _impossible(report: EstimateReport) -> Html:
    """Return the proof that no consistent robot has an estimate's base parameters."""
    found = report.base_feasibility
    if found.answer != "impossible":
        return Html()
    said = [
        tag("strong", f"{report.estimate.method} is impossible: "),
        found.summary.removeprefix("impossible: "),
    ]
    if found.nearest is not None:
        said.append(
            f". The torque of the nearest consistent robot differs by "
            f"{found.nearest.torque_change:.2%} along random motions"
        )
    if report.consistency is not None:
        said.append(f". {report.consistency.sentence.capitalize()}")
    return tag("p", *said, ".", class_="proof")


def costs_section(content: ReportContent) -> Section | None:
    """Return costs, shadow prices and the weight of the prior that are known."""
    if not content.costs and not content.prices and content.path is None:
        return None
    parts = [
        paragraphs(
            "Constraints that agree with the data cost nothing. A high cost means that "
            "the datasheet is wrong, that the model lacks something, or that the data "
            "are noisy. Look there first."
        )
    ]
    if content.costs:
        parts.append(table_html(cost_table(content.costs, content.model.torque_joints)))
    if content.prices:
        parts += _prices(content.prices)
    if content.path is not None:
        table = table_html(path_table(content.path), titled=False)
        parts.append(folded(path_table(content.path).title, table))
    return Section("costs", "What constraints cost", joined(parts))


def _prices(prices: Sequence[ShadowPrice]) -> list[Html]:
    """Return the largest shadow prices, with bars."""
    table = price_table(prices)
    largest = max((p.cost for p in prices if p.cost == p.cost), default=0.0) or 1.0
    rows = [
        (label, _bar(p.cost / largest), *cells)
        for p, (label, *cells) in zip(prices, table.rows, strict=False)
    ]
    header = (table.header[0], "", *table.header[1:])
    return [
        tag("h3", table.title),
        grid(header, rows),
        listed(table.notes, class_="notes"),
    ]


def _bar(share: float) -> Html:
    width = 0.0 if share != share else 100.0 * share
    return tag("span", tag("i", style=f"width:{width:.0f}%"), class_="cost")
