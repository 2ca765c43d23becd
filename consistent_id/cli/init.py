"""``consistent-id init robot.urdf [log.csv]``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.base_options import given_base_options
from consistent_id.cli.log_options import DRAFT, draft_of
from consistent_id.cli.option import Option
from consistent_id.cli.options import WRITES, add_command
from consistent_id.errors import ProblemError
from consistent_id.recordings.log_formats import LOG_FORMATS

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft
    from consistent_id.problems.robot_draft import RobotDraft

_MORE = """Joints and columns are matched by name; the rate, the rows that move and the
cut-off are found in the log. What is a guess says so in a comment. Without a log, the
file says what motion to record first."""
_EXAMPLES = """
consistent-id init robot.urdf log.csv
consistent-id init robot.urdf
consistent-id init robot.urdf log.csv --output study/problem.toml --masses free
consistent-id init robot.urdf log.parquet --torque current{number} --torque-gain 10.5
consistent-id init robot.urdf a.csv b.csv --validate c.csv --units deg ms
consistent-id init robot.urdf log.csv --dry-run
"""


def add_init(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "init",
        "write a commented problem file for a robot, and a log if there is one",
        run_init,
        Option("model", "URDF or MJCF file", Path),
        Option("log [...]", ", ".join(known.name for known in LOG_FORMATS), Path),
        Option("--output FILE", "to write", default=Path("problem.toml")),
        *WRITES,
        *DRAFT,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_init(options: argparse.Namespace) -> int:
    """Write a problem file; return the exit code."""
    from consistent_id._support.files import write_atomically
    from consistent_id.problems.draft import Draft
    from consistent_id.problems.paths import names_outside

    file = options.output
    if file.exists() and not (options.force or options.dry_run):
        raise ProblemError(
            f"{file} is there already; name another with --output, or say --force"
        )
    draft = _draft(options)
    chosen = draft.selection if isinstance(draft, Draft) else None
    text = draft.text(file.parent)
    outside = any(names_outside(draft.table(file.parent), file))
    shown = text
    if not options.dry_run:
        shown += f"\nwritten: {write_atomically(file, text)}"
        if chosen is not None:
            shown = chosen.table().text() + "\n\n" + shown
        command, more = "compare" if options.log else "excite", " --trust" * outside
        if options.gains:  # of commands, whose delay nobody has stated yet
            command, more = "rollout", f" --choose{more}"
        shown += f"\nnext: consistent-id {command} {file}{more}"
    record = {
        "problem": draft.name,
        "text": text,
        "selection": None if chosen is None else chosen.to_dict(),
        "written": None if options.dry_run else str(file),
    }
    return show(options, Answer(0, shown, record, whole=options.dry_run))


def _draft(options: argparse.Namespace) -> "Draft | RobotDraft":
    from consistent_id.problems.robot_draft import robot_draft
    from consistent_id.robot.chains import Selection

    if options.log:
        return draft_of(options, options.model, options.log)
    channels = ("time", "position", "velocity", "torque", "torque_joints", "units")
    chosen = ("validate", "masses", "drive", "cutoff", "band", "no_select")
    names = (*channels, "torque_gain", *chosen)
    given = [name for name in names if getattr(options, name)]
    given += given_base_options(options)
    if given:
        flag = "--" + given[0].replace("_", "-")
        raise ProblemError(f"{flag} describes a log; name the log after the robot")
    return robot_draft(options.model, None, Selection(options.base, options.tip))
