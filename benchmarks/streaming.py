"""Memory and time of regressions of logs that are larger than memory, by their length.

``python benchmarks/streaming.py [--samples 10000 ... 30000000] [--executor serial]``

A Parquet file of a 7-joint arm's positions and torques at 1 kHz is written for each
length, and streamed in a process of its own: filtered at 20 Hz, differentiated,
compressed.  The largest memory that the process ever had is that of the system's count
(ru_maxrss), its workers' besides.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from speed import arm, truth

import consistent_id as ci

_PIECE = 2**17  # samples written at a time
_GROUPS = 2**20  # rows of a row group
_LENGTHS = (10_000, 100_000, 1_000_000, 3_000_000)
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


def write(file: Path, samples: int) -> None:
    """Write a log of an arm, a piece at a time."""
    model = arm()
    parameters = truth(model)
    rate = np.array([1.1, 1.7, 2.3, 2.9, 3.1, 3.7, 4.3])
    joints = model.robot.joint_names
    rng, writer = np.random.default_rng(0), None
    for first in range(0, samples, _PIECE):
        time = np.arange(first, min(first + _PIECE, samples)) / 1000.0
        angle = np.outer(time, rate) + np.arange(7)
        q, dq, ddq = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
        torque = model.predict(parameters, q, dq, ddq)
        torque += rng.normal(scale=0.5, size=torque.shape)
        columns = {"time": time}
        for k, joint in enumerate(joints):
            columns |= {f"q_{joint}": q[:, k], f"tau_{joint}": torque[:, k]}
        table = pa.table(columns)
        writer = writer or pq.ParquetWriter(file, table.schema)
        writer.write_table(table, row_group_size=_GROUPS)
    if writer is not None:
        writer.close()


def measured(folder: Path, executor: str) -> dict[str, float]:
    """Stream a problem's log; return time and memory of this process."""
    problem = ci.load_problem(folder / "problem.toml")
    wall, cpu = perf_counter(), process_time()
    regression = ci.stream_regression(problem, executor=executor)
    taken = perf_counter() - wall, process_time() - cpu
    estimate = ci.least_squares(problem.model, regression)
    exact = estimate.base.projection @ truth(arm())
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    workers = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return {
        "samples": regression.counts[0],
        "wall": taken[0],
        "cpu": taken[1],
        "memory": memory / 1024,
        "workers": workers / 1024,
        "error": float(
            np.linalg.norm(estimate.base_values - exact) / np.linalg.norm(exact)
        ),
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--samples", type=int, nargs="+", default=_LENGTHS)
    options.add_argument("--executor", default="serial")
    options.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.measure is not None:
        print(json.dumps(measured(given.measure, given.executor)))
        return
    print(f"7 joints, executor {given.executor}")
    print("samples    file [MB]  peak memory [MB]  wall [s]  CPU [us/sample]  error")
    for samples in given.samples:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "problem.toml").write_text(PROBLEM)
            write(folder / "log.parquet", samples)
            size = (folder / "log.parquet").stat().st_size / 1e6
            command = [sys.executable, __file__, "--measure", name]
            done = subprocess.run(
                [*command, "--executor", given.executor],
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            )
            row = json.loads(done.stdout)
        print(
            f"{samples:<10} {size:9.0f}  {row['memory']:16.0f}  {row['wall']:8.1f}  "
            f"{row['cpu'] / samples * 1e6:15.2f}  {row['error']:.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
