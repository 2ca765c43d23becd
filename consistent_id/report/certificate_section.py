"""Section: the certificate of each estimate, and all errors joint by joint."""

from consistent_id.comparison.comparison import EstimateReport
from consistent_id.report.markup import (
    Html,
    folded,
    grid,
    joined,
    paragraphs,
    table_html,
    tag,
)
from consistent_id.report.report_content import ReportContent, Section
from consistent_id.report.summary import comparison_tables


def certificate_section(content: ReportContent) -> Section:
    """Return what was recomputed of every estimate."""
    main = content.main
    others = [r for r in content.comparison.reports if r is not main]
    body = joined(
        (
            paragraphs(
                "Optima are proven again from the problem's own data. The solver's "
                "status is not trusted."
            ),
            _certificate(main, open_=True),
            *(_certificate(report) for report in others),
            folded(
                "All estimates, joint by joint",
                *(table_html(table) for table in comparison_tables(content.comparison)),
            ),
        )
    )
    return Section("certificate", "Certificates", body)


def _certificate(report: EstimateReport, *, open_: bool = False) -> Html:
    estimate = report.estimate
    own = estimate.certificate
    style = "good" if own.verdict == "certified" else "bad"
    heading = tag(
        "span",
        f"{estimate.method}: ",
        tag("span", f"optimum {own.verdict}", class_=style),
    )
    rows = [(name, f"{value:.4g}") for name, value in own.figures.items()]
    return folded(
        heading,
        paragraphs(own.reason, report.base_feasibility.summary, *estimate.notes),
        grid(("recomputed", "value"), rows) if rows else "",
        open_=open_,
    )
