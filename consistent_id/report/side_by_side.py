"""Results of several folders side by side: verdicts, errors, parameters."""

from collections.abc import Sequence
from typing import Any

from consistent_id._support.tables import Table
from consistent_id.errors import ProblemError
from consistent_id.estimation.verdict import percent
from consistent_id.report.results import Results

_SHOWN = 20  # parameters that differ most


def side_by_side(results: Sequence[Results]) -> list[Table]:
    """Return what folders of results have in common, and where they differ.

    Raises
    ------
    ProblemError
        If there are fewer than two.
    """
    if len(results) < 2:
        raise ProblemError("one folder of results, expected two or more to compare")
    return [_verdicts(results), _parameters(results)]


def _verdicts(results: Sequence[Results]) -> Table:
    rows = []
    for found in results:
        verdict = found.verdict
        held_out = verdict.held_out
        rows.append(
            (
                str(found.folder),
                verdict.word,
                verdict.method,
                "-" if held_out is None else percent(held_out),
                ", ".join(dict.fromkeys(r.kind for r in verdict.grounds)) or "-",
            )
        )
    return Table(
        f"{len(results)} results side by side",
        ("folder", "verdict", "recommended", "held-out torque error", "reasons"),
        tuple(rows),
        (
            "held-out torque error: of each folder's own validation recordings",
            *(
                f"{found.folder}: {change}"
                for found in results
                for change in found.changes()
            ),
        ),
    )


def _parameters(results: Sequence[Results]) -> Table:
    """Return the delivered parameters that differ most, relative to the largest."""
    every: list[dict[str, Any]] = [r.record["delivered"]["parameters"] for r in results]
    names = [name for name in every[0] if all(name in other for other in every)]
    rows = []
    for name in names:
        values = [float(found[name]["value"]) for found in every]
        largest = max(map(abs, values))
        change = (max(values) - min(values)) / largest if largest else 0.0
        if change:
            rows.append((change, name, values, every[0][name]["unit"]))
    rows.sort(key=lambda row: -row[0])
    differ = f"{len(rows)} of {len(names)} in common differ"
    alone = sum(len(found) - len(names) for found in every)
    return Table(
        f"Delivered parameters, those that differ most first: {differ}",
        ("parameter", "unit", *(str(r.folder) for r in results), "difference"),
        tuple(
            (name, unit, *(f"{value:.5g}" for value in values), f"{change:.1%}")
            for change, name, values, unit in rows[:_SHOWN]
        ),
        (
            "difference: largest less smallest value, over the largest magnitude",
            *([f"{alone} parameters are in one folder alone"] if alone else []),
        ),
    )
