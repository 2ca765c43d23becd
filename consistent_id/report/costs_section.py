"""Section: what constraints cost in fit."""

from collections.abc import Sequence

from consistent_id.comparison.constraint_prices import ShadowPrice
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
