"""``consistent-id select PROBLEM``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, shows_progress
from consistent_id.cli.log_options import BAND
from consistent_id.cli.option import Option
from consistent_id.cli.options import (
    FITS_EXECUTOR,
    PROBLEM,
    TIME_LIMIT,
    WRITES,
    add_command,
)

_MORE = """Drive terms, masses, cut-offs, rows and a delay are chosen from the training
recordings alone, by the torque that is predicted on blocks that are left out. What
does not change stays as you wrote it, comments included. Interrupted, it shows the
best choice so far."""
_EXAMPLES = """
consistent-id select problems/ur10e
consistent-id select problems/ur10e --keep masses motion_cutoff --dry-run
consistent-id select problem.toml --output problem.toml --force
"""


def add_select(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "select",
        "choose the model that the training data ask for",
        run_select,
        PROBLEM,
        Option(
            "--output FILE", "to write (default: NAME-selected.toml beside the problem)"
        ),
        *WRITES,
        Option(
            "--keep KIND ...",
            "what stays as the file has it, such as masses or motion_cutoff",
        ),
        BAND,
        FITS_EXECUTOR,
        TIME_LIMIT,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_select(options: argparse.Namespace) -> int:
    """Choose a model; return the exit code."""
    return answered(options, _select)


def _select(options: argparse.Namespace) -> Answer:
    from consistent_id.errors import ProblemError
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.selection.select import select_model

    problem = load_problem(options.problem)
    source = problem.source or problem.folder / "problem.toml"
    file = options.output or source.with_name(f"{source.stem}-selected.toml")
    if file.parent.resolve() != source.parent.resolve():
        raise ProblemError(
            f"{file} is not in the folder of {source}, from which its files are named; "
            f"write it there: --output {source.with_name(file.name)}"
        )
    if file.exists() and not (options.force or options.dry_run):
        raise ProblemError(
            f"{file} is there already; name another with --output, or say --force"
        )
    selection = select_model(
        problem,
        fixed=options.keep,
        band=options.band,
        progress=shows_progress(options),
    )

    def write() -> list[Path]:
        from consistent_id._support.files import write_atomically

        return [write_atomically(file, selection.text())]

    record = {**selection.to_dict(), "text": selection.text()}
    shown = selection.table().text()
    return Answer(0, shown, record, write)
