"""``consistent-id select PROBLEM``: its options, and what it prints."""

import argparse
from dataclasses import replace
from pathlib import Path

from consistent_id.cli.answers import Answer, answered, shows_progress
from consistent_id.cli.options import (
    FITS_EXECUTOR,
    TIME_LIMIT,
    WRITES,
    Option,
    add_command,
)
from consistent_id.cli.source import PROBLEM_ALONE, STATED, statement

_MORE = """Drive terms, masses, cut-offs, rows and a delay are chosen by how well the
torque of the training recordings is predicted on blocks that were left out of the fit.
The rest of the file stays as you wrote it, comments included. If interrupted, the
command shows the best choice so far."""
_EXAMPLES = """
consistent-id select problems/ur10e
consistent-id select problems/ur10e --keep masses motion_cutoff --dry-run
consistent-id select problem.toml --output problem.toml --force
"""


def add_select(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_select,
        PROBLEM_ALONE,
        Option(
            "--output FILE",
            "file to write (default: NAME-selected.toml beside the problem)",
        ),
        *WRITES,
        FITS_EXECUTOR,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_select(options: argparse.Namespace) -> int:
    """Choose a model; return the exit code."""
    return answered(options, _select)


def _select(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable_file
    from consistent_id.errors import ProblemError
    from consistent_id.problems.loading import stated_problem
    from consistent_id.problems.selection.model_selection import select_model

    stated = statement(options)
    if stated.select is not None:
        raise ProblemError("--no-select is for identify, check, ...; leave it out")
    known = replace(stated, keep=(), band=None)
    problem, notes = stated_problem(options.problem, known)
    source = problem.source or problem.folder / "problem.toml"
    file = options.output or source.with_name(f"{source.stem}-selected.toml")
    if file.parent.resolve() != source.parent.resolve():
        raise ProblemError(
            f"{file} is not in the folder of {source}, from which its files are named; "
            f"write it there: --output {source.with_name(file.name)}"
        )
    if not options.dry_run:
        require_writable_file(file)
    selection = select_model(
        problem,
        fixed=stated.keep,
        band=stated.band,
        progress=shows_progress(options),
    )

    def write() -> list[Path]:
        from consistent_id.problems.kept_text import write_problem

        return [write_problem(selection.text(), file)]

    name = "consistent_id selection 1"
    record = {"format": name, **selection.to_dict(), "text": selection.text()}
    table = selection.table()
    shown = replace(table, notes=(*table.notes, *notes)).text()
    return Answer(0, shown, record, write)
