"""``consistent-id report PROBLEM``: its options, and what it prints."""

import argparse
import json
import shlex
import sys
from pathlib import Path
from typing import Any

TEXT = "write all that is found of a problem as one HTML file"
_MORE = """It opens with the estimate to use, and why; the data's health, parameters
with intervals, bodies, held-out torque and residuals follow. The file needs no other
and no network. Exit code 1: there is no estimate to use, or the log is faulty."""


def add_report(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("report", help=TEXT, description=f"{TEXT}. {_MORE}")
    command.add_argument(
        "problem", type=Path, help="folder with a problem.toml, or the file"
    )
    command.add_argument(
        "--output", type=Path, help="file to write (default: results/NAME/report.html)"
    )
    command.add_argument(
        "--seed", type=int, default=0, help="of the bootstrap (default: 0)"
    )
    command.add_argument("--json", action="store_true", help="print JSON, not text")


def run_report(options: argparse.Namespace) -> int:
    """Write a report; return the exit code."""
    from consistent_id.commands_report import report_problem
    from consistent_id.problem import load_problem

    problem = load_problem(options.problem)
    output = options.output or Path("results") / problem.name / "report.html"
    place = shlex.quote(str(options.problem))
    reported = report_problem(
        problem,
        output,
        seed=options.seed,
        command=f"consistent-id report {place} --seed {options.seed}",
        progress=sys.stderr.isatty(),
    )
    advice = reported.advice
    if options.json:
        record = {
            "level": advice.level,
            "method": advice.method or None,
            "reasons": list(advice.reasons),
            "cautions": list(advice.cautions),
            "written": str(reported.path),
        }
        print(json.dumps(record, indent=1))
    else:
        print(f"use: {advice.method or 'none of the estimates'}")
        for sentence in (*advice.reasons, *advice.cautions):
            print(f"  {sentence}")
        print(f"written: {reported.path} ({reported.size / 1000:.0f} kB)")
    return 0 if advice.method and not reported.faults else 1
