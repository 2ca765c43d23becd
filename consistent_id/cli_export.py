"""``consistent-id export PROBLEM``: its options, and what it prints."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

TEXT = "write the constrained estimate for other programmes"
_FORMATS = ("urdf", "mjcf", "json", "pin", "numpy", "casadi", "c")
_MORE = """Into the problem's own URDF (only numbers change) or MJCF, or as JSON,
pinocchio.Model, stand-alone NumPy, CasADi function or C. What a format cannot express
is said. Exit code 1: the estimate is refused, and nothing was written."""


def add_export(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("export", help=TEXT, description=f"{TEXT}. {_MORE}")
    command.add_argument(
        "problem", type=Path, help="folder with a problem.toml, or the file"
    )
    command.add_argument("--format", choices=_FORMATS, required=True)
    command.add_argument("--output", type=Path, required=True, help="file to write")
    command.add_argument(
        "--estimate",
        type=Path,
        metavar="FILE",
        help="an estimate that identify --output wrote (default: the constrained "
        "one, estimated now)",
    )
    command.add_argument(
        "--source",
        type=Path,
        metavar="FILE",
        help="URDF or MJCF to put the estimate into (default: the problem's)",
    )
    command.add_argument(
        "--allow-refused", action="store_true", help="write even what is refused"
    )
    command.add_argument("--dry-run", action="store_true", help="write nothing")
    command.add_argument("--json", action="store_true", help="print JSON, not text")


def run_export(options: argparse.Namespace) -> int:
    """Export an estimate; return the exit code."""
    from consistent_id.commands_export import estimate_for_export, exported
    from consistent_id.export.pedigree import export_verdict
    from consistent_id.problem import load_problem

    problem = load_problem(options.problem)
    estimate = estimate_for_export(problem, options.estimate)
    verdict = export_verdict(estimate)
    if verdict == "refused" and not options.allow_refused:
        print(
            f"consistent-id: the estimate by {estimate.method!r} is refused: "
            f"{estimate.certificate.reason}; --allow-refused writes it all the same",
            file=sys.stderr,
        )
        return 1
    export = exported(
        problem,
        estimate,
        options.format,
        source=options.source,
        allow_refused=options.allow_refused,
    )
    written = None if options.dry_run else export.save(options.output)
    record = {
        "format": export.format,
        "method": estimate.method,
        "verdict": verdict,
        "notes": list(export.notes),
        "written": written and str(written),
    }
    if options.json:
        print(json.dumps(record, indent=1))
    else:
        print(f"{estimate.method}: {verdict}")
        for note in export.notes:
            print(f"  {note}")
        print(f"written: {written}" if written else "nothing was written")
    return 0
