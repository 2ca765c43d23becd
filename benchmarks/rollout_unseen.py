"""Closed-loop replay of robots that nothing was tuned to, with true motion of MuJoCo.

``python benchmarks/rollout_unseen.py [--seeds A-B] [--write docs/rollout.md]``: a seed
is a robot of example-robot-data under PD drives, with rotors, a delay of commands,
encoders, and friction that is plain or depends on speed or load; the simulation is that
of `rollout_delays`, bodies are the file's.  A problem is drafted of its log, and what
``init`` and ``rollout`` do without options predicts the last part of the log, whose
motion is faster.  Beside it are the torque fit, and the robot's file with the drives'
gains and fitted offsets.  Seconds are those of the processor, for `rollout`.
"""

import argparse
import tempfile
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import pandas as pd
from pages import written_to
from repair import EXAMPLES
from rollout_delays import DELAYS, FRICTIONS, Case, Robot, simulated
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.problems.study import Study
from consistent_id.recordings.signals import PDGains
from consistent_id.rollout.problem_rollout import ProblemRollout, rollout_of
from consistent_id.rollout.settings import rollout_error, torque_fit

ROBOTS = {
    "Solo 12": Robot(
        "solo_description/robots/solo12.urdf", "base_link", 6.0, 0.15, 0.06, 0.002
    ),
    "UR5": Robot("ur_description/urdf/ur5_robot.urdf", None, 900.0, 40.0, 4.0, 0.5),
    "Kinova": Robot(
        "kinova_description/robots/kinova.urdf", None, 150.0, 8.0, 1.0, 0.1
    ),
    "UR10": Robot("ur_description/urdf/ur10_robot.urdf", None, 900.0, 40.0, 4.0, 0.5),
    "SO-101": Robot("so_arm_description/urdf/so101.urdf", None, 15.0, 0.6, 0.05, 0.01),
}
"""None of them is among the robots with recordings, nor of `rollout_delays`."""


class Replayed(NamedTuple):
    """Errors of positions on motion that was not learnt from, [rad].

    Parameters
    ----------
    file, fit, delivered : float
        Of the robot's file with offsets, of the torque fit, of the delivered estimate.
    held, drives : int
        Viscous and Coulomb friction and rotors: true ones in delivered 95 % intervals,
        and all that have one.
    """

    robot: str
    friction: str
    true_delay: float  # s
    delay: float  # s
    interval: tuple[float, float] | None  # s, 95 %
    file: float
    fit: float
    delivered: float
    held: int
    drives: int
    seconds: float

    @property
    def row(self) -> str:
        """The row of a table."""
        errors = (self.file, self.fit, self.delivered)
        ends = "unknown"
        if self.interval is not None:
            ends = " to ".join(f"{1e3 * end:.1f}" for end in self.interval)
        return " | ".join(
            [
                f"| {self.robot}",
                self.friction,
                f"{1e3 * self.true_delay:.0f}",
                f"{1e3 * self.delay:.1f} ({ends})",
                *(f"{1e3 * error:.2f}" for error in errors),
                f"{self.held} of {self.drives}",
                f"{self.seconds:.1f} s |",
            ]
        )


def case_of(seed: int) -> Case:
    """Return a seed's case: the robots in turn."""
    name = list(ROBOTS)[seed % len(ROBOTS)]
    return Case(
        name,
        FRICTIONS[seed % len(FRICTIONS)],
        DELAYS[seed % len(DELAYS)],
        np.random.default_rng(seed),
    )


def replayed(seed: int, folder: Path) -> Replayed:
    """Simulate a log, and let the default path predict the part it does not see."""
    case = case_of(seed)
    robot = ROBOTS[case.robot]
    log, drives = simulated(case, robot)
    table = {"time": log.time}
    for j, name in enumerate(log.joints):
        table[f"q_{name}"] = log.position[:, j]
        table[f"qdes_{name}"] = log.position_command[:, j]
    pd.DataFrame(table).to_parquet(folder / "log.parquet")
    stated = {} if robot.base is None else {"base": robot.base}
    file, gains = EXAMPLES / robot.file, PDGains(robot.kp, robot.kd)
    draft = ci.draft_problem(file, folder / "log.parquet", gains=gains, **stated)
    started = process_time()
    done = rollout_of(
        Study(draft.problem(folder)), against=[file], refine=True, choose=True
    )
    seconds = process_time() - started
    return Replayed(
        case.robot,
        case.friction,
        case.delay,
        0.0 if done.settings is None else done.settings.settings.delay,
        None if done.settings is None else done.settings.delay_interval,
        done.rollout.rmse(str(file), offsets=True),
        _of_fit(done),
        _of(done),
        *_held(done, _comparable(drives, case.friction)),
        seconds,
    )


def _comparable(drives: dict[str, float], friction: str) -> dict[str, float]:
    """Return the drives that a model without friction by load has as well.

    Its Coulomb friction contains the mean of that by load.
    """
    alike = friction != "load"
    return {n: x for n, x in drives.items() if alike or not n.endswith(".coulomb")}


def _held(done: ProblemRollout, drives: dict[str, float]) -> tuple[int, int]:
    """Return how many true values intervals hold, and the number of intervals."""
    own, layout = done.estimate, done.estimate.model.layout
    half = own.half_intervals
    known = {name: value for name, value in drives.items() if name in layout.names}
    if half is None or not known:
        return 0, 0
    places, true = [layout.index(name) for name in known], list(known.values())
    away = abs(own.parameters[places] - true)
    return int((away <= half[places]).sum()), int(np.isfinite(half[places]).sum())


def _of(done: ProblemRollout) -> float:
    return rollout_error(done.problem, done.estimate, done.problem.logs("validation"))


def _of_fit(done: ProblemRollout) -> float:
    fit, _ = torque_fit(done.problem)
    return rollout_error(done.problem, fit, done.problem.logs("validation"))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", default="0-9")
    parser.add_argument("--write", type=Path, help="page whose part is renewed")
    options = parser.parse_args()
    first, last = (int(seed) for seed in options.seeds.split("-"))
    found = []
    with written_to(options.write, "unseen"), threadpool_limits(1):
        print(
            "| robot | friction | delay [ms] | found (95 %) | file, with offsets | "
            "torque fit | delivered | drives held | `rollout` |"
        )
        print("|---|---|---:|---|---:|---:|---:|---:|---:|")
        for seed in range(first, last + 1):
            with tempfile.TemporaryDirectory() as folder:
                found.append(replayed(seed, Path(folder)))
            print(found[-1].row, flush=True)
        middle = np.median([one.delivered for one in found])
        print(f"\nThe median of the delivered ones is {1e3 * middle:.2f} mrad.")
        for friction in FRICTIONS:
            own = [one for one in found if one.friction == friction]
            held, drives = sum(o.held for o in own), sum(o.drives for o in own)
            print(f"Intervals of drives, {friction}: {held} of {drives} hold.")


if __name__ == "__main__":
    main()
