"""``consistent-id identify``: a problem, or a robot and a log without one."""

import argparse
from pathlib import Path

from consistent_id.cli.answers import Answer, show, shows_progress, tables_answer
from consistent_id.cli.options import (
    ACCEPT,
    FITS_EXECUTOR,
    OUTPUT,
    SEED_OF_BOOTSTRAP,
    TIME_LIMIT,
    Option,
    add_command,
    page_file,
)
from consistent_id.cli.source import SOURCE, STATED, Computed, each, statement, studied
from consistent_id.errors import ProblemError

_MORE = """With a URDF or MJCF file in place of PROBLEM, and logs, no problem file is
needed: columns and units are found by their names, --validate names logs for
validation (default: the last 30 % of each motion). After validation, the recommended
estimate is fitted again to all data; this fit is delivered.
--output FOLDER gets all results; compare, report, export, info and check open them.
Exit code 1: do not use the estimate."""
_EXAMPLES = """
consistent-id identify robot.urdf log.csv
consistent-id identify robot.urdf log.csv --output results/robot --report robot.html
consistent-id identify robot.urdf a.csv b.csv --validate c.csv --units deg ms
consistent-id identify problems/rx60
consistent-id identify problems/ur10e --uncertainty --output results/ur10e
"""


def add_identify(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_identify,
        *SOURCE,
        *OUTPUT,
        Option("--report FILE", "write a report (HTML)", page_file),
        Option(
            "--uncertainty",
            "also print the uncertainty of each parameter of the constrained estimate",
        ),
        SEED_OF_BOOTSTRAP,
        Option(
            "--streamed",
            "read recordings piece by piece, however large they are, and estimate by "
            "the weighted constrained method alone",
        ),
        ACCEPT,
        FITS_EXECUTOR,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_identify(options: argparse.Namespace) -> int:
    """Identify; return the exit code."""
    if options.streamed:
        return show(options, _identify_streamed(options))
    return each(options, _identify)


def _identify(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable_file, write_atomically
    from consistent_id.report.results_writing import require_place

    def before(name: str) -> None:
        if options.dry_run:
            return
        if options.output is not None:
            require_place(options.output)
        if options.report is not None:
            require_writable_file(options.report)

    found = studied(options, options.output, before)
    tables = found.tables("identify")
    record = found.record if options.json else {}
    if options.uncertainty:
        tables += found.tables("uncertainty")

    def write() -> list[Path]:
        paths = []
        if options.output is not None and isinstance(found, Computed):
            paths += found.write(options.output)
        if options.report is not None:
            paths.append(write_atomically(options.report, found.page))
        return paths

    return tables_answer(tables, record, usable=found.verdict.usable, write=write)


def _identify_streamed(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable
    from consistent_id._support.tables import Table
    from consistent_id.fleet.stream import stream_estimate
    from consistent_id.problems.loading import stated_problem

    if options.log or options.report is not None or options.uncertainty:
        raise ProblemError(
            "--streamed is for a problem file, without --report and --uncertainty, "
            "which take recordings as a whole; cut a part of the log for them"
        )
    if options.output is not None and not options.dry_run:
        require_writable(options.output, ["delivered.json"])
    problem, notes = stated_problem(options.problem, statement(options))
    estimate = stream_estimate(
        problem,
        executor=options.executor or "serial",
        progress=shows_progress(options),
    )
    verdict = estimate.verdict
    head = Table(f"{problem.name}: {verdict.word}", (), (), (*verdict.brief, *notes))
    record = {
        "format": "consistent_id streamed 1",
        **verdict.to_dict(),
        "estimates": [estimate.to_dict()],
    }

    def write() -> list[Path]:
        folder = options.output
        return [] if folder is None else [estimate.save(folder / "delivered.json")]

    tables = (head, estimate.table())
    return tables_answer(tables, record, usable=verdict.usable, write=write)
