"""What one objective with its gradient costs."""

import time as clock
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from excitation_cases import EXAMPLES, FINGERS, Case, example, problem_of

import consistent_id as ci
from consistent_id.excitation.aims import PathForm
from consistent_id.motion.limits import motion_limits

POWER = 8.0
HEADER = (
    "| joints | base parameters | variables | samples | objective and gradient [ms] "
    "| objective [ms] | the same by finite differences | times |\n"
    "|---:|---:|---:|---:|---:|---:|---:|---:|"
)


def rows(repetitions: int) -> Iterator[str]:
    """Yield lines of the table: joints, then samples, then harmonics."""
    for joints in (2, 3, 4, 5, 6, 7):
        yield _row(_panda(joints), 100, repetitions)
    for samples in (200, 400, 800):
        yield _row(example("UR10"), samples, repetitions)
    for harmonics in (3, 5, 10, 20):
        case = replace(example("UR10"), form=PathForm(10.0, harmonics))
        yield _row(case, 200, repetitions)


def _panda(joints: int) -> Case:
    """Return the Panda, its last joints locked."""
    file = EXAMPLES / "panda_description/urdf/panda.urdf"
    held = {f"panda_joint{k}": 0.0 for k in range(joints + 1, 8)}
    held = {name: (-1.5 if name == "panda_joint4" else 0.0) for name in held}
    robot = ci.robot.load_urdf(file, locked=FINGERS | held)
    limits = motion_limits(robot, effort=np.inf)
    return Case(f"Panda, {joints}", ci.TorqueModel(robot), limits, PathForm(10.0, 5))


def _row(case: Case, samples: int, repetitions: int) -> str:
    problem = problem_of(case)
    information = replace(problem.information, samples=samples)
    problem = replace(problem, information=information)
    criterion = problem.criterion("condition", POWER)
    points = [problem.random(seed) for seed in range(repetitions)]
    size = points[0].size
    both = _fastest(lambda x: problem.value(criterion, x), points)
    alone = _fastest(lambda x: criterion(problem.information(x).matrix), points)
    by_difference = (size + 1) * alone
    return (
        f"| {len(case.model.robot)} | {len(information.base)} | {size} | {samples} "
        f"| {1e3 * both:.2f} | {1e3 * alone:.2f} | {1e3 * by_difference:.0f} "
        f"| {by_difference / both:.0f} |"
    )


def _fastest(function: Callable[[np.ndarray], object], points: list) -> float:
    """Return the least time of several points: what a machine at rest would take."""
    times = []
    for point in points:
        began = clock.perf_counter()
        function(point + 0.0)
        times.append(clock.perf_counter() - began)
    return min(times)
