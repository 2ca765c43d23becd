"""Section: which estimate to use, and why."""

from consistent_id.comparison.comparison import EstimateReport
from consistent_id.report.markup import Html, grid, joined, listed, tag
from consistent_id.report.report_content import ReportContent, Section

_SIGN = {"use": "good", "use with care": "care", "do not use": "bad"}


def verdict_section(content: ReportContent) -> Section:
    """Return the advice, key figures and all estimates in one table."""
    advice = content.advice
    parts = [
        tag("p", advice.headline, class_="headline"),
        listed(advice.reasons),
        listed((*advice.cautions, *advice.also), class_="cautions"),
    ]
    card = tag("div", *parts, class_=f"card {_SIGN[advice.level]}")
    body = joined((card, _tiles(content), _estimates(content)))
    return Section("verdict", "Verdict", body)


def _tiles(content: ReportContent) -> Html:
    main, plain = content.main, content.plain
    error, consistent = main.held_out_error, main.possible_links
    tiles = []
    if error is not None:
        other = None if plain is None else plain.held_out_error
        beside = "" if other is None else f"least squares: {other:.2%}"
        tiles.append(_tile(f"{error:.2%}", "torque error on held-out motion", beside))
    beside = "" if plain is None else f"least squares: {sum(plain.possible_links)}"
    links = f"{sum(consistent)} of {len(consistent)}"
    tiles.append(_tile(links, "links can be physically consistent", beside))
    if content.excitation is not None:
        found = content.excitation
        rank = f"{found.data_rank} of {found.structural_rank}"
        tiles.append(_tile(rank, "base parameters determined by the data"))
    if content.uncertainty is not None:
        verdicts = [p.verdict for p in content.uncertainty.parameters]
        known = f"{verdicts.count('data')} of {len(verdicts)}"
        tiles.append(_tile(known, "single parameters determined by the data"))
    if content.diagnosis is not None:
        count = len(content.diagnosis.suspicious)
        tiles.append(_tile(str(count), "faults and warnings in the recordings"))
    return tag("div", *tiles, class_="tiles")


def _tile(figure: str, meaning: str, beside: str = "") -> Html:
    return tag(
        "div",
        tag("b", figure),
        tag("span", meaning),
        tag("small", beside) if beside else "",
    )


def _estimates(content: ReportContent) -> Html:
    reports = content.comparison.reports
    names = [error.recording for error in reports[0].validation]
    header = ["estimate", *(f"error on {name}" for name in names)]
    header += ["links that can be consistent", "verdict"]
    return grid(header, [_row(r, content) for r in reports])


def _row(report: EstimateReport, content: ReportContent) -> list[object]:
    method, links = report.estimate.method, report.possible_links
    chosen = method == content.advice.method
    word = report.verdict.word
    return [
        tag("strong", f"{method} ✓") if chosen else method,
        *(f"{error.stacked:.2%}" for error in report.validation),
        f"{sum(links)} of {len(links)}",
        tag("span", word, class_=_SIGN[word]),
    ]
