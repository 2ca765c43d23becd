"""Sections: which estimate to use, why, what is delivered, what is certified."""

from consistent_id.comparison.comparison import EstimateReport, counted
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
from consistent_id.report.summary import comparison_tables

_SIGN = {"use": "good", "use with care": "care", "do not use": "bad"}


def verdict_section(content: ReportContent) -> Section:
    """Return the advice, key figures and all estimates in one table."""
    advice = content.advice
    parts = [
        tag("p", advice.headline, class_="headline"),
        listed((*advice.expected, *advice.reasons)),
        listed((*advice.cautions, *advice.also), class_="cautions"),
    ]
    card = tag("div", *parts, class_=f"card {_SIGN[advice.level]}")
    body = joined((card, _tiles(content), _estimates(content)))
    return Section("verdict", "Verdict", body)


def _tiles(content: ReportContent) -> Html:
    main, plain = content.main, content.plain
    error = main.held_out_error
    tiles = []
    if error is not None:
        other = None if plain is None else plain.held_out_error
        beside = "" if other is None else f"least squares: {other:.2%}"
        tiles.append(_tile(f"{error:.2%}", "held-out error, all joints", beside))
    beside = "" if plain is None else f"least squares: {sum(plain.consistent_links)}"
    tiles.append(_tile(counted(main.consistent_links), "consistent links", beside))
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
    header = ["estimate", *(f"held-out error on {name}" for name in names)]
    header += ["consistent links", "verdict"]
    return grid(header, [_row(r, content) for r in reports])


def _row(report: EstimateReport, content: ReportContent) -> list[object]:
    method = report.estimate.method
    chosen = method == content.advice.method
    word = report.verdict.word
    return [
        tag("strong", f"{method} ✓") if chosen else method,
        *(f"{error.stacked:.2%}" for error in report.validation),
        counted(report.consistent_links),
        tag("span", word, class_=_SIGN[word]),
    ]


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
    layout = delivered.model.layout
    rows = [
        [name, f"{old:.4g}", f"{new:.4g}", error, unit, origin]
        for name, old, new, error, unit, origin in zip(
            layout.names,
            before.parameters,
            delivered.parameters,
            delivered.error_texts,
            layout.units,
            delivered.origin_texts,
            strict=True,
        )
    ]
    header = ["parameter", "judged", "delivered", "standard error", "unit"]
    table = grid([*header, "determined by"], rows)
    note = paragraphs(
        f"{'; '.join(delivered.error_notes)}.".capitalize(), class_="notes"
    )
    return Section("delivered", "Delivered", joined((tag("p", text), table, note)))


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
