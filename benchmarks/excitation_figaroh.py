"""FIGAROH's optimiser of trajectories, in an environment of its own, judged as others.

It searches for waypoints of splines that rest at each, in the form, limits and time of
the other methods; see ``peers/trajectory.py``.  Every path it looks at counts, whether
it would return it or not, after the same scaling into the limits and at the same
samples.
"""

import os
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import excitation_cases as cases
import numpy as np
from excitation_cases import EXAMPLES, Case
from excitation_designs import PROCESSES
from excitation_rivals import Trace, merged

import consistent_id as ci
from consistent_id.excitation.search_problem import SearchProblem
from consistent_id.motion.limits import MotionLimits

NAME = "FIGAROH 1.0.2"
URDF = EXAMPLES / "ur_description/urdf/ur10_robot.urdf"
SCRIPT = Path(__file__).parent / "peers" / "trajectory.py"
SHARES = 0.95 ** np.arange(60)  # of a path's motion, tried in turn
EVERY = 10  # of its samples at 100 Hz, one is judged: those of the other methods


def trace(python: str, case: Case, seconds: float) -> Trace:
    """Run it for a time in processes of a Python that has it, and judge its paths."""
    found = searched(python, URDF, seconds, PROCESSES)
    return merged(NAME, [_judged(case, one.spent, one.motion) for one in found])


class Searched(NamedTuple):
    """The paths that a process looked at, and the seconds that had passed by then."""

    spent: np.ndarray
    motion: np.ndarray  # shape (paths, 3, samples, joints), 100 Hz


def searched(
    python: str,
    urdf: Path,
    seconds: float,
    processes: int,
    efforts: Sequence[float] = (),
) -> list[Searched]:
    """Run its optimiser in processes, under torque limits if there are any."""
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name:
        files = [Path(name) / f"{seed}.npz" for seed in range(processes)]
        command = [python, SCRIPT, urdf, EXAMPLES.parents[1], str(seconds)]
        running = [
            subprocess.Popen(
                [*command, str(seed), file, *map(str, efforts)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                env=os.environ | threads,
            )
            for seed, file in enumerate(files)
        ]
        for process in running:
            _, said = process.communicate()
            if process.returncode:
                raise RuntimeError(f"{python} {SCRIPT} failed: {said[-500:]}")
        loaded = [np.load(file) for file in files]
        return [Searched(one["spent"], one["motion"]) for one in loaded]


def least_score(
    python: str, urdf: Path, problem: SearchProblem, limits: MotionLimits, time: float
) -> float:
    """Return the least score of its paths that keep all limits, if moved less.

    Parameters
    ----------
    urdf : Path
        Its joints that `limits` do not name are locked, and its continuous joints
        have the limits' ranges: FIGAROH's waypoints are one number for each joint.
    problem : SearchProblem
        Its objective, samples and guards judge the paths.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.urdf"
        file.write_text(_bounded(urdf, limits))
        (found,) = searched(python, file, time, 1, limits.effort.tolist())
    own = zip(found.spent, found.motion, strict=True)
    inside = (_inside(problem, limits, motion) for spent, motion in own if spent < time)
    scores = [_score(problem, motion) for motion in inside if motion is not None]
    return min(scores, default=np.inf)


def _bounded(urdf: Path, limits: MotionLimits) -> str:
    """Return a robot's file in which all joints have a range, or are fixed."""
    tree = ElementTree.parse(urdf)
    ranges = dict(
        zip(limits.joints, zip(limits.lower, limits.upper, strict=True), strict=True)
    )
    for joint in tree.getroot().iter("joint"):
        kind, own = joint.get("type"), ranges.get(joint.get("name", ""))
        if kind != "fixed" and own is None:
            joint.set("type", "fixed")
        elif kind == "continuous" and own is not None:
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", str(own[0]))
            limit.set("upper", str(own[1]))
    return ElementTree.tostring(tree.getroot(), encoding="unicode")


def _inside(
    problem: SearchProblem, limits: MotionLimits, motion: np.ndarray
) -> np.ndarray | None:
    """Return a path moved less about the middle, as far as limits need; None if none.

    As the others, it is judged at every sample by position, speed and acceleration,
    and by torque with the margin of the search's guards.
    """
    middle, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
    centre = np.array([middle, 0 * middle, 0 * middle])[:, None]
    largest = abs(motion - centre).max(axis=1)
    bounds = np.array([half, limits.velocity, limits.acceleration])
    less = np.maximum(1.0, (largest / bounds).max(axis=0))
    for share in SHARES:
        moved = centre + share / less * (motion - centre)
        if all(guard.measure(moved).max() <= 0.0 for guard in problem.guards):
            return moved
    return None


def _score(problem: SearchProblem, motion: np.ndarray) -> float:
    """Return the objective of a motion, from the same number of samples."""
    of = problem.information
    places = np.arange(of.samples) * (motion.shape[1] - 1) // of.samples
    W = of.model.regressor(*motion[:, places])[:, list(of.base.independent)]
    weights = of.recorded / of.samples / of.noise**2
    information = np.einsum("jbs,jcs,j->bc", W, W, weights, optimize=True)
    return problem.criterion(problem.objective)(information + of.earlier).value


def _judged(
    case: Case, spent: np.ndarray, motions: np.ndarray
) -> list[tuple[float, float]]:
    return [
        (float(seconds), _condition(case, motion))
        for seconds, motion in zip(spent, motions, strict=True)
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
