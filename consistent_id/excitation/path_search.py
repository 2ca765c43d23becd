"""One search: from a random path to the most informative one within limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.excitation.criteria import Criterion, Value, scaled, spread
from consistent_id.excitation.guards import EVERY, guard_rows, near_places
from consistent_id.excitation.programme import (
    LinearRows,
    Local,
    Programme,
    best_step,
    minimise,
)
from consistent_id.excitation.search_problem import SearchProblem
from consistent_id.excitation.work import Meter

_SHARPENING = ((2.0, 40), (8.0, 120), (20.0, 80))  # power, iterations
_SMOOTH = ((1.0, 160),)  # of objectives that no power makes sharper
_SHARPENED = ("condition", "E")
_BOUND_POWER = 20.0  # of the smooth condition number, never below the true one
_ROUNDING = 1e-7  # allowed violation of a row
_AIM = 0.01  # margin by which the programme tightens rows
_AGAIN = 60  # most iterations from the end of the round before
_RESTORED = 4  # most steps from a path that violates a guard to one that does not
_FAR = 3.0  # of the variables in such a step
_SLOW = 0.5  # times an iteration, above which measuring all guards is slow
_REACH = 0.3  # of the variables in the first step from a path that violates nothing
_LEAST_REACH = 1e-3  # below which such steps end
_LITTLE, _IDLE = 2e-4, 4  # gain of the objective; so many such steps end, too
_WIDER = 1.5  # by which the reach grows
_CURVED = 0.1  # curvature before any is known
_APART = 1e-3  # least margin of rows
_SAFER = 8.0  # times that margin, for each step in a row that violates a guard
_FULL = 0.8  # share of the reach from which a step counts as full
_CORRECTED = 4  # times that a step is computed, with the last one's curvature and rows
_BEYOND = 12  # iterations in a row that violate a guard, after which a round ends
_HALVED = 5  # times that the way to a path that violates a guard is halved
_ROUNDS = 30  # of adding rows where a guard was violated

Report = Callable[["FoundPath"], None]


@brief
@dataclass(frozen=True, slots=True, eq=False)
class FoundPath:
    """The start of a search, or its best path.

    Parameters
    ----------
    number : int
        Index of the random path that the search began with.
    variables : ndarray, shape (size, joints), optional
        For a start: None for the random path.  For a result: a path that keeps all
        limits on the search's own grid; None if there is none.
    score : float
        The objective's own value, without smoothing.
    complete : bool
        Whether the search ended by itself, not by its allowance or the user.
    obstacle : str
        The limit that was violated most, if nothing was found.
    iterations : int
        Number of iterations of the solver.
    work : float
        Work that was done, see `Meter`.
    drawn : ndarray, shape (size, joints), optional
        For a start without variables: its random path, if it is known already.
    """

    number: int
    variables: Matrix | None = None
    score: float = np.inf
    complete: bool = True
    obstacle: str = ""
    iterations: int = 0
    work: float = 0.0
    drawn: Matrix | None = None


def _never() -> bool:
    return False


def _unreported(best: FoundPath) -> None:
    pass


def random_candidate(problem: SearchProblem, number: int) -> FoundPath:
    """Return a random path as a candidate; without variables if it violates a limit."""
    variables, _, kept = problem.drawn(number)
    if not kept:
        return FoundPath(number)
    score = problem.score(problem.objective, variables)
    return FoundPath(number, variables, score)


@single_threaded
def searched_path(
    problem: SearchProblem,
    start: FoundPath,
    *,
    work: float = np.inf,
    ended: Callable[[], bool] = _never,
    report: Report = _unreported,
) -> FoundPath:
    """Search from a random path, or a given one, through ever sharper criteria.

    Parameters
    ----------
    work : float
        Allowed work, see `Meter`; the same work gives the same result.
    ended : callable
        Returns whether the search must end at once with its best path.
    report : callable
        Called with each improvement.
    """
    given = start.variables is not None
    variables, meter = start.variables if given else start.drawn, Meter(work)
    if variables is None:
        variables, meter.spent, _ = problem.drawn(start.number)
    run = _PathSearch(problem, FoundPath(start.number), meter, ended, report)
    run.consider_near(np.asarray(variables))
    for power, iterations in _phases(problem.objective, given):
        if run.over and run.best.variables is not None:
            break
        variables = run.sharpened(np.asarray(variables), power, iterations)
    obstacle = ""
    if run.best.variables is None:
        obstacle = _obstacle(problem, problem.limits.within(np.asarray(variables)))
    return replace(
        run.best,
        complete=not run.over,
        obstacle=obstacle,
        iterations=run.iterations,
        work=run.meter.spent,
    )


def _phases(objective: str, given: bool) -> tuple[tuple[float, int], ...]:
    """Return powers and iterations; a given path skips the coarse ones."""
    if objective not in _SHARPENED:
        return _SMOOTH
    return _SHARPENING[1:] if given else _SHARPENING


class _PathSearch:
    """A running search: the best path so far, and the guards' rows."""

    def __init__(
        self,
        problem: SearchProblem,
        best: FoundPath,
        meter: Meter,
        ended: Callable[[], bool],
        report: Report,
    ) -> None:
        self.best, self.meter, self.iterations = best, meter, 0
        self._problem, self._ended, self._report = problem, ended, report
        self._costs = problem.costs
        self._beyond = False  # whether the last round ended because of a guard
        times = len(problem.grid)
        self._places = [guard.initial_places(times) for guard in problem.guards]
        self._measured: tuple[Matrix, list[Matrix]] | None = None  # the last path

    @property
    def over(self) -> bool:
        """Whether the allowance is spent, or the search must end."""
        return self.meter.over or self._ended()

    def consider(self, variables: Matrix) -> bool:
        """Keep a path if it is better than the best, and violates no limit."""
        measures = self._measures(variables)
        violated = any(measure.max() > _ROUNDING for measure in measures)
        if violated or not self._within_bound(variables):
            return False
        self._keep(variables)
        return True

    def consider_near(self, variables: Matrix) -> None:
        """Keep a path, or the nearest one that violates no limit."""
        x, none = variables, np.zeros(variables.size)
        if self.consider(x) or not self._problem.guards:
            return
        local = Local(none, np.eye(x.size), self._problem.limits.fine.tocsr())
        for _ in range(_RESTORED):
            self._add_places(x)
            values, jacobian = self._rows(x)
            rows = LinearRows(values - _AIM + _APART, jacobian)
            step = best_step(x.ravel(), local, rows, _FAR, self.meter)
            if step is None:
                return
            x = self._problem.limits.within(x + step.reshape(x.shape))
            if self.consider(x):
                return

    def sharpened(self, start: Matrix, power: float, iterations: int) -> Matrix:
        """Minimise at one power, with more rows as long as a guard is violated.

        A round ends soon after its paths violate a guard, so that rows are added before
        the work is spent on paths that are of no use.
        """
        self._add_places(start)
        if self.best.variables is not None and self._slow:
            return self._from_clear(power, iterations)
        for round_ in range(_ROUNDS):
            rows = sum(map(len, self._places))
            few = min(iterations, _AGAIN) if round_ else iterations
            candidate, end = self._minimised(start, power, few)
            if candidate is None:
                candidate = self._problem.limits.within(end)
            if self.consider(candidate) and not self._beyond:
                return candidate
            self._add_places(candidate)
            self._add_places(end)
            self._consider_between(candidate)
            if self.best.variables is not None:
                return self._from_clear(power, iterations)
            if sum(map(len, self._places)) == rows or self.over:
                return end
            start = end
        return start

    def _consider_between(self, variables: Matrix) -> None:
        """Keep the path furthest from the best one towards another without violations.

        The linear limits are kept by all paths between two that keep them.
        """
        start = self.best.variables
        if start is None:
            return
        least, most = 0.0, 1.0
        for _ in range(_HALVED):
            share = (least + most) / 2.0
            if self._is_clear(start + share * (variables - start)):
                least = share
            else:
                most = share
        if least > 0.0:
            self._keep(start + least * (variables - start))

    @property
    def _slow(self) -> bool:
        """Whether guards take longer than all other work, so few paths are measured."""
        costs = self._costs
        return costs.measure > _SLOW * (costs.iteration + costs.gradient)

    def _from_clear(self, power: float, iterations: int) -> Matrix:
        """Step from the best path, which violates no limit, to better ones like it."""
        problem = self._problem
        criterion = problem.criterion(problem.objective, power)
        x = np.asarray(self.best.variables)
        value, slope = self._valued(criterion, x)
        from consistent_id.excitation.callbacks import updated_curvature

        curvature: Matrix | None = None
        limits, reach, idle = problem.limits.fine.tocsr(), _REACH, 0
        self._add_places(x)
        while reach > _LEAST_REACH and iterations > 0 and idle < _IDLE:
            if self.over:
                break
            B = np.eye(x.size) * _CURVED if curvature is None else curvature
            candidate = self._step(x, Local(slope.ravel(), B, limits), reach)
            new, its_slope = value, slope
            if candidate is not None:
                new, its_slope = self._valued(criterion, candidate)
            if candidate is None or not new < value:
                reach *= 0.5
                continue
            iterations -= 1
            self.iterations += 1
            idle = idle + 1 if value - new < _LITTLE else 0
            moved, change = (candidate - x).ravel(), (its_slope - slope).ravel()
            curvature = updated_curvature(curvature, moved, change)
            reach *= _WIDER if abs(moved).max() > _FULL * reach else 1.0
            x, value, slope = candidate, new, its_slope
            self._keep(x)
        return x

    def _step(self, x: Matrix, local: Local, reach: float) -> Matrix | None:
        """Return the best path within a reach that violates no limit, or None.

        The guards' curvature along a step is included after the step is known.  Where
        the step violates a guard that has no row yet, it gets one.
        """
        limits = self._problem.limits
        values, jacobian = self._rows(x)
        for tried in range(_CORRECTED):
            apart = _APART * _SAFER**tried
            rows = LinearRows(np.minimum(values - _AIM + apart, 0.0), jacobian)
            step = best_step(x.ravel(), local, rows, reach, self.meter)
            if step is None or (tried and self.over):
                return None
            candidate = limits.within(x + step.reshape(x.shape))
            before = sum(map(len, self._places))
            if self._is_clear(candidate):
                return candidate
            if sum(map(len, self._places)) > before:
                values, jacobian = self._rows(x)
            moved = (candidate - x).ravel()
            values = self._rows(candidate)[0] - jacobian @ moved
        return None

    def _is_clear(self, variables: Matrix) -> bool:
        """Return whether a path violates no limit; add rows where it nearly does."""
        measures = self._measures(variables)
        guards = self._problem.guards
        for guard, places, measure in zip(guards, self._places, measures, strict=True):
            places |= near_places(measure, guard.near)
        violated = any(measure.max() > _ROUNDING for measure in measures)
        return not violated and self._within_bound(variables)

    def _valued(self, criterion: Criterion, x: Matrix) -> Value:
        self.meter.spent += self._costs.gradient
        return self._problem.value(criterion, x)

    def _minimised(
        self, start: Matrix, power: float, iterations: int, reach: float = np.inf
    ) -> tuple[Matrix | None, Matrix]:
        """Return the best path that keeps the existing rows, and the last one."""
        problem, shape = self._problem, start.shape
        criterion = problem.criterion(problem.objective, power)
        best: Matrix | None = None
        self._beyond = False
        score, beyond = np.inf, 0

        def objective(x: Vector) -> tuple[float, Array]:
            self.meter.spent += self._costs.gradient
            value, gradient = problem.value(criterion, x.reshape(shape))
            return value, gradient.ravel()

        def watch(x: Vector) -> bool:
            nonlocal best, score, beyond
            self.iterations += 1
            self.meter.spent += self._costs.iteration + self._costs.value
            candidate = problem.limits.within(x.reshape(shape))
            seen = problem.score(problem.objective, candidate)
            if seen < score and self._within_bound(candidate):
                if self._slow:
                    best, score = candidate, seen
                    return self.over
                measures = self._measures(candidate)
                clear = all(measure.max() <= _ROUNDING for measure in measures)
                beyond = 0 if clear else beyond + 1
                if self._keeps_rows(measures):
                    best, score = candidate, seen
                    if clear:
                        self._keep(candidate)
            self._beyond = beyond >= _BEYOND
            return self.over or self._beyond

        count = sum(map(len, self._places)) + bool(np.isfinite(problem.spread_bound))
        end = minimise(
            Programme(
                objective,
                problem.limits,
                (lambda x: self._rows(x.reshape(shape))) if count else None,
                count,
            ),
            start.ravel(),
            iterations=iterations,
            watch=watch,
            reach=reach,
        )
        return best, end.reshape(shape)

    def _rows(self, variables: Matrix) -> tuple[Vector, Matrix]:
        problem = self._problem
        self.meter.spent += self._costs.row * sum(map(len, self._places))
        values, jacobians = [np.zeros(0)], [np.zeros((0, variables.size))]
        for guard, places in zip(problem.guards, self._places, strict=True):
            if places:
                basis, grid = problem.basis, problem.grid
                rows = guard_rows(guard, sorted(places), basis, grid, variables)
                values.append(rows[0])
                jacobians.append(rows[1])
        if np.isfinite(problem.spread_bound):
            value, gradient = problem.value(self._spread, variables)
            values.append(np.array([value - problem.spread_bound]))
            jacobians.append(gradient.reshape(1, -1))
        return np.concatenate(values) + _AIM, np.vstack(jacobians)

    @property
    def _spread(self) -> Criterion:
        return scaled(spread(_BOUND_POWER), self._problem.scaling)

    def _keeps_rows(self, measures: list[Matrix]) -> bool:
        """Return whether guards are satisfied where they have rows."""
        for places, measure in zip(self._places, measures, strict=True):
            for time, item in places:
                seen = measure[time].max() if item == EVERY else measure[time, item]
                if seen > _ROUNDING:
                    return False
        return True

    def _within_bound(self, variables: Matrix) -> bool:
        bound = self._problem.spread_bound
        if np.isinf(bound):
            return True
        matrix = self._problem.information(variables).matrix
        return self._spread(matrix).value <= bound + _ROUNDING

    def _add_places(self, variables: Matrix) -> bool:
        """Add rows where guards are near their limits; return whether any is new."""
        grown = False
        measures = self._measures(variables)
        guards = self._problem.guards
        for guard, places, measure in zip(guards, self._places, measures, strict=True):
            before = len(places)
            places |= near_places(measure, guard.near)
            grown |= len(places) > before
        return grown

    def _measures(self, variables: Matrix) -> list[Matrix]:
        if self._measured is None or not np.array_equal(self._measured[0], variables):
            self.meter.spent += self._costs.measure
            self._measured = variables.copy(), self._problem.measures(variables)
        return self._measured[1]

    def _keep(self, variables: Matrix) -> None:
        score = self._problem.score(self._problem.objective, variables)
        if score < self.best.score:
            self.best = replace(
                self.best,
                variables=variables,
                score=score,
                iterations=self.iterations,
                work=self.meter.spent,
            )
            self._report(self.best)


def _obstacle(problem: SearchProblem, variables: Matrix) -> str:
    """Return the limit that a path violates most."""
    worst, name = 0.0, ""
    for guard, measure in zip(problem.guards, problem.measures(variables), strict=True):
        if measure.max() > worst:
            worst = float(measure.max())
            name = guard.item_name(int(measure.max(axis=0).argmax()))
    return name
