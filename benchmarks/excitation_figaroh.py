"""FIGAROH's optimiser of trajectories, in an environment of its own, judged as others.

It searches for waypoints of splines that rest at each, in the form, limits and time of
the other methods; see ``peers/trajectory.py``.  Every path it looks at counts, whether
it would return it or not, after the same scaling into the limits and at the same
samples.
"""

import os
import subprocess
import tempfile
from pathlib import Path

import excitation_cases as cases
import numpy as np
from excitation_cases import EXAMPLES, Case
from excitation_designs import PROCESSES
from excitation_rivals import Trace, merged

import consistent_id as ci

NAME = "FIGAROH 1.0.2"
URDF = EXAMPLES / "ur_description/urdf/ur10_robot.urdf"
SCRIPT = Path(__file__).parent / "peers" / "trajectory.py"
EVERY = 10  # of its samples at 100 Hz, one is judged: those of the other methods


def trace(python: str, case: Case, seconds: float) -> Trace:
    """Run it for a time in processes of a Python that has it, and judge its paths."""
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name:
        files = [Path(name) / f"{seed}.npz" for seed in range(PROCESSES)]
        running = [
            subprocess.Popen(
                [python, SCRIPT, URDF, EXAMPLES.parents[1], str(seconds), str(seed), f],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                env=os.environ | threads,
            )
            for seed, f in enumerate(files)
        ]
        for process in running:
            _, said = process.communicate()
            if process.returncode:
                raise RuntimeError(f"{python} {SCRIPT} failed: {said[-500:]}")
        return merged(NAME, [_judged(case, np.load(file)) for file in files])


def _judged(case: Case, found: np.lib.npyio.NpzFile) -> list[tuple[float, float]]:
    return [
        (float(spent), _condition(case, motion))
        for spent, motion in zip(found["spent"], found["motion"], strict=True)
    ]


def _condition(case: Case, motion: np.ndarray) -> float:
    """Return the condition number of a path's joints moved less, as far as needed."""
    limits = case.limits
    middle, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
    moved = motion - np.array([middle, 0 * middle, 0 * middle])[:, None]
    shares = abs(moved[:2]).max(axis=1) / np.array([half, limits.velocity])
    moved = moved / np.maximum(1.0, shares.max(axis=0))
    q, dq, ddq = moved[:, :-1:EVERY]
    time = case.form.duration * np.arange(len(q)) / len(q)
    names = case.model.robot.joint_names
    log = ci.Recording(names, time, q + middle, dq, ddq)
    return cases.condition_of_samples(case, log)
