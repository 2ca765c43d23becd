"""Section: whether each link is a body."""

from collections.abc import Sequence

import numpy as np

from consistent_id.comparison.comparison import EstimateReport
from consistent_id.report.findings import Findings, Section
from consistent_id.report.markup import Html, grid, joined, paragraphs, tag
from consistent_id.report.projection import AZIMUTH, telling_pose
from consistent_id.report.robot_scene import DrawnLink, Window, scene, window_around
from consistent_id.report.robot_view import robot_view
from consistent_id.robot.inertia import InertialParameters


def links_section(findings: Findings) -> Section:
    """Return the robot with its bodies, and each link's condition."""
    plain = findings.plain
    shown = [findings.main] if plain is None else [findings.main, plain]
    q = telling_pose(findings.model.robot, findings.training)
    # Of the main estimate: least squares' bodies may be anywhere.
    window = window_around(scene(findings.main, q))
    views = [_captioned(report, scene(report, q), window) for report in shown]
    turn = tag(
        "label",
        "view from ",
        tag("input", type="range", min=-180, max=180, value=f"{AZIMUTH:g}"),
        class_="turn script",
    )
    body = joined(
        (
            paragraphs(
                "Equimomental ellipsoids: bodies of even density with the identified "
                "mass, centre of mass and inertia, at a recorded pose. A red cross "
                "marks a link whose parameters no body has, so that there is nothing "
                "to draw. Numbers are those of the table."
            ),
            tag("div", *views, class_="views"),
            turn,
            _table(findings.main, plain),
            *(_impossible(report) for report in shown),
        )
    )
    return Section("links", "Link by link: can it exist?", body)


def _captioned(
    report: EstimateReport, links: Sequence[DrawnLink], window: Window
) -> Html:
    bodies = report.consistent_links
    text = f"{report.estimate.method}: {sum(bodies)} of {len(bodies)} links are bodies"
    drawing = robot_view(links, window, f"inertia ellipsoids, {text}")
    return tag("figure", tag("figcaption", text), drawing)


def _table(main: EstimateReport, plain: EstimateReport | None) -> Html:
    columns = ["link", "mass [kg]", "centre of mass [m]", "moments of inertia [kg m^2]"]
    columns += ["least eigenvalue"]
    if plain is not None:
        columns += ["least squares: mass [kg]", "least eigenvalue", "a body"]
    columns += ["at the edge"]
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
        edge = link.edge or ("inside" if link.consistent else _marked(False))
        row.append(tag("span", edge, class_="wrapped"))
        rows.append(row)
    note = (
        "Least eigenvalue of the pseudo-inertia, per typical mass and length of the "
        "link: negative is no body. Of least squares, standard parameters are the "
        "smallest of the many that fit alike."
    )
    return joined((grid(columns, rows), paragraphs(note, class_="notes")))


def _marked(body: bool) -> Html:
    return tag("span", "yes" if body else "no body", class_="good" if body else "bad")


def _vector(values: object) -> str:
    return ", ".join(f"{v + 0.0:.3g}" for v in np.asarray(values))


def _impossible(report: EstimateReport) -> Html:
    """Tell the proof that no body has an estimate's base parameters."""
    found = report.base_feasibility
    if found.answer != "impossible":
        return Html()
    said = [
        tag("strong", f"{report.estimate.method} is impossible: "),
        found.summary.removeprefix("impossible: "),
    ]
    if found.nearest is not None:
        said.append(
            f". The torque of the nearest robot that can exist differs by "
            f"{found.nearest.torque_change:.2%} along random motions"
        )
    return tag("p", *said, ".", class_="proof")
