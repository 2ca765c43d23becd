"""How often intervals hold the truth of raw logs, with the preparation of drafts.

``python benchmarks/coverage_logs.py [--logs 200] [--write docs/coverage.md]``

Published arms with other bodies than the file's, friction, rotors and offsets move at
random.  A log has positions in encoder steps, and torque with noise; velocities,
cut-offs and drive terms are those of `draft_problem`.  A draft is made for every
twentieth log, and the others are prepared alike; terms of the truth that a draft leaves
out count as errors.
"""

import argparse
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent))
from clean_simulations import arm_file, drawn_bodies, drawn_motion, part_of, reflected
from coverage_methods import KINDS, noise
from coverage_raw import DRAFTS, encoded
from pages import stamp

import consistent_id as ci

ARMS = ("ur5", "kinova", "xarm7")
SECONDS = (20.0, 5.0)  # of which 7.7 and 3.5 are training
RATES = {"ur5": 200.0, "kinova": 100.0, "xarm7": 250.0}  # Hz
LEVEL = 0.02  # noise over each torque's standard deviation
PERIOD = 10.0  # s, least period of a motion's lowest frequency
BEGIN, END = "<!-- logs: begin -->", "<!-- logs: end -->"


@dataclass(frozen=True)
class Case:
    """An arm that moves, its true parameters, and the size of its torques [N m]."""

    arm: str
    model: ci.TorqueModel
    truth: np.ndarray
    clean: ci.Recording
    size: np.ndarray


def case(arm: str, seconds: float, seed: int = 1) -> Case:
    """Return an arm whose bodies, drives and motion are drawn at random."""
    rng = np.random.default_rng([seed, 91])
    robot = ci.load_robot(arm_file(arm), **part_of(arm))
    time = np.arange(round(RATES[arm] * seconds)) / RATES[arm]
    moving = drawn_motion(robot, rng, max(seconds, PERIOD))
    states = moving.at(robot.joint_names, time)
    bodies, rigid = drawn_bodies(robot, rng, exact=False), ci.TorqueModel(robot)
    size = np.std(ci.simulate_torque(rigid, bodies, states).torque, axis=0)
    size = np.maximum(size, 0.02 * size.max())
    drive = ci.DriveTerms(
        viscous=True,
        coulomb="tanh",
        velocity_scale=0.02,
        offset=True,
        rotor_inertia=True,
    )
    model = ci.TorqueModel(robot, drive)
    values = {
        "viscous": rng.uniform(0.05, 0.25, len(size))
        * size
        / np.std(states.velocity, axis=0),
        "coulomb": rng.uniform(0.05, 0.25, len(size)) * size,
        "offset": 0.03 * size * rng.normal(size=len(size)),
        "rotor_inertia": rng.uniform(0.0, 0.5, len(size))
        * reflected(rigid, bodies, states),
    }
    drives = [values[term][j] for j in range(len(size)) for term in drive.names]
    truth = np.append(bodies, drives)
    return Case(arm, model, truth, ci.simulate_torque(model, truth, states), size)


def logged(of: Case, kind: str, rng: np.random.Generator) -> ci.Recording:
    """Return a raw log: encoders' readings, and torque with noise."""
    clean = of.clean
    torque = clean.torque + LEVEL * of.size * noise(kind, clean.torque.shape, rng)
    read = encoded(clean.position, rng)
    return ci.Recording(clean.joints, clean.time, read, torque=torque)


def prepared(
    of: Case, kind: str, logs: int
) -> Iterator[tuple[ci.Problem, ci.Recording]]:
    """Yield drafted problems, each with the training rows of a log."""
    rng = np.random.default_rng(5)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(logs):
            log = logged(of, kind, rng)
            if k % DRAFTS == 0:
                draft = ci.draft_problem(arm_file(of.arm), log, **part_of(of.arm))
                problem = draft.problem(Path(folder))
                rows = slice(*draft.training)
            yield problem, problem.prepare(log.samples(rows))


def errors(of: Case, kind: str, logs: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield errors of base and of standard parameters, over half 95 % intervals.

    Base parameters are those of weighted least squares, standard ones those of the
    weighted constrained estimate that have a standard error.
    """
    true = dict(zip(of.model.layout.names, of.truth, strict=True))
    for problem, log in prepared(of, kind, logs):
        model = problem.model
        base = ci.regression.base_parameters(model)
        truth = np.array([true.get(name, 0.0) for name in model.layout.names])
        regression = ci.build_regression(model, log)
        free = ci.estimation.weighted_least_squares(model, regression, base=base)
        bound = ci.constrained_least_squares(
            model,
            regression.weighted(free.sigma),
            constraints=problem.constraints,
            prior=problem.prior,
            base=base,
        )
        known = np.isfinite(bound.half_intervals) & (bound.half_intervals > 0.0)
        yield (
            (free.base_values - base.projection @ truth) / free.base_half_intervals,
            ((bound.parameters - truth) / bound.half_intervals)[known],
        )


def table(logs: int, arms: Sequence[str] = ARMS) -> str:
    """Measure the table; its rows are printed as they are found."""
    lines = [
        f"`python benchmarks/coverage_logs.py`{stamp()}, {logs} logs for each row:",
        "",
        "| arm | length | noise | least squares | constrained |",
        "|---|--:|---|--:|--:|",
    ]
    print(*lines, sep="\n", flush=True)
    for arm in arms:
        for seconds in SECONDS:
            of = case(arm, seconds)
            for kind in KINDS:
                found = zip(*errors(of, kind, logs), strict=True)
                cells = (f"{s:.1%} ± {e:.1%}" for s, e in map(_held, found))
                lines.append(
                    f"| {arm} | {seconds:g} s | {kind} | {' | '.join(cells)} |"
                )
                print(lines[-1], flush=True)
    return "\n".join(lines)


def _held(errors: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the share of errors inside 95 % intervals, and its error."""
    # Drafts differ in their parameters: a log counts as much as another.
    inside = np.array([np.mean(abs(own) <= 1.0) for own in errors])
    return float(inside.mean()), float(inside.std(ddof=1) / np.sqrt(len(inside)))


def missed(page: str) -> list[str]:
    """Return the rows of the table whose least squares are not within 93 to 97 %."""
    row = re.compile(r"\| (\w+) \| (\d+ s) \| ([^|]+) \| ([\d.]+)% ± ([\d.]+)% \|")
    return [
        f"raw logs, {arm}, {seconds}, {kind}: {share} ± {error} %, target 93 to 97 %"
        for arm, seconds, kind, share, error in row.findall(page)
        if not 93.0 <= float(share) <= 97.0
    ]


def section(logs: int) -> str:
    """Measure the table, between the marks at which it is replaced."""
    return f"{BEGIN}\n\n{table(logs)}\n\n{END}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--arms", nargs="+", default=ARMS)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    with threadpool_limits(1):
        lines = table(options.logs, options.arms)
    if options.write:
        before, _, rest = options.write.read_text().partition(BEGIN)
        _, _, after = rest.partition(END)
        options.write.write_text(f"{before}{BEGIN}\n\n{lines}\n\n{END}{after}")


if __name__ == "__main__":
    main()
