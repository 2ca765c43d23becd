"""``consistent-id info PROBLEM``: what a problem consists of; what is in a folder."""

import argparse
from dataclasses import asdict
from typing import Any

from consistent_id.cli.answers import Answer, answered, show, tables_answer
from consistent_id.cli.options import PROBLEM, add_command

_EXAMPLES = """
consistent-id info problems
consistent-id info problems/rx60
consistent-id info problems/ur10e/payload.toml --json
"""


def add_info(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "info",
        "show a problem's robot, datasheet and base parameters",
        run_info,
        PROBLEM,
        more="Of a folder of several, list the problems.",
        examples=_EXAMPLES,
    )


def run_info(options: argparse.Namespace) -> int:
    """Show a problem, or list several; return the exit code."""
    from consistent_id.problems.folder import problem_files

    files = problem_files(options.problem)
    if len(files) == 1:
        return answered(options, _info)
    from consistent_id.problems.listing import list_problems

    table = list_problems(options.problem, files)
    return show(options, tables_answer([table], [asdict(table)]))


def _info(options: argparse.Namespace) -> Answer:
    from consistent_id.problems.listing import problem_tables
    from consistent_id.problems.loading import load_problem

    tables = problem_tables(load_problem(options.problem))
    return tables_answer(tables, [asdict(table) for table in tables])
