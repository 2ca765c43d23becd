"""``consistent-id compare PROBLEM``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, shows_progress
from consistent_id.cli.options import (
    add_accept,
    add_command,
    add_executor,
    add_output,
    add_problem,
    add_time_limit,
)

_EXAMPLES = """
consistent-id compare problems/rx60
consistent-id compare problems --json
consistent-id compare problems/tiago --dry-run
"""


def add_compare(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(
        commands,
        "compare",
        "compare least squares with constrained estimates",
        run_compare,
        more="Tables and figures are written. Exit code 1: do not use the estimate.",
        examples=_EXAMPLES,
    )
    add_problem(command)
    add_output(command, "results/NAME")
    add_accept(command)
    add_executor(command, None)
    add_time_limit(command)


def run_compare(options: argparse.Namespace) -> int:
    """Compare; return the exit code."""
    return answered(options, _compare)


def _compare(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable
    from consistent_id.problems.problem import load_problem
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

    return Answer(
        0 if study.verdict.usable else 1,
        "\n\n".join(table.text() for table in tables),
        study_record(study),
        None if options.dry_run else write,
    )
