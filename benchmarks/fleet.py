"""Fleets of simulated robots: time, memory, outliers named, and how they grow.

``python benchmarks/fleet.py [--robots 10 30 100] [--samples 10000] [--executor WHERE]
[--executors WHERE ...] [--write docs/large-logs-and-fleets.md]``

Each robot is the 7-joint arm of ``streaming.py`` with friction and offsets of its own;
three in a hundred have 0.2 kg more on their last link.  Each writes a Parquet file at
1 kHz, and the fleet is identified from the problem files in a process of its own.  The
cost of 10 000 robots follows from a line through what was measured, and the exponent
between the two largest fleets says if that may be.  With ``--executors`` the largest
fleet is identified by each, which writes the page's other table.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import streaming
from memory import peak
from pages import written_to
from speed import arm, truth

import consistent_id as ci

_MANY = 10_000
_ENDS = 300  # rows at both ends that filters bend
_PIECE = 2**17  # samples written at a time


def write(folder: Path, robots: int, samples: int) -> list[str]:
    """Write problem files and logs; return the names of the outliers."""
    model, rng = arm(), np.random.default_rng(0)
    rates = np.array([1.1, 1.7, 2.3, 2.9, 3.1, 3.7, 4.3])
    heavy = set(rng.permutation(robots)[: max(1, round(0.03 * robots))].tolist())
    for k in range(robots):
        x = truth(model)
        x[70:] *= rng.uniform(0.6, 1.4, 28)
        x[73::4] = 0.3  # rotor inertias are of the type
        if k in heavy:
            point = ci.InertialParameters.from_central(
                0.2, (0.05, 0.0, 0.05), 1e-4 * np.eye(3)
            )
            x[60:70] += point.vector
        own = folder / f"robot{k:05}"
        own.mkdir()
        text = streaming.PROBLEM.replace("20.0", "100.0")  # keeps friction's jumps
        text = text.replace('"arm"', f'"{own.name}"', 1)
        text += f"rows = [{_ENDS}, {samples - _ENDS}]\n"
        (own / "problem.toml").write_text(text)
        phase = rng.uniform(0, 6, 7)
        with pq.ParquetWriter(own / "log.parquet", _schema(model)) as writer:
            for first in range(0, samples, _PIECE):
                time = np.arange(first, min(first + _PIECE, samples)) / 1000.0
                angle = np.outer(time, rates) + phase
                q, dq = np.sin(angle), rates * np.cos(angle)
                torque = model.predict(x, q, dq, -(rates**2) * q)
                torque += rng.normal(scale=0.5, size=torque.shape)
                values = [
                    time,
                    *(c for pair in zip(q.T, torque.T, strict=True) for c in pair),
                ]
                writer.write_table(pa.table(values, schema=_schema(model)))
    return [f"robot{k:05}" for k in sorted(heavy)]


def _schema(model: ci.TorqueModel) -> pa.Schema:
    joints = model.robot.joint_names
    names = ["time", *(f"{c}_{j}" for j in joints for c in ("q", "tau"))]
    return pa.schema([(name, pa.float64()) for name in names])


def measured(folder: Path, executor: str) -> dict[str, object]:
    """Identify the fleet of a folder; return time, memory and who was named."""
    wall, cpu = perf_counter(), process_time()
    files = sorted(folder.glob("*/problem.toml"))
    problems = [ci.load_problem(file) for file in files]
    fleet = ci.fleet.identify_fleet(problems, executor=executor)
    taken = perf_counter() - wall, process_time() - cpu
    bodies = fleet.bodies
    exact = bodies.base.projection @ np.append(truth(arm())[:70], np.full(7, 0.3))
    error = np.linalg.norm(bodies.base_values - exact) / np.linalg.norm(exact)
    return {
        "wall": taken[0],
        "cpu": taken[1],
        "memory": peak(),
        "outliers": list(fleet.outliers),
        "spread": fleet.spread,
        "error": float(error),
        "verdict": bodies.verdict.word,
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--robots", type=int, nargs="+", default=(10, 30, 100))
    options.add_argument("--samples", type=int, nargs="+", default=[10_000])
    options.add_argument("--write", type=Path, help="page with the tables")
    options.add_argument("--executor", default="serial")
    options.add_argument("--executors", nargs="+", metavar="WHERE", help="compare them")
    options.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.measure is not None:
        print(json.dumps(measured(given.measure, given.executor)))
        return
    if given.executors:
        with written_to(given.write, "executors"):
            _compare(max(given.robots), given.samples[0], given.executors)
        return
    with written_to(given.write, "fleet"):
        for samples in given.samples:
            _measure(given.robots, samples, given.executor)


def _compare(robots: int, samples: int, executors: Sequence[str]) -> None:
    """Print what a fleet costs with each executor, its processes together."""
    print(f"\n{robots} robots, {samples} samples each:\n")
    print("| executor | CPU of all processes [s] | over the first | wall [s] |")
    print("|---|---:|---:|---:|")
    first = 0.0
    with tempfile.TemporaryDirectory() as name:
        write(Path(name), robots, samples)
        for executor in executors:
            before = _of_children()
            row = _identified(name, executor)
            cpu = _of_children() - before
            first = first or cpu
            print(f"| {executor} | {cpu:.1f} | {cpu / first:.2f} | {row['wall']:.1f} |")


def _of_children() -> float:
    """Return the processor seconds, user and system, of processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _identified(folder: str, executor: str) -> dict[str, Any]:
    """Identify a fleet in a process of its own."""
    command = [sys.executable, __file__, "--measure", folder, "--executor", executor]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _measure(fleets: Sequence[int], samples: int, executor: str) -> None:
    """Print the table of fleets whose robots have so many samples each."""
    print(f"\n{samples} samples each, executor {executor}:\n")
    print("| robots | CPU [s] | memory [MB] | error of the bodies | outliers |")
    print("|---:|---:|---:|---:|---|")
    found = []
    for robots in fleets:
        with tempfile.TemporaryDirectory() as name:
            heavy = write(Path(name), robots, samples)
            row = _identified(name, executor)
        named = set(row["outliers"])
        missed, false = len({*heavy} - named), len(named - {*heavy})
        print(
            f"| {robots} | {row['cpu']:.1f} | {row['memory']:.0f} "
            f"| {row['error']:.1e} | {len(named)} named, {missed} missed, "
            f"{false} false |",
            flush=True,
        )
        found.append((robots, row["cpu"], row["memory"]))
    if len(found) > 1:
        _project(np.array(found))


def _project(found: np.ndarray) -> None:
    """Print how cost grows between the two largest fleets, and what many cost."""
    print()
    for what, column, unit in (("CPU", 1, "s"), ("memory", 2, "MB")):
        n, cost = found[:, 0], found[:, column]
        exponent = np.log(cost[-1] / cost[-2]) / np.log(n[-1] / n[-2])
        each, fixed = np.polyfit(n, cost, 1)
        print(
            f"{what}: robots^{exponent:.2f}, {fixed:.3g} + {each:.3g} {unit} for each; "
            f"{_MANY} robots would take {fixed + each * _MANY:.0f} {unit}.\n"
        )


if __name__ == "__main__":
    main()
