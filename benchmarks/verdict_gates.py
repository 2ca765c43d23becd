"""What verdicts weigh, of clean simulated logs: where the gates of `judge` come from.

``python benchmarks/verdict_gates.py [--seeds 1 3 5]`` draws clean logs of the five
robots of `faults_robots`, whose torque has friction that default models lack, and
prints of each what the constrained estimate of a drafted problem shows.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from faults import Trial, case_of, written
from faults_robots import robots
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.comparison.consistency_test import consistency_test
from consistent_id.problems.study import Study

COLUMNS = "misfit excess slope_low slope_high correl spare guessed chi2 p"


def figures(robot: str, seed: int) -> list[float]:
    """Return the figures of one log."""
    case = case_of(Trial(robot, "clean", seed))
    with tempfile.TemporaryDirectory() as folder:
        model, log = written(case, Path(folder))
        study = Study(ci.draft_problem(model, log).problem())
        estimate = study.constrained
        test = consistency_test(study.problem.model, study.regression, base=study.base)
    fit = estimate.fit
    if fit is None:
        raise ci.ProblemError("the constrained estimate has no fit")
    slopes = fit.slopes[fit.explained > 0.3]
    return [
        fit.misfit,
        fit.excess,
        slopes.min(initial=np.inf),
        slopes.max(initial=-np.inf),
        fit.correlation,
        fit.spare,
        fit.guessed,
        test.increase,
        test.p_value,
    ]


def lines(seeds: list[int], only: list[str]) -> Iterator[str]:
    """Yield a line for each log."""
    yield f"{'robot':14s} seed " + " ".join(f"{c:>10s}" for c in COLUMNS.split())
    for robot in only:
        for seed in seeds:
            shown = " ".join(f"{value:10.4g}" for value in figures(robot, seed))
            yield f"{robot:14s} {seed:4d} {shown}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 3, 5])
    parser.add_argument("--robots", nargs="+", default=list(robots()))
    options = parser.parse_args()
    with threadpool_limits(1):
        for line in lines(options.seeds, options.robots):
            print(line, flush=True)


if __name__ == "__main__":
    main()
