"""Rows of long tables: measured once for the same inputs, each with its day and commit.

A robot's rows are kept in a file as soon as they are measured, and are taken from there
unless the robot's files have changed: a table that was interrupted goes on, and a part
of it is measured again alone.  Rows say when they were measured.
"""

import argparse
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Any

from pages import digest, stamp
from repair import EXAMPLES

Rows = tuple[list[list[str]], list[list[str]]]
"""Rows of a table, and of a second one."""


@dataclass(frozen=True)
class Job:
    """What a tool does with a robot.

    Parameters
    ----------
    inputs : str
        Digest of the files and settings that its rows depend on.
    rows : callable
        Yields the rows; those of a second table go to its argument.
    """

    robot: str
    tool: str
    inputs: str
    rows: Callable[[list[list[str]]], Iterable[list[str]]]


def files(names: Sequence[str], folder: Path) -> list[Path]:
    """Return the files that names, patterns and environment variables stand for."""
    os.environ.setdefault("EXAMPLE_ROBOT_DATA", str(EXAMPLES))
    found: list[Path] = []
    for name in names:
        path = str(folder / os.path.expandvars(name))
        matching = sorted(glob(path)) if "*" in path else [path]
        found += map(Path, matching)
    return found


def inputs_of(entry: Mapping[str, Any], folder: Path) -> str:
    """Return a digest of an entry, of its problem file or of its files."""
    whole = hashlib.sha256(json.dumps(entry, sort_keys=True).encode())
    if "problem" in entry:
        whole.update(digest(entry["problem"], folder).encode())
    else:
        named = [entry["robot"], *entry["logs"], *entry.get("validate", ())]
        for file in files(named, folder):
            whole.update(file.read_bytes())
    return whole.hexdigest()[:12]


def add_resume(parser: argparse.ArgumentParser) -> None:
    """Give a command the option `--resume`."""
    text = "file that keeps measured rows, to go on with"
    parser.add_argument("--resume", type=Path, metavar="FILE.jsonl", help=text)


@dataclass(frozen=True)
class Kept:
    """Rows that were measured before, in a file with a JSON object on each line."""

    file: Path | None

    def found(self, job: Job) -> Rows | None:
        """Return the rows of a job, if it was done."""
        if self.file is None or not self.file.exists():
            return None
        key = [job.robot, job.tool, job.inputs]
        for line in reversed(self.file.read_text().splitlines()):
            record = json.loads(line)
            if record["job"] == key:
                return record["rows"], record["alike"]
        return None

    def done(self, job: Job) -> Rows:
        """Return the same, measured if it was not."""
        if (found := self.found(job)) is not None:
            return found
        alike: list[list[str]] = []
        rows = list(job.rows(alike))
        when = re.sub(r"^ on (\S+) \(commit (\S+);.*", r"\1, \2", stamp())
        rows, alike = ([[*cells, when] for cells in some] for some in (rows, alike))
        if self.file is not None:
            record = {"job": [job.robot, job.tool, job.inputs]}
            record |= {"rows": rows, "alike": alike}
            with self.file.open("a") as out:
                out.write(f"{json.dumps(record)}\n")
        return rows, alike
