"""Closed-loop replay of motion that was not learnt from, on real PD-controlled robots.

``python benchmarks/rollout.py [PROBLEM ...] [OPTION ...] [--write PAGE]``

By default ``problems/unitree_go2`` and ``problems/unitree_z1``; recordings are found
through ``CONSISTENT_ID_DATASETS``.  Settings are chosen on the training logs
(``--keep``: the problem file's are kept), and so is the weight of the torque fit in the
refinement; then come the torque fit, its refinement, and rollouts of the validation
logs by both and by the robot's file as it is shipped.  ``--backwards`` learns from the
validation logs and judges on the training logs.  ``--ridges`` prints what the weight of
the torque fit does to rollouts of the part of the training logs that was not learnt
from.  ``--blocks`` prints the share of parameters of which 95 % intervals from the
other blocks of the training log hold the value from one of them, and those from all of
it the value from blocks of the validation log.  Seconds are those of
the processor.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import process_time

import msgspec
import numpy as np
from pages import add_write, shown_on

import consistent_id as ci
from consistent_id.comparison.speed_trend import joint_speeds, speed_of, speed_trend
from consistent_id.estimation.uncertainties.block_scatter import (
    BLOCKS,
    BlockScatter,
    block_scatter,
)
from consistent_id.problems.loading import problem_of
from consistent_id.regression.segments import merged, segments_of
from consistent_id.rollout import rollout
from consistent_id.rollout.chosen_settings import SettingsChoice, chosen_settings
from consistent_id.rollout.refine import RIDGE, refined
from consistent_id.rollout.refinement_choice import chosen_ridge
from consistent_id.rollout.settings import (
    gains_of,
    rollout_error,
    torque_fit,
    with_settings,
)

PROBLEMS = ("problems/unitree_go2", "problems/unitree_z1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", default=PROBLEMS)
    parser.add_argument("--backwards", action="store_true")
    parser.add_argument("--ridges", action="store_true")
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--blocks", action="store_true")
    add_write(parser)
    options = parser.parse_args()
    if "CONSISTENT_ID_DATASETS" not in os.environ:
        raise SystemExit("CONSISTENT_ID_DATASETS is not set: no recordings")
    used = [n.removeprefix("problems/") for n in options.problems if n in PROBLEMS]
    with shown_on(options.write, used):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print the errors that each problem reaches; what was chosen goes to stderr."""
    rows = []
    for name in options.problems:
        problem = ci.load_problem(name)
        if options.backwards:
            problem = backwards(problem)
        name = problem.name + (", backwards" if options.backwards else "")
        if options.blocks or options.ridges:
            print(f"== {name}")
        if options.blocks:
            blocks(problem)
            continue
        settings, delay, chosen = None, "as stated", 0.0
        if not options.keep:
            started = process_time()
            found = chosen_settings(problem)
            settings = found.settings
            problem = with_settings(problem, settings)
            chosen = process_time() - started
            print(
                f"{name}: {found.settings}, {found.delay}, error "
                f"{1e3 * found.error:.2f}, {len(found.tried)} tried",
                file=sys.stderr,
            )
            delay = delay_text(found)
        if options.ridges:
            ridges(problem)
            continue
        started = process_time()
        choice = chosen_ridge(problem, settings)
        print(
            f"ridge of the refinement: {choice.ridge or 'none: not refined'}, cut-offs "
            f"{choice.cutoffs}",
            file=sys.stderr,
        )
        seconds = f"{chosen:.1f} and {process_time() - started:.1f}"
        if settings is not None and choice.cutoff is not None:
            lowered = replace(settings, cutoff=choice.cutoff)
            problem = with_settings(problem, lowered)
        rows.append([name, *judged(problem, choice.ridge), delay, seconds])
    if rows:
        print(f"| {' | '.join(HEADER)} |\n|---{'|---:' * (len(HEADER) - 1)}|")
    for row in rows:
        print(f"| {' | '.join(row)} |")


HEADER = (
    *("robot", "torque fit", "refined by rollout", "file as shipped"),
    *("shipped, with offsets and delay", "delay [ms], 95 %", "choices, CPU [s]"),
)


def delay_text(found: SettingsChoice) -> str:
    """Return a delay and its interval [ms]."""
    text = f"{1e3 * found.delay.delay:.1f}"
    if found.delay_interval is None:
        return f"{text}, no interval"
    low, high = (1e3 * end for end in found.delay_interval)
    return f"{text} ({low:.1f} to {high:.1f})"


