"""``consistent-id reproduce PROBLEM``: its options, and what it prints."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

TEXT = "do a paper's study again: experiments, tables, explanation, verification"
_MORE = """Writes one HTML page, its tables as Markdown, and all numbers as JSON. The
problem needs [published], [tasks] and [laboratory]. Exit code 1: a constrained estimate
is not certified; all is written nonetheless."""


def add_reproduce(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser(
        "reproduce", help=TEXT, description=f"{TEXT}. {_MORE}"
    )
    command.add_argument(
        "problem", type=Path, help="folder with a problem.toml, or the file"
    )
    command.add_argument(
        "--quick",
        action="store_true",
        help="fewer experiments, one set of exciting motions, one draw",
    )
    command.add_argument(
        "--seed", type=int, default=0, help="of designs and draws (default: 0)"
    )
    command.add_argument(
        "--output", type=Path, help="folder to write to (default: results/NAME)"
    )
    command.add_argument("--json", action="store_true", help="print JSON, not tables")


def run_reproduce(options: argparse.Namespace) -> int:
    """Do a study again; return the exit code."""
    from consistent_id._files import require_writable
    from consistent_id.problem import load_problem
    from consistent_id.reproduction.record import (
        reproduction_record,
        write_reproduction,
    )
    from consistent_id.reproduction.sections import sections_of
    from consistent_id.reproduction.study import FULL, QUICK, reproduce

    problem = load_problem(options.problem)
    folder = options.output or Path("results") / problem.name
    require_writable(folder)

    def tell(step: str) -> None:
        if sys.stderr.isatty():
            print(f"{step} ...", file=sys.stderr, flush=True)

    study = reproduce(
        problem, QUICK if options.quick else FULL, seed=options.seed, tell=tell
    )
    written = write_reproduction(study, folder)
    if options.json:
        print(json.dumps(reproduction_record(study), indent=1, allow_nan=False))
    else:
        tables = [table for part in sections_of(study) for table in part.tables]
        print("\n\n".join(table.text() for table in tables))
        print("\nwritten: " + ", ".join(str(path) for path in written))
    return 0 if study.certified else 1
