"""The same question put to other optimisers, with the same limits and time.

All look for the least condition number in the variables of the package's own search,
and all candidates are measured after the same scaling into the limits, at the same
samples.  Each runs in two processes with seeds of their own, and may use as many
seconds of the processor in each: what else the machine does is not counted.
"""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from excitation_cases import Case, problem_of
from excitation_designs import PROCESSES
from loky import get_reusable_executor
from scipy.optimize import differential_evolution, minimize

from consistent_id._support.executors import single_threaded
from consistent_id.excitation.path_search import FoundPath, searched_path

SPREAD = 1.0  # of CMA-ES's first steps: of 0.3 to 4, best with two seeds, in 12 s each


@dataclass(frozen=True)
class Trace:
    """How far a method had come by when.

    Parameters
    ----------
    method : str
    seconds, value : tuple of float
        Each time a better condition number was found; seconds of a process' processor.
    """

    method: str
    seconds: tuple[float, ...]
    value: tuple[float, ...]

    def at(self, second: float) -> float:
        """Return the least condition number found by a time."""
        by_then = [
            v for s, v in zip(self.seconds, self.value, strict=True) if s <= second
        ]
        return min(by_then, default=np.inf)


class TimeIsUp(Exception):
    """Ends an optimiser from within its objective."""


class Judge:
    """Measures candidates, and keeps the trace of the best."""

    def __init__(self, case: Case, seconds: float) -> None:
        self.problem = problem_of(case)
        self.trace: list[tuple[float, float]] = []
        self.best = np.inf
        self.seconds = seconds
        self.begin()

    def begin(self) -> None:
        """Let the time run from now."""
        self.began = clock.process_time()

    def __call__(self, x: np.ndarray) -> float:
        """Return the logarithm of the condition number within the limits."""
        if self.ended():
            raise TimeIsUp
        variables = self.problem.limits.within(x.reshape(self.problem.shape))
        score = self.problem.score("condition", variables)
        self.note(score)
        return score

    def ended(self) -> bool:
        """Return whether its time of the processor is used up."""
        return clock.process_time() > self.began + self.seconds

    def plain(self, x: np.ndarray) -> float:
        """Return it as it is, for methods that have limits as rows of their own."""
        self(x)
        return self.problem.score("condition", x.reshape(self.problem.shape))

    def note(self, score: float) -> None:
        """Keep a score if it is the best so far."""
        if score < self.best:
            self.best = score
            self.trace.append((clock.process_time() - self.began, float(np.exp(score))))


def random_search(judge: Judge, seed: int) -> None:
    """Draw paths that use all of the limits."""
    while True:
        variables = judge.problem.random(seed)
        variables /= judge.problem.limits.largest(variables)
        judge(variables)
        seed += PROCESSES


def evolution(judge: Judge, seed: int) -> None:
    """SciPy's differential evolution, its box as large as limits leave room for."""
    size = int(np.prod(judge.problem.shape))
    differential_evolution(
        judge,
        [(-1.5, 1.5)] * size,
        popsize=2,  # times the variables; more is slower here
        maxiter=10**6,
        tol=0.0,
        polish=False,
        rng=seed,
    )


def strategy(judge: Judge, seed: int) -> None:
    """Run CMA-ES from one random path after another, as each converges."""
    import cma

    judge.begin()  # loading is not searching
    while True:
        start = judge.problem.random(seed).ravel()
        quiet = {"verbose": -9, "verb_log": 0, "seed": seed + 1}  # 0 is the clock's
        cma.fmin2(judge, start, SPREAD, quiet)
        seed += PROCESSES


def slsqp(judge: Judge, seed: int) -> None:
    """SciPy's SLSQP with finite differences, limits as rows, from random paths."""
    A = judge.problem.limits.matrix.toarray()
    rows = {
        "type": "ineq",
        "fun": lambda x: np.append(1.0 - A @ x, 1.0 + A @ x),
        "jac": lambda _: np.vstack([-A, A]),
    }
    while True:
        start = judge.problem.random(seed).ravel()
        minimize(judge.plain, start, method="SLSQP", constraints=rows)
        seed += PROCESSES


def ours(judge: Judge, seed: int) -> None:
    """Run the package's own search from one random path after another."""
    while not judge.ended():
        searched_path(
            judge.problem,
            FoundPath(seed),
            ended=judge.ended,
            report=lambda best: judge.note(best.score),
        )
        seed += PROCESSES


METHODS: dict[str, Callable[[Judge, int], None]] = {
    "consistent_id": ours,
    "SLSQP, finite differences": slsqp,
    "CMA-ES": strategy,
    "differential evolution": evolution,
    "random search": random_search,
}


def missing(method: str) -> str:
    """Return what to install for a method, if anything."""
    absent = method == "CMA-ES" and not find_spec("cma")
    return "`pip install cma`" if absent else ""


def trace(method: str, case: Case, seconds: float) -> Trace:
    """Run a method for a time, in all processes, and merge what they found."""
    runs = partial(_run, method, case, seconds=seconds)
    single = get_reusable_executor(PROCESSES).map(runs, range(PROCESSES))
    return merged(method, list(single))


def merged(method: str, single: list[list[tuple[float, float]]]) -> Trace:
    """Return what processes side by side had found together by when."""
    events = sorted(event for one in single for event in one)
    best, kept = np.inf, []
    for second, value in events:
        if value < best:
            best = value
            kept.append((second, value))
    return Trace(method, tuple(s for s, _ in kept), tuple(v for _, v in kept))


def draw(traces: list[Trace], seconds: float, file: Path) -> None:
    """Draw the best condition numbers over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    for one in traces:
        times = (*one.seconds, seconds)
        axes.step(times, (*one.value, one.value[-1]), where="post", label=one.method)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(0.1, seconds),
        ylim=(None, 100.0),
        xlabel="time of the processor [s], in each of two processes",
        ylabel="least condition number",
        title="UR10, 10 s, five harmonics, unscaled base columns",
    )
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=110)


@single_threaded
def _run(
    method: str, case: Case, seed: int, seconds: float
) -> list[tuple[float, float]]:
    judge = Judge(case, seconds)
    try:
        METHODS[method](judge, seed)
    except TimeIsUp:
        pass
    return judge.trace


def single_starts(case: Case, seeds: int) -> tuple[list[float], list[float]]:
    """Return what single searches reach, and the processor time each takes."""
    runs = get_reusable_executor(PROCESSES).map(partial(_single, case), range(seeds))
    results = list(runs)
    return [value for value, _ in results], [seconds for _, seconds in results]


@single_threaded
def _single(case: Case, seed: int) -> tuple[float, float]:
    began = clock.process_time()
    found = searched_path(problem_of(case), FoundPath(seed))
    return float(np.exp(found.score)), clock.process_time() - began
