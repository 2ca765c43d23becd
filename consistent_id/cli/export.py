"""``consistent-id export PROBLEM``: its options, and what it prints."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.option import Option
from consistent_id.cli.options import ACCEPT, ONE_PROBLEM, WRITES, add_command
from consistent_id.export.export_formats import EXPORT_FORMATS, exported

if TYPE_CHECKING:
    from consistent_id.estimation.estimate import Estimate
    from consistent_id.export.exported_file import Export
    from consistent_id.problems.problem import Problem

_MORE = f"""The formats are {", ".join(known.content for known in EXPORT_FORMATS)}. In
the problem's own URDF only numbers change. What a format cannot express is printed.
Exit code 1: do not use the estimate; nothing was written."""
_EXAMPLES = """
consistent-id export problems/ur10e --format urdf --output ur10e.urdf
consistent-id export problems/rx60 --format c --output rx60.c
consistent-id export problems/rx60 --format json --output rx60.json --dry-run
"""


def add_export(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "export",
        "write the estimate that identify delivers for other programs",
        run_export,
        ONE_PROBLEM,
        Option(
            "--format",
            "of the file",
            choices=[known.name for known in EXPORT_FORMATS],
            required=True,
        ),
        Option("--output FILE", "file to write", required=True),
        Option(
            "--estimate FILE",
            "an estimate that identify --output wrote (default: the one that identify "
            "delivers, estimated now)",
        ),
        Option(
            "--source FILE",
            "URDF or MJCF to put the estimate into (default: the problem's)",
        ),
        ACCEPT,
        Option(
            "--copy-files",
            "copy the meshes and textures of an MJCF file beside the output",
        ),
        *WRITES,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_export(options: argparse.Namespace) -> int:
    """Export an estimate; return the exit code."""
    from dataclasses import replace

    from consistent_id.estimation.estimate import Estimate
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.study import Study

    problem = load_problem(options.problem)
    study = Study(problem, accepted=tuple(options.accept))
    if options.estimate is None:
        estimate, verdict = study.delivered, study.verdict
    else:
        estimate = Estimate.load(options.estimate, problem.model, study.base)
        verdict = study.judged(estimate)
    if not verdict.usable:
        kinds = " ".join(f"--accept {r.kind!r}" for r in verdict.grounds)
        print(
            "\n".join((verdict.sentence, *verdict.lines, f"{kinds} writes it anyway")),
            file=sys.stderr,
        )
        return 1
    export = _export(options, problem, replace(estimate, judged=verdict))
    written = None if options.dry_run else export.save(options.output)
    record = {
        "format": export.format,
        "method": estimate.method,
        "verdict": verdict.word,
        "accepted": list(verdict.accepted),
        "notes": [*estimate.notes, *export.notes],
        "written": written and str(written),
    }
    notes = (*verdict.lines, *estimate.notes, *export.notes)
    lines = [verdict.sentence, *(f"  {note}" for note in notes)]
    lines.append(f"written: {written}" if written else "nothing was written")
    return show(options, Answer(0, "\n".join(lines), record))


def _export(
    options: argparse.Namespace, problem: "Problem", estimate: "Estimate"
) -> "Export":
    # What is behind a wrench sensor is in no file of the arm's.
    own = problem.model_files if problem.arm is None else {}
    delay = problem.delay_of_commands
    return exported(
        estimate,
        options.format,
        source=options.source or own.get(options.format),
        folder=options.output.parent,
        copy_files=options.copy_files,
        gains=problem.gains,
        delay=estimate.certificate.figures.get("delay of commands", delay),
    )
