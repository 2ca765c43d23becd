"""Section and table: the parameters, their uncertainty, and their sources."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from consistent_id._support.tables import Table
from consistent_id.estimation.determination import SMALL
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.estimation.uncertainties.block_scatter import RecordingScatter
from consistent_id.estimation.uncertainties.parameter_uncertainty import (
    ParameterUncertainty,
    Uncertainty,
)
from consistent_id.report.markup import (
    Html,
    folded,
    grid,
    joined,
    listed,
    paragraphs,
    tag,
)
from consistent_id.report.report_content import ReportContent, Section

_MEANING = {
    "data": "the data determine it",
    "combination": "the data determine only sums that contain it",
    "loose": "the data bound it, but only loosely",
    "constraint": "an equality, or constraints and data together, determine it",
    "prior": "its value is the prior's",
    "convention": "the smallest of many values that fit alike",
}
_HEADER = (
    "parameter",
    "value",
    "full standard error",
    "between recordings",
    "bootstrap 95 %",
    "any consistent robot",
    "",
    "unit",
    "determined by",
)
_WIDTH, _HEIGHT = 150, 16  # pixels of an interval's drawing


def parameters_section(content: ReportContent) -> Section:
    """Return standard parameters in groups, then base parameters."""
    estimate, sure = content.main.estimate, content.uncertainty
    if sure is None:
        parts = [_counts(estimate.origins), *_origins(estimate)]
    else:
        parts = [_counts([p.verdict for p in sure.parameters]), *_intervals(sure)]
        if estimate.method != Method.CONSTRAINED:
            parts.insert(0, paragraphs("Of the constrained estimate:"))
    parts.append(_base(content))
    return Section("parameters", "Parameters", joined(parts))


def _counts(verdicts: Sequence[str]) -> Html:
    """Return the number of parameters for each source, as a bar and in words."""
    count = Counter(verdicts)
    known = [v for v in _MEANING if v in count]
    bar = [
        tag("span", str(count[v]), class_=f"origin {v}", style=f"flex-grow:{count[v]}")
        for v in known
    ]
    words = [
        tag("li", tag("b", v, class_=f"origin {v}"), f" {count[v]}: {_MEANING[v]}")
        for v in known
    ]
    return joined((tag("div", *bar, class_="bar"), tag("ul", *words, class_="legend")))


def _intervals(sure: Uncertainty) -> list[Html]:
    """Return a table for each link and each joint, with intervals."""
    groups: dict[str, list[ParameterUncertainty]] = {}
    for p in sure.parameters:
        groups.setdefault(p.name.rpartition(".")[0], []).append(p)
    determined = (n for n, g in groups.items() if any(p.verdict == "data" for p in g))
    first = next(determined, "")
    shown = [
        folded(
            tag("span", name, " ", _marks([p.verdict for p in members])),
            grid(_HEADER, [_row(p) for p in members]),
            open_=name == first,
        )
        for name, members in groups.items()
    ]
    key = (
        "Drawing: the thin line spans the values of any consistent robot that fits "
        "nearly as well, with an arrow where there is no bound. The thick line is the "
        "bootstrap's 95 % interval, the dot the value, the tick zero."
    )
    notes = (key, *uncertainty_table(sure).notes)
    return [*shown, listed(notes, class_="notes")]


def _marks(verdicts: Sequence[str]) -> Html:
    """Return one small square for each parameter of a group."""
    squares = [tag("i", class_=f"origin {v}", title=v) for v in verdicts]
    return tag("span", *squares, class_="marks")


def _row(p: ParameterUncertainty) -> list[object]:
    return [
        p.name.rpartition(".")[2],
        f"{p.value:.4g}",
        error_text(p),
        between_text(p),
        _ends(p.resampled),
        _ends(p.consistent),
        _drawn(p),
        p.unit,
        tag("b", p.source, class_=f"origin {p.verdict}"),
    ]


def _ends(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}"


def _drawn(p: ParameterUncertainty) -> Html:
    """Draw the intervals on a line that contains zero and all finite ends."""
    ends = [0.0, p.value, *p.resampled, *p.consistent]
    finite = [e for e in ends if np.isfinite(e)]
    low, high = min(finite), max(finite)
    spread = high - low or 1.0
    # The interval goes on beyond the drawing: leave space for the arrow.
    low -= 0.0 if np.isfinite(p.consistent[0]) else spread / 2
    high += 0.0 if np.isfinite(p.consistent[1]) else spread / 2
    spread = high - low or 1.0

    def at(value: float) -> float:
        share = np.clip((value - low) / spread, -0.04, 1.04)
        return float(_WIDTH * (0.06 + 0.88 * share))

    middle = _HEIGHT / 2
    a, b = (at(end) for end in p.consistent)
    arrows = ""
    if not np.isfinite(p.consistent[0]):
        arrows += f"M{a + 4:.1f} {middle - 4}L{a:.1f} {middle}l4 4"
    if not np.isfinite(p.consistent[1]):
        arrows += f"M{b - 4:.1f} {middle - 4}L{b:.1f} {middle}l-4 4"
    c, d = (at(end) for end in p.resampled)
    return tag(
        "svg",
        tag("path", d=f"M{at(0.0):.1f} 2V{_HEIGHT - 2}", class_="zero"),
        tag("path", d=f"M{a:.1f} {middle}H{b:.1f}{arrows}", class_="thin"),
        tag("path", d=f"M{c:.1f} {middle}H{max(d, c + 0.1):.1f}", class_="thick"),
        tag("circle", cx=f"{at(p.value):.1f}", cy=middle, r=3, class_="value"),
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        class_="interval",
        aria_hidden="true",
    )


def _origins(estimate: Estimate) -> list[Html]:
    """Return one table of all parameters, without intervals."""
    layout = estimate.model.layout
    entries = zip(
        layout.names,
        estimate.parameters,
        estimate.error_texts,
        layout.units,
        zip(estimate.origins, estimate.origin_texts, strict=True),
        strict=True,
    )
    rows = [
        (name, f"{value:.4g}", error, unit, tag("b", text, class_=f"origin {origin}"))
        for name, value, error, unit, (origin, text) in entries
    ]
    header = ("parameter", "value", "standard error", "unit", "determined by")
    note = paragraphs(
        f"{'; '.join(estimate.error_notes)}.".capitalize(), class_="notes"
    )
    return [folded(f"All {len(rows)} parameters", grid(header, rows), note, open_=True)]


def _base(content: ReportContent) -> Html:
    """Return base parameters, which torque depends on, beside least squares'."""
    main = content.main.estimate
    plain = content.plain
    header = ["base parameter", "value"]
    columns: list[Sequence[object]] = [
        list(main.base.groupings),
        [f"{v:.4g}" for v in main.base_values],
    ]
    if plain is not None:
        header += ["least squares", "standard error"]
        errors = plain.estimate.standard_errors
        columns.append([f"{v:.4g}" for v in plain.estimate.base_values])
        columns.append(
            ["-"] * len(main.base) if errors is None else [f"{e:.2g}" for e in errors]
        )
    header.append("unit")
    columns.append([main.model.layout.units[i] for i in main.base.independent])
    return folded(
        f"Base parameters ({len(main.base)}): what torque depends on",
        grid(header, zip(*columns, strict=True)),
        paragraphs(
            "The standard error is that of least squares, for noise as correlated as "
            "the residuals.",
            class_="notes",
        )
        if plain is not None
        else "",
    )


