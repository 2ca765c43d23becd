"""Ten robots whose torque limits are active: designs beside random paths and rivals.

``python benchmarks/excitation_torque.py [ROBOT ...] [--seconds 20] [--write PAGE]
[--figaroh PEERS/bin/python]``

Each robot of `example-robot-data` has the position and speed limits of its file, 90 %
of them, and torque limits that bind: of each joint, at most half the peak that random
paths without torque limits reach in the median, but enough to hold the robot.  Rigid
bodies, friction, offset and rotor inertia are to be identified from 10 s, from rest to
rest.

The design has `--seconds` seconds of one processor, in which it chooses the number of
harmonics, searches and proves its path.  CMA-ES and SLSQP then have as many seconds
each, with the same harmonics, samples and limits; torque beyond its limit is a penalty,
and only paths that keep all limits count.  So do the best of 200 random paths that are
within all limits.  FIGAROH, which needs a Python of its own (``peers/README.md``), has
the same seconds for its splines through waypoints, with its own columns of drives and
under the same torque limits; its paths are moved less until they keep all limits.
Numbers are values of the D criterion, the geometric mean of the standard errors, over
that of the design.
"""

import argparse
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import excitation_figaroh as figaroh
import numpy as np
from excitation_cases import EXAMPLES
from scipy.optimize import minimize

import consistent_id as ci
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.path_search import random_candidate
from consistent_id.excitation.search_problem import SearchProblem, search_problem
from consistent_id.excitation.verification import demands
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.base import base_parameters

ROBOTS: dict[str, tuple[str, str | None]] = {
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "UR3": ("ur_description/urdf/ur3_robot.urdf", None),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", None),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", None),
    "Kinova j2s6s200": ("kinova_description/robots/kinova.urdf", "j2s6s200_link_6"),
    "Z1": ("z1_description/urdf/z1.urdf", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", None),
    "SO-101": ("so_arm_description/urdf/so101.urdf", None),
    "Talos' arm": ("talos_data/robots/talos_left_arm.urdf", "arm_left_7_link"),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", "arm_7_link"),
}
"""File and last link."""

DRIVE = ci.DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True, rotor_inertia=True
)
SHARE = 0.9  # of all limits
BINDING = 0.5  # of the median peak of random paths
HELD = 1.3  # times what holds the robot in random poses, at least
IDLE = 1e-3  # of the file's limit, below which a torque is none
DRAWN = 200
WORK = 0.6  # of the time; the rest is for drawing paths, compiling and proofs
PENALTY = 10.0  # for each share of a limit that torque is beyond it


class Problem(NamedTuple):
    """A robot's torque model and limits that bind."""

    model: ci.TorqueModel
    limits: MotionLimits


def binding(file: str | Path, tip: str | None) -> Problem:
    """Return a robot with torque limits below what random paths need."""
    robot = ci.robot.load_urdf(EXAMPLES / file, tip=tip)
    model = ci.TorqueModel(robot, DRIVE)
    free = ci.motion_limits(robot, effort=np.inf).within(SHARE)
    problem = searched(model, free, ci.PathForm(10.0, 8))
    x = np.zeros(len(model.layout))
    x[: len(robot.nominal)] = robot.nominal
    peaks, held = [], []
    for number in range(20):
        motion = problem.basis.motion(problem.random(number), problem.grid)
        peaks.append(abs(model.predict(x, *motion)).max(axis=0))
        held.append(abs(model.predict(x, motion[0], 0 * motion[0], 0 * motion[0])))
    least = HELD * np.quantile(np.concatenate(held), 0.9, axis=0)
    effort = np.maximum(BINDING * np.median(peaks, axis=0), least)
    stated = np.array([joint.limits.effort for joint in robot.driven])
    stated = np.where(stated > 0.0, stated, np.inf)
    # the nominal inertia about a last joint may be zero, or nearly so
    idle = effort < IDLE * np.where(np.isfinite(stated), stated, 0.0)
    effort = np.where(idle, stated, effort)
    # 30 % of the limits are left for friction
    limits = ci.motion_limits(robot, effort=np.minimum(effort / 0.63, stated))
    return Problem(model, limits.within(SHARE))


