"""A reproduced study as one HTML page that needs nothing else, and as Markdown."""

import io
import re
from html import escape
from typing import Any

from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction.paper_sections import (
    PaperSection,
    sections_of,
)
from consistent_id.laboratory.reproduction.paper_study import PaperStudy

_INK = "#123456"  # stands for the page's own text colour until the SVG is written
_NUMBER = re.compile(r"(?:[-+]?(?:\d[\d.]*(?:e[-+]?\d+)?|inf|nan)%?)?")
_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #fff; --line: #d5d9de;
  --soft: #f3f5f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #dfe3e8; --paper: #14181d; --line: #39414b; --soft: #1d232a; } }
body { font: 16px/1.55 system-ui, sans-serif; color: var(--ink);
  background: var(--paper); max-width: 62rem; margin: 0 auto; padding: 1rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .82rem;
  font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { padding: .2rem .55rem; text-align: right; border-bottom: 1px solid var(--line);
  white-space: nowrap; }
th { vertical-align: bottom; background: var(--soft); white-space: normal;
  min-width: 3.5rem; }
th:first-child, td.text, th.text { text-align: left; }
td.long { white-space: normal; min-width: 16rem; }
.notes { font-size: .82rem; opacity: .85; margin: .2rem 0; }
figure { margin: 1.2rem 0; overflow-x: auto; }
figure svg { max-width: 100%; min-width: 34rem; height: auto; }
figcaption { font-size: .88rem; opacity: .85; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1rem; } a { color: inherit; }
"""


def html_page(study: PaperStudy) -> str:
    """Return the study as one HTML page: no scripts, nothing fetched.

    Everything from the problem file is escaped.
    """
    sections = sections_of(study)
    problem = study.problem
    title = escape(f"{problem.name}: a paper's study done again")
    links = " ".join(
        f'<a href="#{escape(s.name)}">{escape(s.title)}</a>' for s in sections
    )
    body = "\n".join(_section(section, study) for section in sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title><style>{_STYLE}</style></head><body>\n"
        f"<h1>{title}</h1>\n<p>{escape(problem.table.source)}</p>\n"
        f"<nav>{links}</nav>\n{body}\n</body></html>\n"
    )


def markdown_tables(study: PaperStudy) -> str:
    """Return text and tables as Markdown, without figures."""
    lines = [f"# {study.problem.name}: a paper's study done again", ""]
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


def _section(section: PaperSection, study: PaperStudy) -> str:
    parts = [f'<section id="{escape(section.name)}"><h2>{escape(section.title)}</h2>']
    parts += [f"<p>{escape(paragraph)}</p>" for paragraph in section.text]
    parts += [
        f"<figure>{svg(draw(study))}<figcaption>{escape(caption)}</figcaption></figure>"
        for _, caption, draw in section.figures
    ]
    parts += [_table(table) for table in section.tables]
    return "\n".join([*parts, "</section>"])


def _table(table: Table) -> str:
    numbers = [
        all(_NUMBER.fullmatch(row[i]) for row in table.rows)
        for i in range(len(table.header))
    ]
    head = "".join(
        f'<th class="{"" if number else "text"}">{escape(cell)}</th>'
        for cell, number in zip(table.header, numbers, strict=True)
    )
    rows = "\n".join(
        "<tr>"
        + "".join(
            f'<td class="{_kind(cell, number)}">{escape(cell)}</td>'
            for cell, number in zip(row, numbers, strict=True)
        )
        + "</tr>"
        for row in table.rows
    )
    notes = "".join(f'<p class="notes">{escape(note)}</p>' for note in table.notes)
    return (
        f'<div class="wide"><table><caption>{escape(table.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>{notes}"
    )


def _kind(cell: str, number: bool) -> str:
    if number:
        return ""
    return "text long" if len(cell) > 40 else "text"
