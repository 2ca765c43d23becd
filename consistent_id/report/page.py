"""The page: sections one after another, with their style and script inside."""

from collections.abc import Callable
from functools import lru_cache

from consistent_id.report.certificate import certificate_section
from consistent_id.report.costs import costs_section
from consistent_id.report.excitation import excitation_section
from consistent_id.report.findings import Findings, Section
from consistent_id.report.friction import friction_section
from consistent_id.report.health import health_section
from consistent_id.report.links import links_section
from consistent_id.report.markup import Html, joined, tag
from consistent_id.report.parameters import parameters_section
from consistent_id.report.published import published_section
from consistent_id.report.reproduce import reproduce_section
from consistent_id.report.residuals import residuals_section
from consistent_id.report.torque import torque_section
from consistent_id.report.verdict import verdict_section

SECTIONS: tuple[Callable[[Findings], Section | None], ...] = (
    verdict_section,
    health_section,
    excitation_section,
    parameters_section,
    links_section,
    torque_section,
    residuals_section,
    friction_section,
    costs_section,
    published_section,
    certificate_section,
    reproduce_section,
)


def page(findings: Findings) -> str:
    """Return the report as one HTML file that needs nothing else."""
    found = [section for make in SECTIONS if (section := make(findings)) is not None]
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"{findings.title}: identified parameters"),
        tag("style", Html(_asset("style.css"))),
    )
    contents = [tag("a", s.name.capitalize(), href=f"#{s.name}") for s in found]
    robot = findings.model.robot
    header = tag(
        "header",
        tag("h1", findings.title),
        tag("p", f"Robot {robot.name}, {len(robot)} joints. Identified parameters."),
    )
    main = tag(
        "main",
        *(tag("section", tag("h2", s.title), s.body, id=s.name) for s in found),
    )
    body = tag(
        "body",
        header,
        tag("nav", *contents),
        main,
        tag("script", Html(_asset("script.js"))),
    )
    return "<!doctype html>\n" + joined((tag("html", head, body, lang="en"), "\n"))


@lru_cache
def _asset(name: str) -> str:
    """Return a file of this folder, to be put inside the page."""
    from importlib.resources import files

    return (files("consistent_id.report") / name).read_text(encoding="utf-8")
