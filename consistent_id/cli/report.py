"""``consistent-id report PROBLEM``: its options, and what it prints."""

import argparse
from pathlib import Path

from consistent_id.cli.answers import Answer
from consistent_id.cli.options import (
    ACCEPT,
    FITS_EXECUTOR,
    FORCE,
    SEED_OF_BOOTSTRAP,
    TIME_LIMIT,
    Option,
    add_command,
    page_file,
)
from consistent_id.cli.source import SOURCE, STATED, each, studied

_MORE = """It begins with the estimate to use, and why; faults of the data, parameters
with intervals, links, validation torque and residuals follow. The file needs no other
and no network. Exit code 1: do not use the estimate."""
_EXAMPLES = """
consistent-id report problems/rx60
consistent-id report problems/ur10e --output ur10e.html
consistent-id report robot.urdf log.csv --output robot.html
consistent-id report results/robot --output robot.html
"""


def add_report(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_report,
        *SOURCE,
        Option(
            "--output FILE",
            "file to write (default: results/NAME/report.html); FILE-NAME for each of "
            "several problems",
            page_file,
        ),
        FORCE,
        SEED_OF_BOOTSTRAP,
        ACCEPT,
        FITS_EXECUTOR,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_report(options: argparse.Namespace) -> int:
    """Write a report, one for each of several problems; return the exit code."""
    return each(options, _report, file=True)


def _report(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable_file, write_atomically
    from consistent_id.problems.loading import is_results
    from consistent_id.report.results import REPORT

    stands = is_results(options.problem) and not options.log

    def place(name: str) -> Path:
        folder = options.problem if stands else Path("results") / name
        file: Path = options.output or folder / REPORT
        return file

    found = studied(options, before=lambda name: require_writable_file(place(name)))
    file = write_atomically(place(found.name), found.page)
    tables = [*found.tables("identify")[:2]]
    text = "\n\n".join(table.text() for table in tables)
    text += f"\nwritten: {file} ({file.stat().st_size / 1000:.0f} kB)"
    name = "consistent_id report 1"
    record = {"format": name, **found.answer, "written": str(file)}
    return Answer(0 if found.verdict.usable else 1, text, record)
