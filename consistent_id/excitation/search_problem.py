"""What a search minimises, and within what; it can be sent to another process."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.accuracy import earlier_rows
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.clear_starts import clear_start
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
from consistent_id.excitation.information import PathInformation
from consistent_id.excitation.interest import places_of_interest
from consistent_id.excitation.limit_rows import LimitRows, limit_rows
from consistent_id.excitation.verification import robot_limits
from consistent_id.excitation.work import Costs, search_costs
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.row_model import RowModel

_SAMPLES = 100  # of a path at least, and ten per period of the highest frequency
_GRID = 24  # samples per period of the highest frequency, at which guards measure
_STRIDE = 3  # every third of these times is enough for a random path
_ROW = 3e-6  # work of a guard's row for each joint
_FILL = 0.8  # share of the limits that a random path uses


@dataclass(frozen=True, slots=True, eq=False)
class SearchProblem:
    """An objective over all Fourier paths of one form, within limits and guards.

    Parameters
    ----------
    information : PathInformation
        Of a path's variables, shape ``shape``.
    limits : LimitRows
    guards : tuple of Guard
        Limits that are not linear in the variables.
    grid : ndarray, shape (samples,), [s]
        When guards measure.
    objective : Objective
    scaling : {"none", "unit columns"}
        Of the regressor's columns in condition numbers.
    gram : ndarray, shape (base, base), optional
        Of the task whose torque is to be predicted.
    spread_bound : float
        That the logarithm of the condition number may not exceed.
    seed : int
        Of the random paths that searches begin with.
    interest : tuple of int
        Places of the base parameters whose errors matter; of none, all.
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

    @property
    def basis(self) -> FourierBasis:
        """All paths of the form."""
        return self.information.basis

    @property
    def costs(self) -> Costs:
        """Work of what a search repeats."""
        of, joints = self.information, len(self.basis.unit)
        queries = [guard.seconds for guard in self.guards]
        return search_costs(
            len(of.model.torque_joints) * of.samples * len(of.base),
            self.limits.matrix.nnz,
            len(self.limits.time) * joints,
            measure=len(self.grid) * sum(queries),
            row=_ROW * joints,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the variables."""
        return self.basis.size, len(self.basis.unit)

    def random(self, number: int) -> Matrix:
        """Return a random path that keeps the linear limits, and others if it can."""
        rng, basis = np.random.default_rng((self.seed, number)), self.basis
        variables = rng.normal(size=self.shape) * _decay(basis)[:, None]
        variables[0] = rng.uniform(-0.3, 0.3, self.shape[1])
        variables *= _FILL / self.limits.largest(variables)
        times = self.grid[::_STRIDE]
        return clear_start(variables, basis, self.limits, self.guards, times, rng)

    def criterion(self, objective: Objective, power: float = np.inf) -> Criterion:
        """Return an objective's criterion, smooth or itself.

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
        """Return what each guard measures along the grid."""
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
    guards: tuple[Guard, ...] = (),
    *,
    seed: int = 0,
) -> SearchProblem:
    """Return the search of a form, an aim and limits.

    Raises
    ------
    ProblemError
        If limits of a joint are missing, or earlier recordings or the task are of
        another robot.
    """
    limits = robot_limits(limits, model.robot)
    basis = FourierBasis(
        limits, form.frequencies, form.duration, form.rest, form.smooth
    )
    cycles = form.frequencies[-1] * form.duration
    density = max((guard.density for guard in guards), default=_GRID)
    still = basis.trajectory(np.zeros((basis.size, len(limits.joints))))
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
        guards,
        np.linspace(0.0, form.duration, int(np.ceil(density * cycles)) + 1),
        aim.objective,
        aim.scaling,
        _gram(model, base, aim),
        seed=seed,
        interest=places_of_interest(base, aim.interest),
    )


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
