"""``consistent-id lint`` and ``consistent-id repair``: a robot's file."""

import argparse
import sys
from pathlib import Path

from consistent_id.cli.answers import Answer, show, warnings_unless, wrapped
from consistent_id.cli.options import WRITES, Option, add_command
from consistent_id.errors import ProblemError

_LINT = """Finds values that simulators refuse, and values that they accept but should
not: masses outside the link's shapes, gravity beyond effort limits, placeholders,
vanishing masses, left and right limbs that differ, probable mistakes. Exit
code 1: there are errors, or with --strict warnings."""
_LINT_EXAMPLES = """
consistent-id lint robot.urdf
consistent-id lint robot.xml --strict
consistent-id lint left.urdf right.urdf --sarif findings.sarif
"""

_MORE = """The mistake that explains an inconsistent inertia is undone: a decimal point,
a sign, the order of entries, units. If none does, it moves to the nearest consistent
one. If several do, they are listed, and --choose takes one. Nothing else in the file
changes by a byte. A value that cannot be known is refused unless an option states it.
Exit code 1: something was refused, and nothing was written."""
_EXAMPLES = """
consistent-id repair robot.urdf --dry-run
consistent-id repair robot.urdf --output good.urdf --mass tool=0.4
consistent-id repair robot.urdf --choose forearm=2
consistent-id repair robot.urdf --density 1000 --thickness 0.001
"""


def add_lint(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_lint,
        Option("files ...", "URDF or MJCF files", Path),
        Option("--strict", "warnings end with exit code 1, too"),
        Option("--sarif FILE", "file to write, in SARIF 2.1.0"),
        more=_LINT,
        examples=_LINT_EXAMPLES,
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


def add_repair(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_repair,
        Option("urdf", "the file", Path),
        Option("--output FILE", "file to write (default: NAME.repaired.urdf)"),
        *WRITES,
        Option(
            "--mass LINK=KG",
            "a link's mass, in place of the file's; may be repeated",
            repeated=True,
        ),
        Option(
            "--choose LINK=N",
            "number of the suggestion for a link; 0: the nearest consistent inertia; "
            "may be repeated",
            repeated=True,
        ),
        Option(
            "--density KG/M3",
            "a ball of this density stands for an inertia that cannot be read",
            float,
        ),
        Option(
            "--thickness M",
            "least standard deviation of mass in each direction of a link, for "
            "simulators that refuse point masses and plates",
            float,
            default=0.0,
        ),
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_repair(options: argparse.Namespace) -> int:
    """Repair a file; return the exit code."""
    from consistent_id.repair.link_repair import repair_record, repair_table
    from consistent_id.repair.urdf_repair import repair_urdf

    repair = repair_urdf(
        options.urdf,
        masses=dict(_mass(text) for text in options.mass),
        density=options.density,
        thickness=options.thickness,
        choices=dict(_choice(text) for text in options.choose),
    )
    written = None
    changed = repair.content != repair.original
    if not (options.dry_run or repair.refused) and (changed or options.output):
        name = f"{options.urdf.stem}.repaired{options.urdf.suffix}"
        written = repair.save(options.output or options.urdf.with_name(name))
    record = repair_record(repair) | {"written": written and str(written)}
    text = repair_table(repair).text()
    nothing = "nothing was written"
    if repair.refused:
        nothing += ", not even repaired links: state first what is needed"
    text += f"\nwritten: {written}" if written else f"\n{nothing}"
    return show(options, Answer(1 if repair.refused else 0, text, record))


def _mass(text: str) -> tuple[str, float]:
    link, _, mass = text.rpartition("=")
    try:
        return link, float(mass)
    except ValueError:
        raise ProblemError(
            f"--mass {text!r}: expected a link and its mass in kg, such as tool=0.4"
        ) from None


def _choice(text: str) -> tuple[str, int]:
    link, _, number = text.rpartition("=")
    try:
        return link, int(number)
    except ValueError:
        raise ProblemError(
            f"--choose {text!r}: expected a link and a number, such as tool=1"
        ) from None
