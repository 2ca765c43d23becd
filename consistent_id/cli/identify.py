"""``consistent-id identify PROBLEM``: its options, and what it prints."""

import argparse
from typing import Any

from consistent_id.cli.answers import Answer, answered, shows_progress
from consistent_id.cli.options import add_command, add_output, add_problem

_EXAMPLES = """
consistent-id identify problems/rx60
consistent-id identify problems/ur10e --uncertainty --output results/ur10e
"""


def add_identify(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(
        commands,
        "identify",
        "estimate a problem's parameters by every method",
        run_identify,
        more="Exit code 1: no estimate could be certified.",
        examples=_EXAMPLES,
    )
    add_problem(command)
    command.add_argument(
        "--uncertainty",
        action="store_true",
        help="also say how sure the constrained estimate is of each parameter",
    )
    command.add_argument(
        "--seed", type=int, default=0, help="of the bootstrap (default: 0)"
    )
    add_output(command, None)


def run_identify(options: argparse.Namespace) -> int:
    """Identify; return the exit code."""
    return answered(options, _identify)


def _identify(options: argparse.Namespace) -> Answer:
    from consistent_id.commands import identify_problem, uncertainty_of
    from consistent_id.problem import load_problem

    problem = load_problem(options.problem)
    output = None if options.dry_run else options.output
    estimates, tables = identify_problem(problem, output)
    record: dict[str, object] = {"estimates": [e.to_dict() for e in estimates]}
    if options.uncertainty:
        found, table = uncertainty_of(
            problem, seed=options.seed, progress=shows_progress(options)
        )
        tables.append(table)
        record["uncertainty"] = found.to_dict()
    certified = any(e.certificate.verdict == "certified" for e in estimates)
    text = "\n\n".join(table.text() for table in tables)
    return Answer(0 if certified else 1, text, record)
