"""``consistent-id demo``: the example problems of the package, copied."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.options import WRITES, Option, add_command

_MORE = """The simulated RX-60 and quadruped and the KUKA KR300 are complete; the README
among them says where the recordings of the other robots are."""
_EXAMPLES = """
consistent-id demo
consistent-id compare problems/rx60
consistent-id compare problems/kuka_kr300
"""


def add_demo(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_demo,
        Option("--output FOLDER", "to write to", default=Path("problems")),
        *WRITES,
        more=_MORE,
        examples=_EXAMPLES,
        reads=False,
    )


def run_demo(options: argparse.Namespace) -> int:
    """Copy the problems; return the exit code.

    Existing files are kept if they are equal, and refused if not.
    """
    from consistent_id._support.files import require_replaceable, write_atomically

    source, folder = _source(), options.output
    files = sorted(path for path in source.rglob("*") if path.is_file())
    contents = {folder / path.relative_to(source): path.read_bytes() for path in files}
    if not options.dry_run:
        for path, content in contents.items():
            require_replaceable(path, content)

    def write() -> Sequence[Path]:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)
        return list(contents)

    names = sorted(path.parent.name for path in files if path.name == "problem.toml")
    text = f"Problems in {folder}: {', '.join(names)}\n" + "\n".join(
        f"try: consistent-id compare {shlex.quote(str(folder / name))}"
        for name in _COMPLETE
    )
    record = {
        "format": "consistent_id demo 1",
        "folder": str(folder),
        "written": [str(path) for path in contents],
    }
    return show(options, Answer(0, text, record, write))


_COMPLETE = ("rx60", "kuka_kr300")


def _source() -> Path:
    """Return the folder of problems, of a wheel or of the source tree."""
    from consistent_id.errors import ProblemError

    package = Path(__file__).parents[1]
    for folder in (package / "_problems", package.parent / "problems"):
        if (folder / "rx60" / "problem.toml").is_file():
            return folder
    raise ProblemError(
        f"{package / '_problems'} is missing; install the package again, or copy "
        "problems/ of its source archive"
    )
