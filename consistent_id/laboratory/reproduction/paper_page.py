"""A reproduced study as one HTML page that needs nothing else, and as Markdown."""

import io
import re
from typing import Any

from consistent_id.laboratory.reproduction.paper_sections import (
    PaperSection,
    sections_of,
)
from consistent_id.laboratory.reproduction.paper_study import PaperStudy
from consistent_id.report.markup import Html, joined, paragraphs, table_html, tag
from consistent_id.report.page import document
from consistent_id.report.report_content import Section

_INK = "#123456"  # stands for the page's own text colour until the SVG is written


def html_page(study: PaperStudy) -> str:
    """Return the study as one HTML page: no scripts, nothing fetched.

    Everything from the problem file is escaped.
    """
    title = f"{study.problem.name}: a paper's study done again"
    header = joined((tag("h1", title), tag("p", study.problem.table.source)))
    sections = [_section(section, study) for section in sections_of(study)]
    return document(title, header, sections)


def markdown_tables(study: PaperStudy) -> str:
    """Return text and tables as Markdown, without figures."""
    lines = ["<!-- consistent-id: tables of a study -->", ""]
    lines += [f"# {study.problem.name}: a paper's study done again", ""]
    for section in sections_of(study):
        lines += [f"## {section.title}", ""]
        lines += [f"{paragraph}\n" for paragraph in section.text]
        lines += [table.markdown() for table in section.tables]
    return "\n".join(lines)


def svg(figure: Any) -> str:
    """Return a figure as an SVG element whose ink is the text colour around it."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "consistent_id"}):
        _dressed(figure)
        figure.savefig(buffer, format="svg", transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    return text.replace(_INK, "currentColor")


def _dressed(figure: Any) -> None:
    """Give all text, ticks and edges the colour that stands for the page's own."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_color(_INK)
    for axis in figure.axes:
        axis.tick_params(colors=_INK, which="both")
        axis.set_axisbelow(True)
        axis.grid(alpha=0.25, color="#808080")
        for spine in axis.spines.values():
            spine.set_edgecolor(_INK)


def _section(section: PaperSection, study: PaperStudy) -> Section:
    figures = (
        tag(
            "figure", Html(svg(draw(study))), tag("figcaption", caption), class_="drawn"
        )
        for _, caption, draw in section.figures
    )
    tables = map(table_html, section.tables)
    body = joined((paragraphs(*section.text), *figures, *tables))
    return Section(section.name, section.title, body)
