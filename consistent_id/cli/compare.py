"""``consistent-id compare PROBLEM``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, shows_progress, tables_answer
from consistent_id.cli.options import (
    ACCEPT,
    FITS_EXECUTOR,
    PROBLEM,
    RESULTS,
    TIME_LIMIT,
    add_command,
)

_EXAMPLES = """
consistent-id compare problems/rx60
consistent-id compare problems --json
consistent-id compare problems/tiago --dry-run
"""


def add_compare(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "compare",
        "compare least squares with constrained estimates",
        run_compare,
        PROBLEM,
        *RESULTS,
        ACCEPT,
        FITS_EXECUTOR,
        TIME_LIMIT,
        more="Tables and figures are written. Exit code 1: do not use the estimate.",
        examples=_EXAMPLES,
    )


def run_compare(options: argparse.Namespace) -> int:
    """Compare; return the exit code."""
    return answered(options, _compare)


def _compare(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.study import run_study
    from consistent_id.report.study_record import study_record
    from consistent_id.report.summary import study_tables

    problem = load_problem(options.problem)
    output = options.output or Path("results") / problem.name
    if not options.dry_run:
        require_writable(output, ["comparison.md", "comparison.json"])
    study = run_study(
        problem, progress=shows_progress(options), accepted=options.accept
    )
    tables = study_tables(study)

    def write() -> list[Path]:
        from consistent_id.cli.results import write_comparison

        return write_comparison(study, tables, output)

    record, usable = study_record(study), study.verdict.usable
    return tables_answer(tables, record, usable=usable, write=write)
