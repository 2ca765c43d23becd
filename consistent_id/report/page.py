"""The page: sections one after another, with their style and script inside.

Studies and comparisons become one HTML file that needs no other file.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TypeVar

from consistent_id._support.files import write_atomically
from consistent_id._support.given_values import require_type
from consistent_id._support.run import kept_going
from consistent_id.comparison.comparison import Comparison
from consistent_id.diagnosis import Diagnosis
from consistent_id.errors import ConsistentIdError
from consistent_id.estimation.uncertainties.parameter_uncertainty import Uncertainty
from consistent_id.problems.study import Study
from consistent_id.recordings.recording import Recording
from consistent_id.report.links_section import costs_section, links_section
from consistent_id.report.markup import Html, joined, tag
from consistent_id.report.parameters_section import parameters_section
from consistent_id.report.published_section import published_section, reproduce_section
from consistent_id.report.report_content import ReportContent, Section, advise
from consistent_id.report.residuals_section import residuals_section
from consistent_id.report.torque_section import friction_section, torque_section
from consistent_id.report.verdict_section import (
    certificate_section,
    delivery_section,
    excitation_section,
    health_section,
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


def report_html(
    study: Study,
    *,
    uncertainty: Uncertainty | None = None,
    further: Sequence[Section] = (),
    command: str = "",
) -> str:
    """Return a study as one HTML file, which needs no other file and no network.

    Parameters
    ----------
    study : Study
    uncertainty : Uncertainty, optional
        Uncertainty of its constrained estimate.
    further : sequence of Section
        Additional sections, such as that of rollouts.
    command : str
        Command that reproduces the report.

    Examples
    --------
    >>> import consistent_id as ci
    >>> study = ci.run_study(ci.load_problem("problems/rx60"))
    >>> ci.report.report_html(study).splitlines()[0]
    '<!doctype html>'
    """
    return page(
        ReportContent(
            title=study.problem.name,
            comparison=study.comparison,
            advice=advise(study.comparison, recommendation=study.recommendation),
            training=study.training,
            validation=study.validation,
            problem=study.problem,
            excitation=study.excitation,
            diagnosis=study.diagnosis,
            uncertainty=uncertainty,
            costs=study.costs,
            prices=study.prices,
            path=study.path,
            published=study.published,
            delivered=study.delivered,
            further=tuple(further),
            seed=None if uncertainty is None else study.seed,
            command=command,
        )
    )


def write_report(
    study: Study,
    path: str | Path,
    *,
    uncertainty: Uncertainty | None = None,
    further: Sequence[Section] = (),
    command: str = "",
) -> Path:
    """Write `report_html` to a file, whole or not at all; return its path.

    Parameters
    ----------
    study : Study
    path : str or Path
    uncertainty, further, command
        See `report_html`.

    Raises
    ------
    ProblemError
        If the file cannot be written.

    Examples
    --------
    >>> import consistent_id as ci
    >>> import tempfile
    >>> from pathlib import Path
    >>> study = ci.run_study(ci.load_problem("problems/rx60"), costs=False)
    >>> ci.write_report(study, Path(tempfile.mkdtemp(), "report.html")).name
    'report.html'
    """
    require_type(study, Study, "study")
    html = report_html(
        study,
        uncertainty=uncertainty,
        further=further,
        command=command,
    )
    return write_atomically(path, html)


def comparison_html(
    comparison: Comparison,
    *,
    training: Sequence[Recording] = (),
    validation: Sequence[Recording] = (),
    diagnosis: Diagnosis | None = None,
    uncertainty: Uncertainty | None = None,
) -> str:
    """Return a comparison as one HTML file; unknown parts have no section.

    Parameters
    ----------
    comparison : Comparison
    training, validation : sequence of Recording
        Recordings whose torque and residuals are drawn.
    diagnosis, uncertainty
        See `report_html`.
    """
    return page(
        ReportContent(
            title=comparison.model.robot.name,
            comparison=comparison,
            advice=advise(comparison, diagnosis),
            training=tuple(training),
            validation=tuple(validation),
            diagnosis=diagnosis,
            uncertainty=uncertainty,
        )
    )
