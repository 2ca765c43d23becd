"""Closed-loop replay of motion that was not learnt from, on real PD-controlled robots.

``python benchmarks/rollout.py [PROBLEM ...] [--backwards] [--ridges] [--keep]``

By default ``problems/unitree_go2`` and ``problems/unitree_z1``; recordings are found
through ``CONSISTENT_ID_DATASETS``.  Settings are chosen on the training logs
(``--keep``: the problem file's are kept), then come the torque fit, its refinement, and
rollouts of the validation logs by both and by the robot's file as it is shipped.
``--backwards`` learns from the validation logs and judges on the training logs.
``--ridges`` prints what the weight of the torque fit in the refinement does to rollouts
of the part of the training logs that was not learnt from; `RIDGE` was chosen so.
Seconds are those of the processor.
"""

import argparse
import os
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from time import process_time

import msgspec
import numpy as np

import consistent_id as ci
from consistent_id.laboratory.rollout import rollout
from consistent_id.laboratory.rollout.refine import RIDGE, refined
from consistent_id.laboratory.rollout.settings import (
    chosen_settings,
    gains_of,
    rollout_error,
    slow_and_fast,
    torque_fit,
    with_settings,
    within,
)
from consistent_id.problems.problem import problem_of

RIDGES = (0.03, 0.1, 0.3, 1.0, 3.0)
PROBLEMS = ("problems/unitree_go2", "problems/unitree_z1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", default=PROBLEMS)
    parser.add_argument("--backwards", action="store_true")
    parser.add_argument("--ridges", action="store_true")
    parser.add_argument("--keep", action="store_true")
    options = parser.parse_args()
    if "CONSISTENT_ID_DATASETS" not in os.environ:
        raise SystemExit("CONSISTENT_ID_DATASETS is not set: no recordings")
    for name in options.problems:
        problem = ci.load_problem(name)
        if options.backwards:
            problem = backwards(problem)
        print(f"== {problem.name}" + (", backwards" if options.backwards else ""))
        if not options.keep:
            started = process_time()
            choice = chosen_settings(problem)
            problem = with_settings(problem, choice.settings)
            print(
                f"{choice.settings}, error {1e3 * choice.error:.2f}, "
                f"{len(choice.tried)} tried in {process_time() - started:.1f} s"
            )
        (ridges if options.ridges else judged)(problem)


def backwards(problem: ci.Problem) -> ci.Problem:
    """Return the problem with training and validation exchanged."""
    change = msgspec.structs.replace
    other = {"training": "validation", "validation": "training"}
    data = problem.table.data
    logs = [change(entry, role=other[entry.role]) for entry in data.recordings]
    table = change(problem.table, data=change(data, recordings=logs))
    return replace(problem_of(table, problem.source), source=problem.source)


def judged(problem: ci.Problem) -> None:
    """Print the errors of the torque fit, of its refinement and of the shipped file."""
    gains, delay = gains_of(problem), problem.delay_of_commands
    training, validation = problem.logs("training"), problem.logs("validation")
    problem.training  # noqa: B018  read and filtered before the clock starts
    started = process_time()
    estimate, regression = torque_fit(problem)
    fitted = process_time()
    better = refined(
        estimate,
        regression,
        training,
        gains,
        constraints=problem.constraints,
        delay=delay,
    )
    done = process_time()
    shipped = [p for p in problem.model_files.values() if p is not None]
    rivals = rollout(
        estimate, validation, gains, against=shipped, training=training, delay=delay
    )
    rows = [
        ("torque fit", rollout_error(problem, estimate, validation), fitted - started),
        (
            "refined by rollout",
            rollout_error(problem, better.estimate, validation),
            done - fitted,
        ),
        *(
            (f"{Path(file).name}, {what}", rivals.rmse(str(file), offsets=given), 0.0)
            for file in shipped
            for what, given in (("as shipped", False), ("with offsets", True))
        ),
    ]
    for what, error, seconds in rows:
        clock = f"{seconds:6.2f} s" if seconds else ""
        print(f"{what:28} {1e3 * error:6.2f} mrad {clock}", flush=True)


def ridges(problem: ci.Problem) -> None:
    """Print the error on the other part of the training logs, for each weight."""
    slow, fast = slow_and_fast(problem)
    logs = problem.logs("training")

    def error(ridge: float | None, learnt: tuple, other: tuple) -> float:
        estimate, regression = torque_fit(problem, within(problem.training, learnt))
        if ridge is not None:
            estimate = refined(
                estimate,
                regression,
                within(logs, learnt),
                gains_of(problem),
                constraints=problem.constraints,
                delay=problem.delay_of_commands,
                ridge=ridge,
            ).estimate
        return rollout_error(problem, estimate, within(logs, other))

    ways = ((slow, fast), (fast, slow))
    for ridge in (None, *RIDGES):
        both = list(starmap(lambda *way, r=ridge: error(r, *way), ways))
        mean = np.sqrt(np.mean(np.square(both)))
        what = "no refinement" if ridge is None else f"ridge {ridge:g}"
        chosen = "  <- used" if ridge == RIDGE else ""
        to_fast, to_slow = (1e3 * value for value in both)
        print(
            f"{what:14} to the faster {to_fast:.2f}, to the slower {to_slow:.2f}, "
            f"both {1e3 * mean:.2f} mrad{chosen}",
            flush=True,
        )


if __name__ == "__main__":
    main()
