"""``consistent-id compare PROBLEM``: its options, and what it prints."""

import argparse
from dataclasses import asdict
from pathlib import Path

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
from consistent_id.problems.statement import declarations

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
    from consistent_id.problems.folder import is_results

    folders = [options.problem, *options.log]
    if len(folders) > 1 and all(map(is_results, folders)):
        return show(options, _side_by_side(options, folders))
    return each(options, _compare)


def _side_by_side(options: argparse.Namespace, folders: list[Path]) -> Answer:
    """Put results side by side; the exit code is 1 if one is not to be used."""
    from consistent_id.report.results import open_results
    from consistent_id.report.side_by_side import side_by_side

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
    from consistent_id.problems.folder import is_results
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

    record, usable = found.record, found.verdict.usable
    return tables_answer(tables, record, usable=usable, write=write)
