"""Memory and time of regressions of logs that are larger than memory, by their length.

``python benchmarks/streaming.py [--samples 10000 ... 30000000] [--form Parquet CSV HDF5
MCAP] [--executor serial] [--write docs/large-logs-and-fleets.md]``

A log of a 7-joint arm's positions and torques at 1 kHz is written for each length, and
streamed in a process of its own: filtered at 20 Hz, differentiated, compressed.  The
exponent of time is that between the two longest.  Memory is that process's peak.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from long_logs import FILES, write
from memory import peak
from pages import written_to

import consistent_id as ci

_LENGTHS = (10_000, 100_000, 1_000_000, 3_000_000)
HEAD = """| log | samples | file [MB] | peak memory [MB] | CPU [us per sample] |
|---|---:|---:|---:|---:|"""
TABLE = 'columns = {torque = "tau_{joint}"}'
BAG = 'columns = {time = "header.stamp", position = "position", torque = "effort"}'
PROBLEM = """
name = "arm"
[model]
modified_dh = [
  {alpha_deg = 0, a = 0, d = 0.333}, {alpha_deg = -90, a = 0},
  {alpha_deg = 90, a = 0, d = 0.316}, {alpha_deg = 90, a = 0.0825},
  {alpha_deg = -90, a = -0.0825, d = 0.384}, {alpha_deg = 90, a = 0},
  {alpha_deg = 90, a = 0.088},
]
[drive]
viscous = true
coulomb = "sign"
offset = true
rotor_inertia = true
[constraints]
masses = "free"
[data]
columns = {torque = "tau_{joint}"}
preparation = {motion_cutoff = 20.0, torque_cutoff = 20.0}
[[data.recordings]]
file = "log.parquet"
role = "training"
"""


def measured(folder: Path, executor: str) -> dict[str, float]:
    """Stream a problem's log; return time and memory of this process."""
    problem = ci.load_problem(folder / "problem.toml")
    wall, cpu = perf_counter(), process_time()
    regression = ci.fleet.stream_regression(problem, executor=executor)
    taken = perf_counter() - wall, process_time() - cpu
    return {
        "samples": regression.counts[0],
        "wall": taken[0],
        "cpu": taken[1],
        "memory": peak(),
    }


def problem_text(form: str) -> str:
    """Return the problem file of a log of a format."""
    text = PROBLEM.replace("log.parquet", FILES[form])
    return text.replace(TABLE, BAG) if form == "MCAP" else text


def row(form: str, samples: int, executor: str) -> dict[str, float]:
    """Write a log and stream it in a process of its own; return its figures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "problem.toml").write_text(problem_text(form))
        size = write(folder, form, samples)
        command = [sys.executable, __file__, "--measure", name, "--executor", executor]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout) | {"size": size / 1e6}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--samples", type=int, nargs="+", default=_LENGTHS)
    options.add_argument("--form", choices=FILES, nargs="+", default=["Parquet"])
    options.add_argument("--executor", default="serial")
    options.add_argument("--write", type=Path, help="page with the table")
    options.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.measure is not None:
        print(json.dumps(measured(given.measure, given.executor)))
        return
    with written_to(given.write, "streaming"):
        print(HEAD)
        for form in given.form:
            _measure(form, given.samples, given.executor)


def _measure(form: str, lengths: Sequence[int], executor: str) -> None:
    """Print the rows of a format, and how time grows with the samples."""
    taken = []
    for samples in lengths:
        found = row(form, samples, executor)
        taken.append(found["cpu"])
        count = f"{samples:.0e}".replace("e+0", "e")
        print(
            f"| {form} | {count} | {found['size']:.0f} | {found['memory']:.0f} "
            f"| {found['cpu'] / samples * 1e6:.1f} |",
            flush=True,
        )
    if len(taken) > 1:
        exponent = np.diff(np.log(taken[-2:])) / np.diff(np.log(lengths[-2:]))
        print(f"| {form} | CPU ~ samples^{exponent[0]:.2f} | | | |")


if __name__ == "__main__":
    main()