def uncertainty_table(found: Uncertainty) -> Table:
    """Return the uncertainty of each parameter of the constrained estimate."""
    resampled, several = found.bootstrap, found.recordings is not None
    return Table(
        "Uncertainty of the constrained estimate",
        (
            "parameter",
            "value",
            "full standard error",
            *(["between recordings"] if several else []),
            "bootstrap 95 %",
            "any consistent robot",
            "unit",
            "determined by",
        ),
        tuple(
            (
                p.name,
                f"{p.value:.4g}",
                error_text(p),
                *([between_text(p)] if several else []),
                _interval(p.resampled),
                _interval(p.consistent),
                p.unit,
                p.source,
            )
            for p in found.parameters
        ),
        (
            f"bootstrap: {len(resampled.estimates)} estimates from segments drawn "
            f"anew, {resampled.certified} certified, {resampled.failed} failed"
            + ("; interrupted" if resampled.interrupted else ""),
            f"any consistent robot: {found.intervals.meaning}",
            found.scatter,
            *([scatter_text(found.recordings)] if found.recordings else []),
            *([SMALL] if any(p.source != p.verdict for p in found.parameters) else []),
            "full standard error: it contains scatter along active constraints and "
            "between recordings, and the prior's bias; a parameter that a prior "
            "determines has none: only its interval shows its uncertainty",
            "where a link is on the boundary of the consistency cone with a small "
            "multiplier, the standard error is too small; the bootstrap is not",
        ),
    )


def scatter_text(found: RecordingScatter) -> str:
    """Describe the scatter between recordings, and its accuracy."""
    return (
        f"between recordings: standard deviation from one of {found.recordings} "
        "recordings to another, beyond noise (a random effect); standard errors and "
        f"intervals contain it, the bootstrap does not. By kind {found.sentence}"
    )


def between_text(p: ParameterUncertainty) -> str:
    """Return a parameter's scatter between recordings, if it is defined."""
    if np.isnan(p.between_recordings):
        return "-"
    return f"{p.between_recordings:.2g}"


def error_text(p: ParameterUncertainty) -> str:
    """Return a standard error for people; a dash if it is not defined."""
    return f"{p.standard_error:.2g}" if np.isfinite(p.standard_error) else "-"


def _interval(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}"
