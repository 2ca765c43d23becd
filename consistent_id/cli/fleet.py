"""``consistent-id fleet PROBLEM ...``: robots of one type, identified together."""

import argparse
import glob
from pathlib import Path

from consistent_id.cli.answers import show, shows_progress, tables_answer
from consistent_id.cli.options import EXECUTOR, OUTPUT, TIME_LIMIT, Option, add_command

_MORE = """Each robot has a problem file of its own, with the same model. Links, rotor
inertias, springs and coupled gears are shared; friction and offsets are each robot's
own. So is the load of a robot whose file has [payload] with the link that carries it.
Robots with other bodies are named and left out of the shared estimate. Training
recordings are read piece by piece, so they may be larger than memory.
--output gets fleet.md, fleet.json and bodies.json, the shared estimate. Exit code 1: do
not use the bodies."""
_EXAMPLES = """
consistent-id fleet 'logs/*/problem.toml' --output results/fleet
consistent-id fleet robots/a robots/b robots/c robots/d --executor processes
consistent-id fleet 'logs/*/problem.toml' --executor dask:tcp://10.0.0.5:8786
"""
_MARK = "<!-- consistent-id: tables of a fleet -->"


def add_fleet(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_fleet,
        Option(
            "problem ...",
            "problem files, folders with one, or patterns such as 'logs/*'",
        ),
        EXECUTOR,
        *OUTPUT,
        TIME_LIMIT,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_fleet(options: argparse.Namespace) -> int:
    """Identify a fleet; return the exit code."""
    from consistent_id._support.files import require_writable
    from consistent_id._support.progress import counted
    from consistent_id.fleet.identification import identify_fleet
    from consistent_id.problems.loading import load_problem

    if options.output is not None and not options.dry_run:
        require_writable(options.output)
    files, shown = _files(options.problem), shows_progress(options)
    problems = []
    with counted(len(files), "problem files", shown) as count:
        for file in files:
            problems.append(load_problem(file))
            count(len(problems))
    fleet = identify_fleet(problems, executor=options.executor, progress=shown)
    payloads = fleet.payload_table()
    tables = [
        fleet.headline(),
        fleet.table(),
        *([] if payloads is None else [payloads]),
        fleet.own_table(),
        fleet.bodies.table(),
    ]
    record = fleet.to_dict()

    def write() -> list[Path]:
        from consistent_id._support.files import write_atomically, write_json

        folder = options.output
        if folder is None:
            return []
        text = "\n".join([_MARK, "", *(table.markdown() for table in tables)])
        return [
            write_atomically(folder / "fleet.md", text),
            write_json(folder / "fleet.json", record),
            fleet.bodies.save(folder / "bodies.json"),
        ]

    usable = fleet.bodies.verdict.usable
    return show(options, tables_answer(tables, record, usable=usable, write=write))


def _files(given: list[str]) -> list[Path]:
    """Return the problem files that paths and patterns stand for."""
    from consistent_id.errors import ProblemError
    from consistent_id.problems.loading import problem_files

    files: list[Path] = []
    for text in given:
        found = [text] if Path(text).exists() else sorted(glob.glob(text))
        if not found:
            raise ProblemError(f"{text}: no such file, and no file of such a pattern")
        files += [file for path in found for file in problem_files(path)]
    return list(dict.fromkeys(files))
