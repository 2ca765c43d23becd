"""``consistent-id lint FILE``: its options, and what it prints."""

import argparse
import sys
from pathlib import Path

from consistent_id.cli.answers import Answer, show, warnings_unless, wrapped
from consistent_id.cli.options import Option, add_command

_MORE = """Finds values that simulators refuse, and values that they accept but should
not: masses outside the link's shapes, gravity beyond effort limits, placeholders,
vanishing masses, left and right limbs that differ, probable mistakes. Exit
code 1: there are errors, or with --strict warnings."""
_EXAMPLES = """
consistent-id lint robot.urdf
consistent-id lint robot.xml --strict
consistent-id lint left.urdf right.urdf --sarif findings.sarif
"""


def add_lint(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_lint,
        Option("files ...", "URDF or MJCF files", Path),
        Option("--strict", "warnings end with exit code 1, too"),
        Option("--sarif FILE", "file to write, in SARIF 2.1.0"),
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_lint(options: argparse.Namespace) -> int:
    """Look through files; return the exit code."""
    from consistent_id import __version__
    from consistent_id._support.files import write_json
    from consistent_id.repair.linting import lint_record, lint_robot, lint_text, sarif

    with warnings_unless(True):  # the findings say the same
        found = {str(path): lint_robot(path) for path in options.files}
    refused = any(
        options.strict or finding.severity == "error"
        for findings in found.values()
        for finding in findings
    )
    if options.sarif is not None:
        write_json(options.sarif, sarif(found, __version__))
    text, record = lint_text(found), lint_record(found)
    if sys.stdout.isatty():  # for other programs a finding stays one line
        text = "\n".join(short for line in text.splitlines() for short in wrapped(line))
    return show(options, Answer(int(refused), text, record, whole=True))
