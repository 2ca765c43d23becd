"""Sections: physical consistency of each link, and costs of constraints."""

from collections.abc import Sequence

import numpy as np

from consistent_id.comparison.comparison import EstimateReport, counted
from consistent_id.comparison.constraint_prices import ShadowPrice
from consistent_id.report.drawn_robot import (
    AZIMUTH,
    DrawnLink,
    Window,
    drawn_links,
    robot_view,
    spread_pose,
    window_around,
)
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
from consistent_id.robot.inertia import InertialParameters


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
    """Return costs, shadow prices and the weight of the prior, as far as known."""
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
