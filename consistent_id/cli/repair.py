"""``consistent-id repair robot.urdf``: its options, and what it prints."""

import argparse
from pathlib import Path

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.options import WRITES, Option, add_command
from consistent_id.errors import ProblemError

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
