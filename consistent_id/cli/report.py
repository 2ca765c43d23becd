"""``consistent-id report PROBLEM``: its options, and what it prints."""

import argparse
import shlex
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, show, shows_progress
from consistent_id.cli.option import Option
from consistent_id.cli.options import (
    ACCEPT,
    FITS_EXECUTOR,
    FORCE,
    ONE_PROBLEM,
    SEED_OF_BOOTSTRAP,
    TIME_LIMIT,
    add_command,
)

_MORE = """It begins with the estimate to use, and why; faults of the data, parameters
with intervals, links, validation torque and residuals follow. The file needs no other
and no network. Exit code 1: do not use the estimate."""
_EXAMPLES = """
consistent-id report problems/rx60
consistent-id report problems/ur10e --output ur10e.html
"""


def add_report(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "report",
        "write everything about a problem into one HTML file",
        run_report,
        ONE_PROBLEM,
        Option("--output FILE", "file to write (default: results/NAME/report.html)"),
        FORCE,
        SEED_OF_BOOTSTRAP,
        ACCEPT,
        FITS_EXECUTOR,
        TIME_LIMIT,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_report(options: argparse.Namespace) -> int:
    """Write a report; return the exit code."""
    from consistent_id._support.files import require_writable_file
    from consistent_id.laboratory.rollout.study_section import rollout_section
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.study import run_study
    from consistent_id.report import write_report
    from consistent_id.report.summary import headline_tables

    problem = load_problem(options.problem)
    file = options.output or Path("results") / problem.name / "report.html"
    require_writable_file(file)
    study = run_study(
        problem,
        seed=options.seed,
        progress=shows_progress(options),
        accepted=options.accept,
    )
    accepted = "".join(f" --accept {shlex.quote(kind)}" for kind in options.accept)
    write_report(
        study,
        file,
        uncertainty=study.uncertainty,
        further=rollout_section(study),
        seed=options.seed,
        command=f"consistent-id report {shlex.quote(str(options.problem))} "
        f"--seed {options.seed}{accepted}",
    )
    verdict = study.verdict
    text = "\n\n".join(table.text() for table in headline_tables(study))
    text += f"\nwritten: {file} ({file.stat().st_size / 1000:.0f} kB)"
    record = verdict.to_dict() | {
        "recommended": study.recommendation.statement,
        "written": str(file),
    }
    return show(options, Answer(0 if verdict.usable else 1, text, record))
