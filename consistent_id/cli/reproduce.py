"""``consistent-id reproduce PROBLEM``: its options, and what it prints."""

import argparse
import sys
from pathlib import Path

from consistent_id.cli.answers import Answer, answered, shows_progress, tables_answer
from consistent_id.cli.options import RESULTS, Option, add_command
from consistent_id.cli.source import PROBLEM_ALONE

_MORE = """Writes one HTML page, its tables as Markdown, and all numbers as JSON. The
problem needs [published], [tasks] and [laboratory]. Exit code 1: the optimum of a
constrained estimate is not certified; all is written nonetheless."""
_EXAMPLES = """
consistent-id reproduce problems/rx60
consistent-id reproduce problems/rx60 --quick --output results/paper
"""


def add_reproduce(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_reproduce,
        PROBLEM_ALONE,
        Option("--quick", "fewer experiments, one set of exciting motions, one draw"),
        Option("--seed N", "seed of designs and draws", int, default=0),
        *RESULTS,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_reproduce(options: argparse.Namespace) -> int:
    """Do a study again; return the exit code."""
    return answered(options, _reproduce)


def _reproduce(options: argparse.Namespace) -> Answer:
    from consistent_id._support.extras import needed
    from consistent_id._support.files import require_writable
    from consistent_id.laboratory.reproduction.paper_report import (
        reproduction_record,
        sections_of,
        write_reproduction,
    )
    from consistent_id.laboratory.reproduction.paper_study import FULL, QUICK, reproduce
    from consistent_id.problems.loading import load_problem

    problem = load_problem(options.problem)
    folder = options.output or Path("results") / problem.name
    if not options.dry_run:
        needed("matplotlib", "plots", "the page of a study")
        endings = ("html", "md", "json")
        require_writable(folder, [f"reproduction.{ending}" for ending in endings])

    def show(step: str) -> None:
        if shows_progress(options):
            print(f"{step} ...", file=sys.stderr, flush=True)

    study = reproduce(
        problem, QUICK if options.quick else FULL, seed=options.seed, progress=show
    )
    tables = [table for part in sections_of(study) for table in part.tables]

    def write() -> list[Path]:
        return write_reproduction(study, folder)

    record = reproduction_record(study)
    return tables_answer(tables, record, usable=study.certified, write=write)
