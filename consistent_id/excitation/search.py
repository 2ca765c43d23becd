"""One search: from a random path to one that is as informative as limits allow."""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.excitation.clear_starts import clear_start
from consistent_id.excitation.criteria import (
    Criterion,
    Objective,
    Value,
    criterion_of,
    scaled,
    spread,
)
from consistent_id.excitation.guards import EVERY, guard_rows, near_places
from consistent_id.excitation.information import Informed, PathInformation
from consistent_id.excitation.kernels import RegressorKernel, slow_speeds
from consistent_id.excitation.limit_rows import LimitRows, limit_rows
from consistent_id.excitation.programme import Programme, minimise
from consistent_id.excitation.search_task import SearchTask

_SHARPENING = ((2.0, 40), (8.0, 120), (20.0, 80))  # power, iterations
_BOUND_POWER = 20.0  # of the smooth condition number, never below the true one
_ROUNDING = 1e-7  # by which a row may be missed
_AIM = 0.01  # by which the programme is asked to do better than a row demands
_GRID = 24  # samples per period of the highest frequency, where guards look
_ROUNDS = 8  # of adding rows where a guard was offended
_SELDOM = 3  # one in so many of the grid's times is enough for a random start
_FILL = 0.8  # share of the limits that a random start uses


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best path of a search that keeps all limits on the search's own grid.

    Parameters
    ----------
    variables : ndarray, shape (size, joints), optional
        None if no path was found that keeps them.
    score : float
        The objective's own value, without smoothing.
    number : int
        Of the random path it began with.
    seconds : float
    offence : str
        What stood in the way, if nothing was found.
    """

    variables: Matrix | None
    score: float
    number: int
    seconds: float
    offence: str = ""


class Searcher:
    """A task made ready: regressor built, rows laid out.

    Parameters
    ----------
    task : SearchTask
    ended : callable, optional
        Says whether searches are to end with what they have.
    report : callable, optional
        Told of each improvement: score and variables.
    """

    def __init__(
        self,
        task: SearchTask,
        ended: Callable[[], bool] | None = None,
        report: Callable[[float, Matrix], None] | None = None,
    ) -> None:
        self.task, self.ended = task, ended or (lambda: False)
        self.report = report or (lambda *_: None)
        basis = task.basis
        self._information = PathInformation(
            basis,
            RegressorKernel(
                task.model, task.base, task.samples, slow_speeds(basis.limits)
            ),
            np.arange(task.samples) * basis.duration / task.samples,
            noise=task.noise,
            recorded=task.recorded,
            earlier=task.earlier,
        )
        free = basis.free.reshape(2, len(basis.frequencies), -1)
        order = np.arange(1, len(basis.frequencies) + 1)
        self._decay = np.ones(basis.size)
        self._decay[1:] = np.sqrt((free**2 / order[:, None] ** 2).sum(axis=(0, 1)))
        self._last: tuple[Vector, Informed] | None = None
        self.limits: LimitRows = limit_rows(basis, task.period)
        count = int(np.ceil(_GRID * basis.frequencies[-1] * basis.duration))
        self.grid = np.linspace(0.0, basis.duration, count + 1)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the variables."""
        return self.task.basis.size, len(self.task.basis.unit)

    def random(self, number: int) -> Matrix:
        """Return a random path that keeps the linear limits, and others if it can."""
        rng = np.random.default_rng((self.task.seed, number))
        variables = rng.normal(size=self.shape) * self._decay[:, None]
        variables[0] = rng.uniform(-0.3, 0.3, self.shape[1])
        variables *= _FILL / self.limits.largest(variables)
        guards, seldom = self.task.guards, self.grid[::_SELDOM]
        return clear_start(variables, self.task.basis, self.limits, guards, seldom, rng)

    def information(self, variables: Matrix) -> Informed:
        """Return the information of a path; the last one is remembered."""
        if self._last is None or not np.array_equal(self._last[0], variables):
            self._last = variables.copy(), self._information(variables)
        return self._last[1]

    def value(self, criterion: Criterion, variables: Matrix) -> Value:
        """Return a criterion's value and its gradient in the variables."""
        matrix, pull = self.information(variables)
        value, gradient = criterion(matrix)
        return Value(value, pull(gradient))

    def criterion(self, objective: Objective, power: float = np.inf) -> Criterion:
        """Return an objective's criterion, smooth or itself.

        Only condition numbers are scaled: columns of unit size would hide how large
        the errors are that the others speak of.
        """
        plain = criterion_of(objective, power, self.task.gram)
        return scaled(plain, self.task.scaling) if objective == "condition" else plain

    def score(self, objective: Objective, variables: Matrix) -> float:
        """Return an objective's own value, a logarithm."""
        return self.criterion(objective)(self.information(variables).matrix).value

    def measures(self, variables: Matrix) -> list[Matrix]:
        """Return what each guard measures along the grid."""
        if not self.task.guards:
            return []
        motion = self.task.basis.motion(variables, self.grid)
        return [guard.measure(motion) for guard in self.task.guards]


