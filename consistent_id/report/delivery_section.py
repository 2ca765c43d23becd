"""Section: what is delivered in the end, and which data it knows."""

from consistent_id.report.markup import grid, joined, tag
from consistent_id.report.report_content import ReportContent, Section


def delivery_section(content: ReportContent) -> Section | None:
    """Return the estimate that was fitted again to all data; None without one."""
    delivered = content.delivered
    if delivered is None or not content.validation:
        return None
    before, optimum = content.main.estimate, delivered.certificate
    text = (
        f"When it had been judged, the {delivered.method} estimate was fitted again to "
        "training and validation data. This is what is delivered. All errors and the "
        "verdict of this page are those of the estimate from the training data alone: "
        "the delivered one has seen the data that would judge it. Its optimum is "
        f"{optimum.verdict}."
    )
    names = delivered.base.names
    errors = delivered.standard_errors
    rows = [
        [
            name,
            f"{old:.4g}",
            f"{new:.4g}",
            "-" if errors is None else f"{errors[k]:.2g}",
        ]
        for k, (name, old, new) in enumerate(
            zip(names, before.base_values, delivered.base_values, strict=True)
        )
    ]
    header = ["base parameter, led by", "judged", "delivered", "standard error"]
    return Section(
        "delivered", "Delivered", joined((tag("p", text), grid(header, rows)))
    )
