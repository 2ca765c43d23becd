"""The problem of a search: objective and limits; it can be sent to another process.

The objective is a function of the information of a path,

    M = (recorded / samples) sum_rows  w w^T / noise^2  +  earlier

over the rows ``w`` of the base regressor at the sampled times: a recording of the path
adds its information to that of earlier recordings.

A search starts from a random path that violates no guard (`clear_start`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.accuracy import earlier_rows
from consistent_id.excitation.aims import Aim, PathForm, places_of_interest
from consistent_id.excitation.basis import FourierBasis, LimitRows, limit_rows
from consistent_id.excitation.clear_poses import PathLimits, clear_start
from consistent_id.excitation.criteria import (
    Criterion,
    Objective,
    Scaling,
    Value,
    criterion_of,
    of_some,
    scaled,
)
from consistent_id.excitation.guards import Guard
from consistent_id.excitation.kernels import RegressorKernel, slow_speeds
from consistent_id.excitation.verification import robot_limits
from consistent_id.excitation.work import Costs, Meter, search_costs
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.row_structure import RowModel

_SAMPLES = 100  # least samples of a path, and ten per period of the highest frequency
_GRID = 24  # samples per period of the highest frequency, at which guards measure
_STRIDE = 3  # every third of these times is enough for a random path
_ROW = 3e-6  # work of a guard's row for each joint
_DRAW = 0.6  # for each joint, of the work of measuring guards at these times
_LEAST = 0.01  # rad or m; a joint that can move less is not excited
_MOST_SAMPLES = 1_000_000  # of a recording
# Of a path; twice as many as any measured design used.  Variables grow with them, and
# times with the highest: a step with hundreds takes minutes, in which nothing is heard.
_MOST_FREQUENCIES = 50
_FILL = 0.8  # share of the limits that a random path uses


class RandomPath(NamedTuple):
    """A random path, and the work of finding it.

    Attributes
    ----------
    path : ndarray, shape (size, joints)
    work : float
    kept : bool
        Whether it keeps all limits on the grid.
    """

    path: Matrix
    work: float
    kept: bool


class Information(NamedTuple):
    """An information matrix, and how its gradient becomes that of the variables."""

    matrix: Matrix
    pull: Callable[[Matrix], Matrix]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class PathInformation:
    """Maps the variables of a path to its information.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    base : BaseParameters
    basis : FourierBasis
    samples : int
        Number of samples of a path at which the regressor is computed.
    recorded : float
        Number of samples that will be recorded, represented by the sampled ones.
    noise : ndarray, shape (torque joints,), [N m or N]
    earlier : ndarray, shape (base parameters, base parameters)
        Information of earlier recordings.
    """

    model: RowModel
    base: BaseParameters
    basis: FourierBasis
    samples: int
    recorded: float
    noise: Vector
    earlier: Matrix

    def __call__(self, variables: Matrix) -> Information:
        """Return the information of a path; the last one is remembered."""
        if self not in _EVALUATORS:
            _EVALUATORS[self] = _PathEvaluator(self)
        return _EVALUATORS[self](variables)


@dataclass(frozen=True, slots=True, eq=False)
class SearchProblem:
    """An objective over all Fourier paths of one form, within limits and guards.

    Parameters
    ----------
    information : PathInformation
        Information of a path's variables, shape ``shape``.
    limits : LimitRows
    guards : tuple of Guard
        Limits that are not linear in the variables.
    grid : ndarray, shape (samples,), [s]
        Times at which guards measure.
    objective : Objective
    scaling : {"none", "unit columns"}
        Scaling of the regressor's columns in condition numbers.
    gram : ndarray, shape (base, base), optional
        Gram matrix of the task whose torque is to be predicted.
    spread_bound : float
        Bound on the logarithm of the condition number.
    seed : int
        Seed of the random paths that searches begin with.
    interest : tuple of int
        Indices of the base parameters whose errors matter; empty for all.
    drawing : float
        Work after which a random path is not enlarged any more, see `Meter`.
    poses : ndarray, shape (poses, joints), optional
        Poses that violate no guard, if some are known.
    """

    information: PathInformation
    limits: LimitRows
    guards: tuple[Guard, ...]
    grid: Vector
    objective: Objective
    scaling: Scaling
    gram: Matrix | None = None
    spread_bound: float = np.inf
    seed: int = 0
    interest: tuple[int, ...] = ()
    drawing: float = np.inf
    poses: Matrix | None = None

    @property
    def basis(self) -> FourierBasis:
        """All paths of the form."""
        return self.information.basis

    @property
    def costs(self) -> Costs:
        """Work of the repeated parts of a search."""
        of, joints = self.information, len(self.basis.unit)
        queries = [guard.seconds for guard in self.guards]
        return search_costs(
            len(of.model.torque_joints) * of.samples * len(of.base),
            self.limits.matrix.nnz,
            len(self.limits.time) * joints,
            measure=len(self.grid) * sum(queries),
            row=_ROW * joints,
            draw=_DRAW * joints * len(self.grid[::_STRIDE]) * sum(queries),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the variables."""
        return self.basis.size, len(self.basis.unit)

    def guarded(self, guards: tuple[Guard, ...]) -> "SearchProblem":
        """Return the search with guards, which measure as densely as they need."""
        return replace(self, guards=guards, grid=_grid(self.basis, guards))

    def random(self, number: int) -> Matrix:
        """Return a random path that keeps linear limits, and, if possible, guards."""
        return self.drawn(number).path.copy()

    def drawn(self, number: int) -> "RandomPath":
        """Return a random path, and the work of its search; both are remembered."""
        known = _RANDOM.setdefault(self.information, {})
        poses = b"" if self.poses is None else self.poses.tobytes()
        key = (self.guards, self.seed, number, self.drawing, poses)
        if key not in known:
            known[key] = self._drawn(number)
        return known[key]

    def _drawn(self, number: int) -> "RandomPath":
        rng, basis = np.random.default_rng((self.seed, number)), self.basis
        variables = rng.normal(size=self.shape) * _decay(basis)[:, None]
        variables[0] = rng.uniform(-0.3, 0.3, self.shape[1])
        variables *= _FILL / self.limits.largest(variables)
        times, meter = self.grid[::_STRIDE], Meter(self.drawing)
        limits = PathLimits(basis, self.limits, self.guards, times, meter, self.poses)
        path = clear_start(variables, limits, rng)
        path.setflags(write=False)
        kept = replace(limits, time=self.grid).kept(path)
        return RandomPath(path, meter.spent, kept)

    def criterion(self, objective: Objective, power: float = np.inf) -> Criterion:
        """Return an objective's criterion, smoothed or exact.

        Only condition numbers are scaled: columns of unit size would hide the size of
        the standard errors that the other objectives measure.
        """
        plain = criterion_of(objective, power, self.gram)
        if objective == "condition":
            return scaled(plain, self.scaling)
        of_errors = objective in ("D", "A", "E")
        return of_some(plain, self.interest) if of_errors and self.interest else plain

    def value(self, criterion: Criterion, variables: Matrix) -> Value:
        """Return a criterion's value and its gradient in the variables."""
        matrix, pull = self.information(variables)
        value, gradient = criterion(matrix)
        return Value(value, pull(gradient))

    def score(self, objective: Objective, variables: Matrix) -> float:
        """Return an objective's own value, a logarithm."""
        return self.criterion(objective)(self.information(variables).matrix).value

    def measures(self, variables: Matrix) -> list[Matrix]:
        """Return the measures of each guard along the grid."""
        if not self.guards:
            return []
        motion = self.basis.motion(variables, self.grid)
        return [guard.measure(motion) for guard in self.guards]