def backwards(problem: ci.Problem) -> ci.Problem:
    """Return the problem with training and validation exchanged."""
    change = msgspec.structs.replace
    other = {"training": "validation", "validation": "training"}
    data = problem.table.data
    logs = [change(entry, role=other[entry.role]) for entry in data.recordings]
    table = change(problem.table, data=change(data, recordings=logs))
    return replace(problem_of(table, problem.source), source=problem.source)


def judged(problem: ci.Problem, ridge: float | None) -> list[str]:
    """Return errors [mrad] of the torque fit, its refinement and the shipped file."""
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
        ridge=ridge or RIDGE,
    )
    done = process_time()
    shipped = [p for p in problem.model_files.values() if p is not None]
    rivals = rollout(
        estimate, validation, gains, against=shipped, training=training, delay=delay
    )
    (file,) = shipped
    fits = ((estimate, fitted - started), (better.estimate, done - fitted))
    return [
        *(
            f"{1e3 * rollout_error(problem, one, validation):.2f} ({seconds:.2f} s)"
            for one, seconds in fits
        ),
        *(f"{1e3 * rivals.rmse(str(file), offsets=o):.2f}" for o in (False, True)),
    ]


def blocks(problem: ci.Problem) -> None:
    """Print how many values from blocks are within intervals from other motion."""
    model = problem.model
    logs = {"training": problem.training, "validation": problem.validation}
    lengths = {role: sum(r.duration for r in log) for role, log in logs.items()}
    seconds = lengths["training"] / BLOCKS
    plain = {
        role: ci.regression.segment_regressions(
            model, log, count=max(round(lengths[role] / seconds), 2)
        )
        for role, log in logs.items()
    }
    sigma = ci.regression.joint_noise(model, merged(plain["training"]))
    parts = {role: [r.weighted(sigma) for r in found] for role, found in plain.items()}

    def scatter(regressions: Sequence[ci.Regression]) -> BlockScatter:
        return block_scatter(model, regressions, constraints=problem.constraints)

    learnt, scale = parts["training"], joint_speeds(problem.training)
    speeds = {
        role: [
            speed_of([piece], scale)
            for piece in segments_of(log, count=len(plain[role]))
        ]
        for role, log in logs.items()
    }
    folds = [(learnt[:i] + learnt[i + 1 :], one) for i, one in enumerate(learnt)]
    for what, pairs in (
        ("training blocks left out", folds),
        ("validation blocks", [(learnt, one) for one in parts["validation"]]),
    ):
        found = [(scatter(rest), scatter([one])) for rest, one in pairs]
        by_noise, with_scatter = (
            np.mean([own.holds(other, between=between) for own, other in found])
            for between in (False, True)
        )
        print(
            f"{len(pairs)} {what}, {seconds:.1f} s each: inside 95 % intervals "
            f"by noise {by_noise:.0%}, "
            f"with the scatter between blocks {with_scatter:.0%}",
            flush=True,
        )
    trends(
        {role: [scatter([one]) for one in found] for role, found in parts.items()},
        speeds,
    )


def trends(
    blocks: Mapping[str, Sequence[BlockScatter]], speeds: Mapping[str, Sequence[float]]
) -> None:
    """Print the same of intervals for the speed of the motion."""
    learnt, fast = blocks["training"], speeds["training"]
    rest = range(len(learnt))
    left_out = [
        speed_trend(
            [learnt[k] for k in rest if k != i], [fast[k] for k in rest if k != i]
        ).holds(learnt[i], fast[i])
        for i in rest
    ]
    trend = speed_trend(learnt, fast)
    judged = [
        trend.holds(block, speed)
        for block, speed in zip(blocks["validation"], speeds["validation"], strict=True)
    ]
    for what, role, held in (
        ("training blocks left out", "training", left_out),
        ("validation blocks", "validation", judged),
    ):
        print(
            f"{what}, {min(speeds[role]):.2f} to {max(speeds[role]):.2f} times the "
            f"training's speed: inside 95 % intervals for their speed "
            f"{np.mean(held):.0%}",
            flush=True,
        )


def ridges(problem: ci.Problem) -> None:
    """Print the error on the other part of the training logs, for each weight."""
    choice = chosen_ridge(problem)
    for ridge, error in choice.errors.items():
        what = "no refinement" if ridge is None else f"ridge {ridge:g}"
        print(f"{what:14} {1e3 * error:.2f} mrad on the other part", flush=True)


if __name__ == "__main__":
    main()