@single_threaded
def search(
    searcher: Searcher,
    objective: Objective,
    number: int,
    *,
    start: Matrix | None = None,
    spread_bound: float = np.inf,
) -> Found:
    """Search from a random start, or a given one, through ever sharper criteria.

    Parameters
    ----------
    searcher : Searcher
    objective : Objective
    number : int
        Which of the task's random paths to begin with.
    start : ndarray, shape (size, joints), optional
    spread_bound : float
        That the logarithm of the condition number may not exceed.
    """
    began = clock.monotonic()
    variables = searcher.random(number) if start is None else start
    hunt = _Hunt(searcher, objective, spread_bound)
    hunt.consider(variables)
    for power, iterations in _SHARPENING if start is None else _SHARPENING[1:]:
        variables = hunt.sharpened(variables, power, iterations)
        if searcher.ended():
            break
    return Found(
        hunt.best,
        hunt.score,
        number,
        clock.monotonic() - began,
        ""
        if hunt.best is not None
        else hunt.offence(searcher.limits.within(variables)),
    )


class _Hunt:
    """The best path so far, and the rows that guards have asked for."""

    def __init__(self, searcher: Searcher, objective: Objective, bound: float) -> None:
        self.best: Matrix | None = None
        self.score = np.inf
        self._searcher, self._objective, self._bound = searcher, objective, bound
        times = len(searcher.grid)
        self._places = [guard.standing(times) for guard in searcher.task.guards]

    def consider(self, variables: Matrix) -> None:
        """Keep a path if it is better than what there is, and offends nothing."""
        if not self._offended(variables):
            self._keep(variables)

    def sharpened(self, start: Matrix, power: float, iterations: int) -> Matrix:
        """Minimise at one power, with more rows for as long as a guard is offended."""
        self._add_places(start)
        for _ in range(_ROUNDS):
            candidate, end = self._minimised(start, power, iterations)
            if candidate is None:
                candidate = self._searcher.limits.within(end)
            if not self._offended(candidate):
                self._keep(candidate)
                return candidate
            grown = self._add_places(candidate) | self._add_places(end)
            if not grown or self._searcher.ended():
                return end
            start = end
        return start

    def offence(self, variables: Matrix) -> str:
        """Say which guard a path offends most, and by how much."""
        told = ""
        worst = 0.0
        measures = self._searcher.measures(variables)
        for guard, measure in zip(self._searcher.task.guards, measures, strict=True):
            if measure.max() > worst:
                worst = float(measure.max())
                told = guard.told(int(measure.max(axis=0).argmax()))
        return told

    def _minimised(
        self, start: Matrix, power: float, iterations: int
    ) -> tuple[Matrix | None, Matrix]:
        searcher, shape = self._searcher, start.shape
        criterion = searcher.criterion(self._objective, power)
        best: list[Matrix] = []
        score = np.inf

        def objective(x: Vector) -> tuple[float, Array]:
            value, gradient = searcher.value(criterion, x.reshape(shape))
            return value, gradient.ravel()

        def watch(x: Vector) -> bool:
            nonlocal score
            candidate = searcher.limits.within(x.reshape(shape))
            seen = searcher.score(self._objective, candidate)
            if seen < score and self._within_bound(candidate):
                measures = searcher.measures(candidate)
                if self._keeps_rows(measures):
                    score, best[:] = seen, [candidate]
                    if all(measure.max() <= _ROUNDING for measure in measures):
                        self._keep(candidate)
            return searcher.ended()

        count = sum(map(len, self._places)) + bool(np.isfinite(self._bound))
        end = minimise(
            Programme(
                objective,
                searcher.limits,
                (lambda x: self._rows(x.reshape(shape))) if count else None,
                count,
            ),
            start.ravel(),
            iterations=iterations,
            watch=watch,
        )
        return (best[0] if best else None), end.reshape(shape)

    def _rows(self, variables: Matrix) -> tuple[Vector, Matrix]:
        searcher = self._searcher
        values, jacobians = [np.zeros(0)], [np.zeros((0, variables.size))]
        for guard, places in zip(searcher.task.guards, self._places, strict=True):
            if places:
                basis, grid = searcher.task.basis, searcher.grid
                rows = guard_rows(guard, sorted(places), basis, grid, variables)
                values.append(rows[0])
                jacobians.append(rows[1])
        if np.isfinite(self._bound):
            value, gradient = searcher.value(self._spread, variables)
            values.append(np.array([value - self._bound]))
            jacobians.append(gradient.reshape(1, -1))
        return np.concatenate(values) + _AIM, np.vstack(jacobians)

    @property
    def _spread(self) -> Criterion:
        return scaled(spread(_BOUND_POWER), self._searcher.task.scaling)

    def _keeps_rows(self, measures: list[Matrix]) -> bool:
        """Tell whether guards are not offended where they have rows."""
        for places, measure in zip(self._places, measures, strict=True):
            for time, item in places:
                seen = measure[time].max() if item == EVERY else measure[time, item]
                if seen > _ROUNDING:
                    return False
        return True

    def _within_bound(self, variables: Matrix) -> bool:
        if np.isinf(self._bound):
            return True
        matrix = self._searcher.information(variables).matrix
        return self._spread(matrix).value <= self._bound + _ROUNDING

    def _offended(self, variables: Matrix) -> bool:
        measures = self._searcher.measures(variables)
        offended = any(measure.max() > _ROUNDING for measure in measures)
        return offended or not self._within_bound(variables)

    def _add_places(self, variables: Matrix) -> bool:
        """Add rows where guards are near their limits; say whether any is new."""
        grown = False
        measures = self._searcher.measures(variables)
        for places, measure in zip(self._places, measures, strict=True):
            before = len(places)
            places |= near_places(measure)
            grown |= len(places) > before
        return grown

    def _keep(self, variables: Matrix) -> None:
        score = self._searcher.score(self._objective, variables)
        if score < self.score:
            self.best, self.score = variables, score
            self._searcher.report(score, variables)