def searched(
    model: ci.TorqueModel, limits: MotionLimits, form: ci.PathForm
) -> SearchProblem:
    """Return the search of a form, under all limits."""
    required = demands(model, limits)
    aim = Aim(noise=(0.005 * np.where(np.isfinite(limits.effort), limits.effort, 1.0)))
    base = base_parameters(model)
    problem = search_problem(model, base, form, aim, required.limits)
    return problem.guarded(required.guards)


class Judge:
    """Measures candidates within a time of the processor; keeps the best clear one."""

    def __init__(self, problem: SearchProblem, seconds: float) -> None:
        self.problem, self.best = problem, np.inf
        self.until = clock.process_time() + seconds

    def __call__(self, x: np.ndarray) -> float:
        """Return the score of a path within the linear limits, with its penalty."""
        if clock.process_time() > self.until:
            raise TimeoutError
        problem = self.problem
        variables = problem.limits.within(x.reshape(problem.shape))
        beyond = max(m.max() for m in problem.measures(variables))
        score = problem.score("D", variables)
        if beyond <= 0.0:
            self.best = min(self.best, score)
        return score + PENALTY * max(beyond, 0.0)


def strategy(judge: Judge) -> None:
    """Run CMA-ES from one random path after another."""
    import cma

    for seed in range(10**6):
        start = judge.problem.random(seed).ravel()
        cma.fmin2(judge, start, 0.3, {"verbose": -9, "verb_log": 0, "seed": seed + 1})


def slsqp(judge: Judge) -> None:
    """Run SciPy's SLSQP with finite differences from one random path after another."""
    A = judge.problem.limits.matrix.toarray()
    rows = {
        "type": "ineq",
        "fun": lambda x: np.append(1.0 - A @ x, 1.0 + A @ x),
        "jac": lambda _: np.vstack([-A, A]),
    }
    for seed in range(10**6):
        start = judge.problem.random(seed).ravel()
        minimize(judge, start, method="SLSQP", constraints=rows)


def rival(
    run: Callable[[Judge], None], problem: SearchProblem, seconds: float
) -> float:
    """Return the least score that a method finds in its time."""
    judge = Judge(problem, seconds)
    try:
        run(judge)
    except TimeoutError:
        pass
    return judge.best


def measured(name: str, seconds: float, python: str | None) -> str:
    """Return the row of a robot."""
    model, limits = binding(*ROBOTS[name])
    aim = Aim(noise=(0.005 * limits.effort).tolist())
    work, began = WORK * seconds, clock.process_time()
    design = ci.design_trajectory(
        model, aim=aim, limits=limits, starts=8, workers=1, time_limit=work
    )
    used = clock.process_time() - began
    problem = searched(model, limits, design.form)
    variables = np.asarray(design.stages[-1].candidates[0].variables)
    own = problem.score("D", variables)
    peak = problem.measures(variables)[0].max() + problem.guards[0].reach
    drawn = [random_candidate(problem, number).score for number in range(DRAWN)]
    others = [rival(run, problem, seconds) for run in (strategy, slsqp)]
    if python is not None:
        file = EXAMPLES / ROBOTS[name][0]
        best = figaroh.least_score(python, file, problem, limits, seconds)
        others.append(best)
    times = [np.exp(score - own) for score in (min(drawn), *others)]
    cells = (
        name,
        str(len(model.robot)),
        str(len(design.form.frequencies)),
        f"{design.condition.value:.4g}",
        f"{100.0 * peak:.0f} %",
        *(f"{ratio:.2f}" if np.isfinite(ratio) else "none" for ratio in times),
        *["-"] * (python is None),
        f"{used:.0f}",
    )
    return f"| {' | '.join(cells)} |"


HEADER = (
    "| robot | joints | harmonics | condition number | largest torque, of its limit "
    "| best of 200 random | CMA-ES | SLSQP | FIGAROH | CPU [s] |\n"
    "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--write", type=Path, help="page whose table is replaced")
    parser.add_argument("--figaroh", help="Python of an environment that has it")
    options = parser.parse_args()
    print(HEADER)
    rows = []
    for name in options.robots:
        rows.append(measured(name, options.seconds, options.figaroh))
        print(rows[-1], flush=True)
    if options.write is not None:
        start, end = "<!-- torque limits -->", "<!-- end of torque limits -->"
        text = options.write.read_text()
        head, rest = text.split(start)
        table = "\n".join([HEADER, *rows])
        tail = rest.split(end)[1]
        options.write.write_text(f"{head}{start}\n{table}\n{end}{tail}")


if __name__ == "__main__":
    main()
