"""Section: a paper's own parameters and tables."""

from consistent_id.report.markup import folded, joined, paragraphs, table_html
from consistent_id.report.published_tables import published_tables
from consistent_id.report.report_content import ReportContent, Section


def published_section(content: ReportContent) -> Section | None:
    """Return what was found of a paper; None for a problem without one."""
    problem, report = content.problem, content.published
    if problem is None or report is None or problem.table.published is None:
        return None
    first, *others = published_tables(report, problem.table.published)
    body = joined(
        (
            paragraphs(problem.table.published.source),
            table_html(first),
            *(folded(t.title, table_html(t, titled=False)) for t in others),
        )
    )
    return Section("published", "As published", body)
