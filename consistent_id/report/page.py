"""The page: sections one after another, with their style and script inside."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import chain
from typing import TypeVar

from consistent_id._support.run import kept_going
from consistent_id.errors import ConsistentIdError
from consistent_id.report.health_section import excitation_section, health_section
from consistent_id.report.links_section import costs_section, links_section
from consistent_id.report.markup import Html, joined, tag
from consistent_id.report.parameters_section import parameters_section
from consistent_id.report.published_section import published_section, reproduce_section
from consistent_id.report.report_content import ReportContent, Section
from consistent_id.report.residuals_section import residuals_section
from consistent_id.report.torque_section import friction_section, torque_section
from consistent_id.report.verdict_section import (
    certificate_section,
    delivery_section,
    verdict_section,
)

Content = TypeVar("Content")

SECTIONS: tuple[Callable[[ReportContent], Section | None], ...] = (
    verdict_section,
    health_section,
    excitation_section,
    parameters_section,
    links_section,
    torque_section,
    residuals_section,
    delivery_section,
    friction_section,
    costs_section,
    published_section,
    certificate_section,
    reproduce_section,
)


def page(content: ReportContent) -> str:
    """Return the report as one HTML file that needs nothing else."""
    *others, last = (
        kept_sections(make.__name__.removesuffix("_section"), make, content)
        for make in SECTIONS
    )
    found = [*chain(*others), *content.further, *last]
    robot = content.model.robot
    about = f"Robot {robot.name}, {len(robot)} joints. Identified parameters."
    return document(
        f"{content.title}: identified parameters",
        joined((tag("h1", content.title), tag("p", about))),
        found,
        script=_asset("script.js"),
    )


def kept_sections(
    name: str,
    make: Callable[[Content], Section | Sequence[Section] | None],
    content: Content,
) -> tuple[Section, ...]:
    """Return the sections that a function makes; one that says why, where it fails.

    Parameters
    ----------
    name : str
        Anchor in the page, should it fail.
    make : callable
        From the content to a section, to several, or to None.
    """
    found: Section | Sequence[Section] | None = None
    with kept_going(f"section {name} of the report") as faults:
        try:
            found = make(content)
        except ConsistentIdError as cause:
            faults.append(str(cause))
    if faults:
        said = f"This section could not be made: {faults[0]}"
        found = Section(name, name.capitalize(), tag("p", said, class_="bad"))
    if found is None:
        return ()
    return (found,) if isinstance(found, Section) else tuple(found)


def document(
    title: str, header: Html, sections: Sequence[Section], *, script: str = ""
) -> str:
    """Return sections as one HTML file, with contents and the reports' style."""
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("meta", name="generator", content="consistent-id: report"),
        tag("title", title),
        tag("style", Html(_asset("style.css"))),
    )
    contents = [tag("a", s.name.capitalize(), href=f"#{s.name}") for s in sections]
    body = tag(
        "body",
        tag("header", header),
        tag("nav", *contents),
        tag(
            "main",
            *(tag("section", tag("h2", s.title), s.body, id=s.name) for s in sections),
        ),
        tag("script", Html(script)) if script else "",
    )
    return "<!doctype html>\n" + joined((tag("html", head, body, lang="en"), "\n"))


@lru_cache
def _asset(name: str) -> str:
    """Return a file of this folder, to be put inside the page."""
    from importlib.resources import files

    return (files("consistent_id.report") / name).read_text(encoding="utf-8")
