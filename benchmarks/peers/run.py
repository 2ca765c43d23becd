"""Peers and this package on one robot and one log, in one run.

``python benchmarks/peers/run.py --python PEERS/bin/python [--samples 400 2000 20000]
[--write benchmarks/peers/README.md]``
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import cases
from pages import written_to
from speed import arm, truth

import consistent_id as ci
from consistent_id.export.urdf_export import urdf_text


def write(folder: Path, samples: int) -> None:
    """Write the robot, a noisy training motion and a clean held-out one."""
    robot = arm().robot
    model = ci.TorqueModel(robot)
    x = truth(arm())[: len(model.layout)]
    rng = np.random.default_rng(0)
    rates = np.array([1.1, 1.7, 2.3, 2.9, 3.1, 3.7, 4.3])
    for name, count, phase, noise in (
        ("training", samples, 0.0, 0.5),
        ("held_out", 2000, 2.0, 0.0),
    ):
        angle = np.outer(np.arange(count) / 1000.0, rates) + np.arange(7) + phase
        q, dq, ddq = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
        tau = model.predict(x, q, dq, ddq)
        tau += rng.normal(scale=noise, size=tau.shape) if noise else 0.0
        np.savez(folder / f"{name}.npz", q=q, dq=dq, ddq=ddq, tau=tau)
        motion = ci.Recording(robot.joint_names, np.arange(count) / 1000.0, q, dq, ddq)
    recording = ci.simulate_torque(model, x, motion)
    estimate = ci.least_squares(model, ci.build_regression(model, recording))
    text = urdf_text(replace(estimate, parameters=x), "the arm of speed.py")
    # Pinocchio has two numbers for the position of a joint without limits.
    text = text.replace('type="continuous"', 'type="revolute"')
    limit = '<limit lower="-9" upper="9" velocity="99" effort="999"/></joint>'
    (folder / "robot.urdf").write_text(text.replace("</joint>", limit))


def row(name: str, python: str, folder: Path) -> str:
    """Return a row of the table."""
    call = [python, cases.__file__, name, str(folder)]
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        call, capture_output=True, text=True, env=os.environ | threads
    )
    if done.returncode:
        reason = done.stderr.strip().splitlines()[-1]
        return f"| {name} | - | - | - | {reason[:60]} |"
    found = json.loads(done.stdout.strip().splitlines()[-1])
    return (
        f"| {name} | {found['regressor']:.3f} | {found['total']:.3f} "
        f"| {found['memory']:.0f} | {found['error']:.2e} |"
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--python", default=sys.executable)
    options.add_argument("--samples", type=int, nargs="+", default=[400, 2000, 20_000])
    options.add_argument("--write", type=Path, help="page with the tables")
    given = options.parse_args()
    with written_to(given.write, "peers"):
        for samples in given.samples:
            _compare(samples, given.python)


def _compare(samples: int, peers: str) -> None:
    """Print the table of a number of samples."""
    print(f"\n{samples} samples of 7 joints, 70 parameters, noise 0.5 N m:\n")
    print(
        "| way | regressor, CPU [s] | in all, CPU [s] | memory [MB] | held-out error |"
    )
    print("|---|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as name:
        write(Path(name), samples)
        for case, function in cases.CASES.items():
            python = sys.executable if function is cases.ours else peers
            print(row(case, python, Path(name)), flush=True)


if __name__ == "__main__":
    main()
