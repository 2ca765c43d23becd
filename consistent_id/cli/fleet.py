"""``consistent-id fleet`` and ``consistent-id compress``: many robots, long recordings.

The first identifies robots of one type together; the second compresses recordings of
any size into a regression.
"""

import argparse
import glob
from pathlib import Path

from consistent_id.cli.answers import Answer, show, shows_progress, tables_answer
from consistent_id.cli.options import (
    EXECUTOR,
    ONE_PROBLEM,
    OUTPUT,
    TIME_LIMIT,
    WRITES,
    Option,
    add_command,
)

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
_PACK = """Recordings are read piece by piece, so that they may be larger than memory.
The file, a megabyte or so, is all that estimates need: in Python,
load_regression(FILE), which can be merged with others and weighted anew."""
_PACK_EXAMPLES = """
consistent-id compress problem.toml --output regression.json
consistent-id compress problem.toml --output held-out.json --role validation
consistent-id compress problem.toml --output regression.json --executor processes
"""


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


def add_compress(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_compress,
        ONE_PROBLEM,
        Option("--output FILE", "file to write", required=True),
        Option(
            "--role",
            "recordings to compress",
            choices=("training", "validation"),
            default="training",
        ),
        EXECUTOR,
        *WRITES,
        TIME_LIMIT,
        more=_PACK,
        examples=_PACK_EXAMPLES,
    )


def run_compress(options: argparse.Namespace) -> int:
    """Compress recordings; return the exit code."""
    from consistent_id._support.files import require_writable_file
    from consistent_id._support.tables import Table
    from consistent_id.fleet.stream import stream_regression
    from consistent_id.problems.loading import load_problem
    from consistent_id.regression.given_regression import save_regression

    if not options.dry_run:
        require_writable_file(options.output)
    problem = load_problem(options.problem)
    regression = stream_regression(
        problem,
        role=options.role,
        executor=options.executor,
        progress=shows_progress(options),
    )
    columns = zip(
        regression.joints,
        regression.counts,
        regression.effective.tolist(),
        regression.torque_rms.tolist(),
        strict=True,
    )
    table = Table(
        f"Regression of {problem.name}: {len(regression.layout)} parameters",
        ("joint", "samples", "effective samples", "RMS torque"),
        tuple((j, str(n), f"{e:.0f}", f"{rms:.4g}") for j, n, e, rms in columns),
        ("effective samples: as informative with white noise; torque in N m or N",),
    )
    record = {
        "format": "consistent_id compression 1",
        "joints": list(regression.joints),
        "samples": list(regression.counts),
        "effective_samples": regression.effective.tolist(),
        "torque_rms": regression.torque_rms.tolist(),
    }

    def write() -> list[Path]:
        return [save_regression(regression, options.output)]

    return show(options, Answer(0, table.text(), record, write))
