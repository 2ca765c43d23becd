"""Sections on trust: the verdict, what is certified, the data and their motion.

They say which estimate to use and why, what is delivered, what a diagnosis of the
recordings found, and what the motion identifies.
"""

from collections.abc import Sequence

from consistent_id.comparison.comparison import EstimateReport, counted
from consistent_id.diagnosis.findings import Diagnosis, LogFinding, diagnosis_table
from consistent_id.recordings.recording import Recording, instant
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
from consistent_id.report.plot import (
    Frame,
    buckets,
    extremes,
    instants,
    line,
    plot,
    spanning,
)
from consistent_id.report.report_content import ReportContent, Section, angle_unit
from consistent_id.report.summary import comparison_tables, excitation_table

_STYLE = {"fault": "bad", "warning": "care", "note": "muted"}


def health_section(content: ReportContent) -> Section | None:
    """Return recordings and their faults; None without recordings."""
    if not content.training and not content.validation:
        return None
    parts = [_recordings(content)]
    found = content.diagnosis
    if found is None:
        parts.append(paragraphs("These recordings were not examined for faults."))
    else:
        parts.append(tag("p", tag("strong", _in_short(found))))
        parts.append(_findings(found.suspicious))
        notes = [f for f in found.findings if f.severity == "note"]
        said = [f"{f.recording}, {f.where}: {f.statement}" for f in notes]
        if said:
            parts.append(folded(f"Notes ({len(said)})", listed(said)))
        if not found.suspicious:
            parts.append(paragraphs(diagnosis_table(found).notes[-1], class_="notes"))
    return Section("health", "Health of the data", joined(parts))


def _recordings(content: ReportContent) -> Html:
    rows = [
        *(_recording_row(r, "training") for r in content.training),
        *(_recording_row(r, "held out") for r in content.validation),
    ]
    header = ("recording", "role", "samples", "duration [s]", "rate [Hz]", "from [s]")
    return grid(header, rows)


def _recording_row(recording: Recording, role: str) -> list[object]:
    return [
        recording.name,
        role,
        str(len(recording)),
        f"{recording.duration:.4g}",
        f"{recording.rate:.4g}",
        instant(recording.time[0], recording.time),
    ]


def _in_short(found: Diagnosis) -> str:
    faults = len(found.faults)
    warnings = len(found.suspicious) - faults
    if not found.suspicious:
        return "Nothing suspicious was found."
    return f"Found: {faults} faults, which make estimates wrong, {warnings} warnings."


def _findings(found: Sequence[LogFinding]) -> Html:
    if not found:
        return Html()
    rows = [
        (
            tag("span", f.severity, class_=_STYLE[f.severity]),
            f.kind,
            f"{f.recording}, {f.where}",
            f.statement,
            f.advice,
        )
        for f in found
    ]
    return grid(("severity", "kind", "where", "seen", "to do"), rows, class_="prose")


_POINTS = 400


def excitation_section(content: ReportContent) -> Section | None:
    """Return rank, condition and motion; None where they are not known."""
    if content.excitation is None:
        return None
    drawn = [_motion(content, recording) for recording in content.training]
    body = joined(
        (
            paragraphs(
                "The structural rank counts the parameters that any motion could "
                "determine. The data rank counts those that this motion determines. A "
                "small condition number means that noise is not amplified."
            ),
            table_html(excitation_table(content.excitation, content.training)),
            *(
                folded(f"Motion of {recording.name}", panels)
                for recording, panels in zip(content.training, drawn, strict=True)
            ),
        )
    )
    return Section("excitation", "Excitation and rank", body)


def _motion(content: ReportContent, recording: Recording) -> Html:
    robot = content.model.robot
    if not len(robot):
        return paragraphs("The motion is that of the arm that carries the sensor.")
    log = recording.of(robot.joint_names)
    starts = buckets(len(log), _POINTS)
    time = instants(log.time, starts)
    panels = []
    for j, joint in enumerate(robot.driven):
        q = extremes(log.position[:, j], starts)
        frame = Frame((time[0], time[-1]), spanning([q]), height=130)
        curve = line(frame, time, q, "curve main")
        unit = f"[{angle_unit(joint)}]"
        panels.append(
            plot(frame, curve, across="time [s]", down=unit, title=joint.name)
        )
    return tag("div", *panels, class_="panels")


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
        f"After its verdict, the {delivered.method} estimate was fitted again to "
        "training and validation data; this fit is delivered. All errors and the "
        "verdict of this page are those of the estimate from the training data alone, "
        "because the validation data cannot judge a fit to themselves. The optimum of "
        f"the delivered fit is {optimum.verdict}."
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
    """Return the recomputed properties of every estimate."""
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
