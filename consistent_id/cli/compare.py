"""``consistent-id compare PROBLEM``: its options, and what it prints.

Results of several folders are compared side by side: verdicts, errors, parameters.
"""

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from consistent_id._support.tables import Table
from consistent_id.cli.answers import Answer, show, tables_answer
from consistent_id.cli.options import (
    ACCEPT,
    FITS_EXECUTOR,
    RESULTS,
    SEED_OF_BOOTSTRAP,
    TIME_LIMIT,
    add_command,
)
from consistent_id.cli.source import SOURCE, STATED, each, statement, studied
from consistent_id.errors import ProblemError
from consistent_id.estimation.verdict import percent
from consistent_id.problems.statement import declarations
from consistent_id.report.results import Results

_SHOWN = 20  # parameters that differ most
_ROUNDING = 1e-9  # of a unit's largest parameter: solvers leave less in place of zero


def side_by_side(results: Sequence[Results]) -> list[Table]:
    """Return a comparison of folders of results.

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
            "held-out torque error: that on each folder's own validation recordings",
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
    most = defaultdict[str, float](float)  # by unit
    for one in (one for found in every for one in found.values()):
        most[one["unit"]] = max(most[one["unit"]], abs(one["value"]))
    for name in names:
        values, unit = [float(f[name]["value"]) for f in every], every[0][name]["unit"]
        largest, difference = max(map(abs, values)), max(values) - min(values)
        if difference > _ROUNDING * most[unit]:
            rows.append((difference / largest, name, values, unit))
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


_MORE = """Tables, figures and a report are written, and open again: compare, report,
export, info and check of the folder compute nothing. Several such folders are put side
by side. Exit code 1: do not use the estimate."""

_EXAMPLES = """
consistent-id compare problems/rx60
consistent-id compare problems --json
consistent-id compare problems/tiago --dry-run
consistent-id compare robot.urdf log.csv
consistent-id compare results/monday results/tuesday
"""


def add_compare(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_compare,
        *SOURCE,
        *RESULTS,
        ACCEPT,
        SEED_OF_BOOTSTRAP,
        FITS_EXECUTOR,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_compare(options: argparse.Namespace) -> int:
    """Compare; return the exit code."""
    from consistent_id.problems.loading import is_results

    folders = [options.problem, *options.log]
    if len(folders) > 1 and all(map(is_results, folders)):
        return show(options, _side_by_side(options, folders))
    return each(options, _compare)


def _side_by_side(options: argparse.Namespace, folders: list[Path]) -> Answer:
    """Put results side by side; the exit code is 1 if one must not be used."""
    from consistent_id.cli.compare import side_by_side
    from consistent_id.report.results import open_results

    given = [declarations()[name].option for name in statement(options).given]
    given += ["--output"] * (options.output is not None)
    given += ["--accept"] * bool(options.accept)
    if given:
        raise ProblemError(
            f"{', '.join(given)}: folders of results are put side by side as they are; "
            "leave it out, or compute one of them again with it: consistent-id compare "
            f"{folders[0]} {given[0]} ..."
        )
    results = [open_results(folder) for folder in folders]
    tables = side_by_side(results)
    usable = all(each.verdict.usable for each in results)
    return tables_answer(tables, [asdict(table) for table in tables], usable=usable)


def _compare(options: argparse.Namespace) -> Answer:
    from consistent_id.cli.source import Computed
    from consistent_id.problems.loading import is_results
    from consistent_id.report.results_writing import require_place

    own = options.problem if is_results(options.problem) else None

    def place(name: str) -> Path:
        folder: Path = options.output or own or Path("results") / name
        return folder

    def before(name: str) -> None:
        if not options.dry_run:
            require_place(place(name))

    found = studied(options, options.output, before, costs=True)
    tables = found.tables("compare")
    write = None
    if isinstance(found, Computed):
        computed = found

        def write() -> list[Path]:
            return computed.write(place(computed.name))

    record = found.record if options.json else {}
    return tables_answer(tables, record, usable=found.verdict.usable, write=write)
