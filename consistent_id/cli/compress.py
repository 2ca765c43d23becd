"""``consistent-id compress PROBLEM``: recordings become a regression, once for all."""

import argparse
from pathlib import Path

from consistent_id.cli.answers import Answer, show, shows_progress
from consistent_id.cli.options import (
    EXECUTOR,
    ONE_PROBLEM,
    TIME_LIMIT,
    WRITES,
    Option,
    add_command,
)

_MORE = """Recordings are read piece by piece, so that they may be larger than memory.
The file, a megabyte or so, is all that estimates need: in Python,
load_regression(FILE), which can be merged with others and weighted anew."""
_EXAMPLES = """
consistent-id compress problem.toml --output regression.json
consistent-id compress problem.toml --output held-out.json --role validation
consistent-id compress problem.toml --output regression.json --executor processes
"""


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
        more=_MORE,
        examples=_EXAMPLES,
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
