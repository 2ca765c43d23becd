"""``consistent-id info PROBLEM``: what a problem consists of; what is in a folder."""

import argparse
from dataclasses import asdict

from consistent_id.cli.answers import Answer, show, tables_answer
from consistent_id.cli.options import add_command
from consistent_id.cli.source import SOURCE, STATED, each, opened, stored

_EXAMPLES = """
consistent-id info problems
consistent-id info problems/rx60
consistent-id info problems/ur10e/payload.toml --json
"""


def add_info(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_info,
        *SOURCE,
        *STATED,
        more="List the problems of a folder of several.",
        examples=_EXAMPLES,
    )


def run_info(options: argparse.Namespace) -> int:
    """Show a problem, or list several; return the exit code."""
    from consistent_id.problems.loading import is_results, problem_files

    one = options.log or is_results(options.problem)
    files = () if one else problem_files(options.problem)
    if len(files) < 2:
        return each(options, _info)
    from consistent_id.problems.loading import list_problems

    table = list_problems(options.problem, files)
    return show(options, tables_answer([table], [asdict(table)]))


def _info(options: argparse.Namespace) -> Answer:
    from consistent_id.problems.loading import problem_tables

    results = stored(options)
    if results is not None:
        tables = [*results.tables("identify")[:1], *results.tables("info")]
    else:
        source = opened(options)
        tables = source.noted([*problem_tables(source.problem), *source.tables()])
    return tables_answer(tables, [asdict(table) for table in tables])
