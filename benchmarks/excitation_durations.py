"""Periods of designed motions: what each conveys in the same time of the robot.

``python benchmarks/excitation_durations.py [ROBOT ...] [--seconds 20] [--seeds 0 1]
[--write PAGE]``, with ``CONSISTENT_ID_DATASETS`` for the UR10e and the TX40.

Robots, limits and parameters are those of ``excitation_torque.py``: 90 % of all limits,
and torque limits that bind.  Each duration has the same work, of which `--seconds`
seconds of one processor are left after drawing paths, compiling and proofs; numbers of
harmonics are tried in it, as by default.

A number is the D criterion, the geometric mean of the standard errors, at equal numbers
of samples: each motion is repeated until the robot has moved for a minute.  It is
relative to that of the ten-second motion of the same robot and seed.  Below 1, the
motion conveys more per second.
"""

import argparse
import os
import time as clock
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from excitation_torque import ROBOTS, WORK, Problem, binding

import consistent_id as ci
from consistent_id.excitation.aims import Aim, forms_to_try

DATA = Path(os.environ.get("CONSISTENT_ID_DATASETS", "datasets")).resolve()
CASES: dict[str, tuple[str | Path, str | None]] = {
    "Panda": ROBOTS["Panda"],
    "UR10e": (DATA / "ur10e/ur10e.urdf", None),
    "TX40": (DATA / "staubli_tx40/tx40.urdf", None),
}
DURATIONS = (10.0, 2.5, 5.0, 7.5, 15.0, 20.0, 30.0)  # s; the first is compared with
MINUTE = 60.0


class Found(NamedTuple):
    """The D criterion after a minute of motion, harmonics, and processor time."""

    error: float
    harmonics: int
    highest: float
    cpu: float


def found(problem: Problem, duration: float, seed: int, seconds: float) -> Found:
    """Design a motion of one duration."""
    model, limits = problem
    aim = Aim(noise=(0.005 * limits.effort).tolist())
    periodic = forms_to_try(limits, duration, rest=False)  # of one period
    began = clock.process_time()
    design = ci.design_trajectory(
        model,
        [replace(form, rest=True) for form in periodic],
        aim,
        limits=limits,
        starts=4,
        workers=1,
        time_limit=WORK * seconds,
        seed=seed,
    )
    cpu = clock.process_time() - began
    error = design.stages[-1].value * np.sqrt(duration / MINUTE)
    frequencies = design.form.frequencies
    return Found(error, len(frequencies), float(frequencies[-1]), cpu)


def rows(name: str, seeds: list[int], seconds: float) -> list[str]:
    """Return the table rows of a robot, one for each duration."""
    problem = binding(*CASES[name])
    every = {}
    for duration in DURATIONS:
        every[duration] = [found(problem, duration, k, seconds) for k in seeds]
        print(name, duration, every[duration], flush=True)
    first = [one.error for one in every[DURATIONS[0]]]
    table = []
    for duration in sorted(every):
        ran = every[duration]
        ratio = [one.error / ten for one, ten in zip(ran, first, strict=True)]
        cells = (
            name,
            f"{duration:g}",
            ", ".join(str(one.harmonics) for one in ran),
            ", ".join(f"{one.highest:.2g}" for one in ran),
            ", ".join(f"{one:.2f}" for one in ratio),
            f"{np.exp(np.mean(np.log(ratio))):.2f}",
            f"{np.mean([one.cpu for one in ran]):.0f}",
        )
        table.append(f"| {' | '.join(cells)} |")
    return table


HEADER = (
    "| robot | duration [s] | harmonics | highest frequency [Hz] "
    "| error after a minute of motion, seed by seed | mean | CPU [s] |\n"
    "|---|---:|---:|---:|---:|---:|---:|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(CASES))
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--write", type=Path, help="page whose table is replaced")
    options = parser.parse_args()
    table = [HEADER]
    for name in options.robots:
        table += rows(name, options.seeds, options.seconds)
    print("\n".join(table))
    if options.write is not None:
        start, end = "<!-- durations -->", "<!-- end of durations -->"
        head, rest = options.write.read_text().split(start)
        tail = rest.split(end)[1]
        text = "\n".join(table)
        options.write.write_text(f"{head}{start}\n{text}\n{end}{tail}")


if __name__ == "__main__":
    main()
