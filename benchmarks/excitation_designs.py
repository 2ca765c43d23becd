"""Designs against recorded motions, writing tasks and other people's targets."""

import os
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import excitation_cases as cases
import numpy as np
from excitation_cases import RATE, Case

from consistent_id.excitation.aims import Aim
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.recordings.joint_paths import FourierTrajectory

PROCESSES = 2
SCALINGS = ("none", "unit columns")
MANY = 10_000  # starts, of which time decides how many are made
CALM = 0.5  # processors that others may keep busy when a timed part begins


@dataclass(frozen=True)
class Effort:
    """How much of everything a run does."""

    seconds: float  # of a search
    short: float  # of the RX-60's
    minutes: float  # of the long one
    seeds: int
    repetitions: int  # of what is timed by the millisecond
    durations: tuple[float, ...]
    methods: tuple[str, ...]
    patience: float  # s, for which a calm moment is waited for
    figaroh: str | None = None  # the Python that has it


def busy(seconds: float = 0.5) -> float:
    """Return how many processors are at work at the moment, on whatever."""
    before = _ticks()
    clock.sleep(seconds)
    idle, total = (b - a for a, b in zip(before, _ticks(), strict=True))
    return (1.0 - idle / max(total, 1)) * (os.cpu_count() or 1)


def _ticks() -> tuple[int, int]:
    file = Path("/proc/stat")
    if not file.exists():
        return 1, 1
    ticks = [int(n) for n in file.read_text().splitlines()[0].split()[1:]]
    return ticks[3] + ticks[4], sum(ticks)


def calm(patience: float) -> float:
    """Wait for a moment when others leave the processors alone; return what is busy."""
    until = clock.monotonic() + patience
    while (now := busy()) > CALM and clock.monotonic() < until:
        clock.sleep(1.0)
    return now


@dataclass(frozen=True)
class Timed:
    """A design, and how busy the machine was when it began."""

    design: ExcitationDesign
    busy: float

    @property
    def condition(self) -> float:
        """Condition number of the first stage."""
        return self.design.stages[0].accuracy.condition.value

    def __str__(self) -> str:
        return (
            f"{self.condition:.4g} | {self.design.starts} | {self.design.seconds:.1f} "
            f"| {self.busy:.1f}"
        )


def designed(
    case: Case, seconds: float, effort: Effort, scaling: str = "none", **aim
) -> Timed:
    """Design for a time; by default for the condition number alone."""
    at_work = calm(effort.patience)
    asked = {
        "objective": "condition",
        "refine": None,
        "rate": RATE,
        "scaling": scaling,
    } | aim
    design = design_trajectory(
        case.model,
        case.form,
        Aim(**asked),
        limits=case.limits,
        starts=MANY,
        time_limit=seconds,
        workers=PROCESSES,
    )
    return Timed(design, at_work)


def against_recordings(effort: Effort) -> Iterator[str]:
    """Yield (a): the UR10e against its own recorded motions."""
    yield (
        "| motion | columns | scaling | recorded, series | recorded, samples "
        "| designed | of the lesser | starts | time [s] | busy before |"
    )
    yield "|---|---|---|" + "---:|" * 7
    notes = []
    for nominal in effort.durations:
        recorded = cases.recorded(nominal)
        T = recorded.path.duration
        name = f"{nominal:g} s (played in {T:.1f} s)"
        for friction in (False, True):
            case = cases.ur10e(T, friction=friction)
            for scaling in SCALINGS:
                series = cases.condition(case, recorded.path, scaling)
                samples = cases.condition_of_samples(case, recorded.log, scaling)
                mine = designed(case, effort.seconds, effort, scaling)
                columns = "with friction" if friction else "inertial"
                yield (
                    f"| {name} | {columns} | {scaling} | {series:.1f} | {samples:.1f} "
                    f"| {mine.condition:.4g} "
                    f"| {mine.condition / min(series, samples):.2f} "
                    f"| {mine.design.starts} | {mine.design.seconds:.1f} "
                    f"| {mine.busy:.1f} |"
                )
        beyond = cases.exceeded(cases.ur10e(T), recorded.path)
        notes.append(
            f"- {name}: the series leaves {recorded.residual:.3f} rad (RMS, largest "
            f"joint); beyond the limits: {'; '.join(beyond) or 'nothing'}."
        )
    yield ""
    yield from notes


def ten_minutes(effort: Effort) -> str:
    """Return how far the search for the shortest recorded motion goes."""
    T = cases.recorded(20.0).path.duration
    mine = designed(cases.ur10e(T), 60.0 * effort.minutes, effort)
    return (
        f"For the 20 s motion, inertial columns, unscaled: {mine.condition:.4g} after "
        f"{mine.design.seconds:.0f} s and {mine.design.starts} starts."
    )


def against_writing(effort: Effort) -> Iterator[str]:
    """Yield (b): the RX-60 against motions like the paper's."""
    case = cases.rx60()
    yield "| motion | unscaled | unit columns | starts | time [s] | busy before |"
    yield "|---|" + "---:|" * 5
    for scaling in SCALINGS:
        mine = designed(case, effort.short, effort, scaling)
        name = "unscaled" if scaling == "none" else scaling
        both = [cases.condition(case, mine.design.trajectory, s) for s in SCALINGS]
        yield (
            f"| designed, {name} | {both[0]:.3g} | {both[1]:.3g} "
            f"| {mine.design.starts} | {mine.design.seconds:.1f} | {mine.busy:.1f} |"
        )
    random = [cases.random_path(case, seed) for seed in range(20)]
    paths = {"random, median of 20": random, **_written(10.0)}
    for name, some in paths.items():
        both = [
            np.median([cases.condition(case, path, scaling) for path in some])
            for scaling in SCALINGS
        ]
        yield f"| {name} | {both[0]:.4g} | {both[1]:.4g} | | | |"
    log = cases.rx60_problem().motion("verification")
    both = [cases.condition_of_samples(case, log, scaling) for scaling in SCALINGS]
    yield f"| the paper's verification, 20 s | {both[0]:.4g} | {both[1]:.4g} | | | |"


def _written(duration: float) -> dict[str, list[FourierTrajectory]]:
    tasks = cases.writing_tasks(duration)
    return {f"writing {name}": [path] for name, path in tasks.items()}


def examples(effort: Effort) -> Iterator[str]:
    """Yield (c): robots of example-robot-data."""
    yield (
        "| robot | columns | random start, best of 8 | least condition number | starts "
        "| time [s] | busy before |"
    )
    yield "|---|---|" + "---:|" * 5
    for case in (
        cases.example("UR10"),
        cases.example("UR10", effort=True),
        cases.example("Panda"),
        cases.example("Panda", effort=True),
    ):
        mine = designed(case, effort.seconds, effort)
        start = mine.design.unoptimised.condition.value
        yield f"| {case.name} | inertial | {start:.1f} | {mine} |"
    plain = cases.example("UR10")
    case = replace(plain, model=replace(plain.model, drive=cases.FRICTION))
    mine = designed(case, effort.seconds, effort)
    start = mine.design.unoptimised.condition.value
    yield f"| {case.name} | with friction | {start:.1f} | {mine} |"
