"""``consistent-id init robot.urdf [log.csv]``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.cli.answers import Answer, show, shows_progress
from consistent_id.cli.options import WRITES, Option, add_command
from consistent_id.cli.source import STATED, statement
from consistent_id.recordings.log_formats import LOG_FORMATS

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft
    from consistent_id.problems.robot_draft import RobotDraft

_MORE = """Joints and columns are matched by name; the rate, the rows that move and the
cut-off are found in the log. Each guess is marked by a comment. Without a log, the
file says what motion to record first."""
_EXAMPLES = """
consistent-id init robot.urdf log.csv
consistent-id init robot.urdf
consistent-id init robot.urdf log.csv --output study/problem.toml --masses free
consistent-id init robot.urdf log.parquet --torque current{number} --torque-gain 10.5
consistent-id init robot.urdf a.csv b.csv --validate c.csv --units deg ms
consistent-id init robot.urdf log.csv --dry-run
"""


def add_init(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_init,
        Option("model", "URDF or MJCF file", Path),
        Option("log [...]", ", ".join(known.name for known in LOG_FORMATS), Path),
        Option(
            "--output FILE",
            "file to write, such as arm.toml; or a folder, which gets problem.toml",
            default=Path("problem.toml"),
        ),
        *WRITES,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_init(options: argparse.Namespace) -> int:
    """Write a problem file; return the exit code."""
    from consistent_id._support.files import require_writable_file
    from consistent_id.problems.draft import Draft
    from consistent_id.problems.kept_text import write_problem
    from consistent_id.problems.paths import names_outside

    file = options.output
    if file.is_dir() or not (file.suffix or file.exists()):
        file /= "problem.toml"
    if not options.dry_run:
        require_writable_file(file)
    draft = _draft(options)
    chosen = draft.selection if isinstance(draft, Draft) else None
    text = draft.text(file.parent)
    shown = text
    if not options.dry_run:
        shown += f"\nwritten: {write_problem(text, file)}"
        outside = any(names_outside(draft.table(file.parent), file))
        if chosen is not None:
            shown = chosen.table().text() + "\n\n" + shown
        command, more = "compare" if options.log else "excite", " --trust" * outside
        if options.gains:  # commands whose delay has not been stated yet
            command = "rollout"
        shown += f"\nnext: consistent-id {command} {file}{more}"
    record = {
        "format": "consistent_id draft 1",
        "problem": draft.name,
        "text": text,
        "selection": None if chosen is None else chosen.to_dict(),
        "written": None if options.dry_run else str(file),
    }
    return show(options, Answer(0, shown, record, whole=options.dry_run))


def _draft(options: argparse.Namespace) -> "Draft | RobotDraft":
    from consistent_id._support.progress import begun

    names = ", ".join(path.name for path in (options.model, *(options.log or ())))
    begun(f"reading {names}", shows_progress(options))
    from consistent_id.problems.drafting import drafted
    from consistent_id.problems.robot_draft import robot_draft

    stated = statement(options)
    if not options.log:
        return robot_draft(options.model, None, stated)
    return drafted(options.model, options.log, stated, progress=shows_progress(options))
