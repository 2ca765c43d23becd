"""``consistent-id report PROBLEM``: its options, and what it prints."""

import argparse
import shlex
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, show, shows_progress
from consistent_id.cli.options import add_command, add_time_limit

_MORE = """It opens with the estimate to use, and why; the data's health, parameters
with intervals, bodies, held-out torque and residuals follow. The file needs no other
and no network. Exit code 1: there is no estimate to use, or the log is faulty."""
_EXAMPLES = """
consistent-id report problems/rx60
consistent-id report problems/ur10e --output ur10e.html
"""


def add_report(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(
        commands,
        "report",
        "write all that is found of a problem as one HTML file",
        run_report,
        more=_MORE,
        examples=_EXAMPLES,
    )
    command.add_argument(
        "problem", type=Path, help="folder with a problem.toml, or the file"
    )
    command.add_argument(
        "--output",
        type=Path,
        metavar="FILE",
        help="file to write (default: results/NAME/report.html)",
    )
    command.add_argument(
        "--seed", type=int, default=0, help="of the bootstrap (default: 0)"
    )
    add_time_limit(command)


def run_report(options: argparse.Namespace) -> int:
    """Write a report; return the exit code."""
    from consistent_id.cli.commands_report import report_problem
    from consistent_id.problems.problem import load_problem

    problem = load_problem(options.problem)
    place = shlex.quote(str(options.problem))
    reported = report_problem(
        problem,
        options.output or Path("results") / problem.name / "report.html",
        seed=options.seed,
        command=f"consistent-id report {place} --seed {options.seed}",
        progress=shows_progress(options),
    )
    advice = reported.advice
    record = {
        "level": advice.level,
        "method": advice.method or None,
        "reasons": list(advice.reasons),
        "cautions": list(advice.cautions),
        "written": str(reported.path),
    }
    lines = [f"use: {advice.method or 'none of the estimates'}"]
    lines += [f"  {said}" for said in (*advice.reasons, *advice.cautions)]
    lines.append(f"written: {reported.path} ({reported.size / 1000:.0f} kB)")
    code = 0 if advice.method and not reported.faults else 1
    return show(options, Answer(code, "\n".join(lines), record))