def search_problem(
    model: RowModel,
    base: BaseParameters,
    form: PathForm,
    aim: Aim,
    limits: MotionLimits,
) -> SearchProblem:
    """Return the search of a form, an aim and linear limits.

    Raises
    ------
    ProblemError
        If limits of a joint are missing, or earlier recordings or the task are of
        another robot.
    """
    limits = robot_limits(limits, model.robot)
    basis = _basis(form, limits)
    still = basis.trajectory(np.zeros((basis.size, len(limits.joints))))
    cycles = form.frequencies[-1] * basis.duration
    earlier = earlier_rows(model, base, aim)
    information = PathInformation(
        model=model,
        base=base,
        basis=basis,
        samples=max(_SAMPLES, 10 * int(np.ceil(cycles))),
        recorded=form.duration * aim.rate,
        noise=aim.noise_of(model.torque_joints),
        earlier=earlier.T @ earlier,
    )
    return SearchProblem(
        information,
        limit_rows(basis, still.period),
        (),
        _grid(basis, ()),
        aim.objective,
        aim.scaling,
        _gram(model, base, aim),
        interest=places_of_interest(base, aim.interest),
    )


def require_playable_form(form: PathForm, aim: Aim, limits: MotionLimits) -> None:
    """Refuse a form that is too short, too long or too fast for what is stated.

    Raises
    ------
    ProblemError
        With the duration, frequency or joint, and what to do.
    """
    samples = form.duration * aim.rate
    if samples > _MOST_SAMPLES:
        raise ProblemError(
            f"a path of {form.duration:g} s, recorded at {aim.rate:g} Hz, has "
            f"{samples:.3g} samples, expected {_MOST_SAMPLES} at most; make it shorter "
            "and play it several times"
        )
    highest = form.frequencies[-1]
    if highest > 0.5 * aim.rate:
        raise ProblemError(
            f"a path of {form.duration:g} s with frequencies up to {highest:.4g} Hz "
            f"cannot be recorded at {aim.rate:g} Hz; make it longer, or use fewer "
            f"harmonics"
        )
    count = len(form.frequencies)
    if count > _MOST_FREQUENCIES:
        raise ProblemError(
            f"a path of {count} frequencies, up to {highest:.4g} Hz, expected "
            f"{_MOST_FREQUENCIES} at most, because a step of their search takes "
            "minutes; give fewer harmonics, or leave their number out: several are "
            "tried"
        )
    # From rest to rest at full speed, or accelerating for half of the time.
    reach = np.minimum(
        limits.velocity * form.duration / 2.0,
        limits.acceleration * form.duration**2 / 8.0,
    )
    j = int(np.argmin(reach))
    if reach[j] < _LEAST:
        raise ProblemError(
            f"in {form.duration:g} s joint {limits.joints[j]!r} can move "
            f"{reach[j]:.2g} rad (or m) within velocity {limits.velocity[j]:g} and "
            f"acceleration {limits.acceleration[j]:g}; make the path longer, or raise "
            "these limits"
        )
    _basis(form, limits)  # refuses frequencies that leave no motion


