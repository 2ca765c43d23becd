"""``consistent-id compare PROBLEM``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, shows_progress
from consistent_id.cli.options import (
    add_command,
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
        more="Tables and figures are written. Exit code 1: no estimate is usable.",
        examples=_EXAMPLES,
    )
    add_problem(command)
    add_output(command, "results/NAME")
    add_time_limit(command)


def run_compare(options: argparse.Namespace) -> int:
    """Compare; return the exit code."""
    return answered(options, _compare)


def _compare(options: argparse.Namespace) -> Answer:
    from consistent_id.cli.commands import compare_problem
    from consistent_id.problems.problem import load_problem
    from consistent_id.report.study_record import study_record

    problem = load_problem(options.problem)
    output = options.output or Path("results") / problem.name
    study, tables, written = compare_problem(
        problem,
        None if options.dry_run else output,
        progress=shows_progress(options),
    )
    parts = [table.text() for table in tables]
    if written:
        parts.append("written: " + ", ".join(str(path) for path in written))
    usable = any(report.verdict == "certified" for report in study.comparison.reports)
    return Answer(0 if usable else 1, "\n\n".join(parts), study_record(study))