def _basis(form: PathForm, limits: MotionLimits) -> FourierBasis:
    """Return all paths of a form, sampled in one repetition if they repeat.

    At the same times of several repetitions, limits would be the same rows twice.
    """
    period = form.period
    return FourierBasis(
        limits,
        form.frequencies,
        period,
        form.rest,
        form.smooth,
        round(form.duration / period),
    )


def _grid(basis: FourierBasis, guards: Sequence[Guard]) -> Vector:
    """Return the times at which guards measure."""
    density = max((guard.density for guard in guards), default=_GRID)
    cycles = basis.frequencies[-1] * basis.duration
    return np.linspace(0.0, basis.duration, int(np.ceil(density * cycles)) + 1)


def _decay(basis: FourierBasis) -> Vector:
    """Return the sizes of random variables: less for the higher harmonics."""
    free = basis.free.reshape(2, len(basis.frequencies), -1)
    order = np.arange(1, len(basis.frequencies) + 1)
    decay = np.ones(basis.size)
    decay[1:] = np.sqrt((free**2 / order[:, None] ** 2).sum(axis=(0, 1)))
    return decay


def _gram(model: RowModel, base: BaseParameters, aim: Aim) -> Matrix | None:
    """Return ``V^T V / rows`` of the task's base regressor."""
    if aim.task is None:
        return None
    log = aim.task.of(model.robot.joint_names)
    if log.velocity is None or log.acceleration is None:
        raise ProblemError(
            f"task {log.name}: velocity or acceleration is missing; differentiate it"
        )
    Y = model.regressor(log.position, log.velocity, log.acceleration)
    V = Y[:, list(base.independent)]
    return np.asarray(np.einsum("jps,jqs->pq", V, V) / (len(V) * len(log)))


class _PathEvaluator:
    """The compiled regressor of a `PathInformation`, and the last information."""

    def __init__(self, of: PathInformation) -> None:
        basis, count = of.basis, of.samples
        time = np.arange(count) * basis.duration / count
        self._basis, self._earlier = basis, of.earlier
        self._kernel = RegressorKernel(
            of.model, of.base, count, slow_speeds(basis.limits)
        )
        self._columns = np.array([basis.columns(order, time) for order in range(3)])
        self._weights = of.recorded / count / of.noise**2
        self._last: tuple[Matrix, Information] | None = None

    def __call__(self, variables: Matrix) -> Information:
        if self._last is None or not np.array_equal(self._last[0], variables):
            self._last = variables.copy(), self._evaluated(variables)
        return self._last[1]

    def _evaluated(self, variables: Matrix) -> Information:
        basis = self._basis
        motion = self._columns @ (variables[1:] * basis.unit)
        motion[0] += basis.offset(variables)
        W = self._kernel.regressor(motion)
        weighted = W * self._weights[:, None, None]
        rows = W.shape[0] * W.shape[1]
        M = W.reshape(rows, -1).T @ weighted.reshape(rows, -1)

        def pull(gradient: Matrix) -> Matrix:
            seed: Array = 2.0 * (weighted.reshape(rows, -1) @ gradient).reshape(W.shape)
            slopes = self._kernel.pull(motion, seed)
            parts = [basis.pull(i, self._columns[i], slopes[i]) for i in range(3)]
            return np.asarray(np.sum(parts, axis=0))

        return Information(M + self._earlier, pull)


# CasADi functions with their own memory, which are not sent to other processes.
_EVALUATORS: WeakKeyDictionary[PathInformation, _PathEvaluator] = WeakKeyDictionary()


# Random paths, whose search among bodies takes long, by guards, seed and number.
_RANDOM: WeakKeyDictionary[
    PathInformation, dict[tuple[tuple[Guard, ...], int, int, float, bytes], RandomPath]
] = WeakKeyDictionary()
