"""A paper's experiments done again in the laboratory: each identified, and their mean.

Its table of inertias about the centres of mass gets the errors that it lacks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector, frozen
from consistent_id._support.tables import brief
from consistent_id.comparison.feasibility import in_words
from consistent_id.constraints import FixedCentresOfMass, FixedMasses, lowered
from consistent_id.errors import ProblemError
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.laboratory.experiment import (
    ExperimentLog,
    SynchronisedLog,
    perform,
    synchronised,
)
from consistent_id.laboratory.from_problem import (
    laboratory_of,
    laboratory_table,
    task_motion,
)
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import (
    Parametrisation,
    central_inertia_of,
    parametrisation_of,
    published_least_squares,
    published_table,
)
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import (
    base_parameters,
    linear_combination,
    open_combinations,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import column_sizes, null_space, solve_linear
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

METHODS = 4  # by which each experiment is identified
_PART = 0.2  # of the largest part of a combination; smaller parts are left out

_SILENT = 1e-9  # part of a unit vector in a null space that is rounding alone
ENTRIES = ("A", "B", "C", "D", "E", "F")


@dataclass(frozen=True, slots=True, eq=False)
class ExperimentExcitation:
    """The excitation of a paper's free parameters by one experiment.

    Parameters
    ----------
    condition : float
        Largest singular value over the smallest that counts, of the free columns with
        unit length.
    open_directions : ndarray, shape (combinations, directions)
        Orthonormal; along them no torque of the experiment changes.
    undetermined : tuple of str
        The same, in readable form.
    weakest : str
        The least identifiable of the combinations that count, in units of the columns'
        norms; its largest parts.
    """

    rank: int
    condition: float
    open_directions: Matrix
    undetermined: tuple[str, ...]
    weakest: str


@brief
@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedExperiment:
    """One experiment, identified by several methods.

    Parameters
    ----------
    synchronised_log : SynchronisedLog
        Recordings of the identification.
    vectors : ndarray, shape (estimates, combinations)
        In the paper's combinations.
    """

    name: str
    log: ExperimentLog
    synchronised_log: SynchronisedLog
    excitation: ExperimentExcitation
    estimates: tuple[Estimate, ...]
    vectors: Matrix


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ParameterTable:
    """A method's vectors over the experiments, with mean and standard deviation.

    Parameters
    ----------
    names : tuple of str
        Names of the combinations.
    vectors : ndarray, shape (experiments, combinations)
    """

    method: str
    names: tuple[str, ...]
    experiments: tuple[str, ...]
    vectors: Matrix

    @property
    def mean(self) -> Vector:
        """Over the experiments, shape (combinations,)."""
        return np.asarray(self.vectors.mean(axis=0))

    @property
    def standard_deviation(self) -> Vector:
        """Standard deviation of the sample, shape (combinations,)."""
        return np.asarray(self.vectors.std(axis=0, ddof=1))


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """All experiments of a laboratory, and the vector that was true.

    Parameters
    ----------
    names : tuple of str
        Names of the paper's combinations.
    truth : ndarray, shape (combinations,)
    """

    names: tuple[str, ...]
    truth: Vector
    experiments: tuple[IdentifiedExperiment, ...]

    @property
    def tables(self) -> tuple[ParameterTable, ...]:
        """One for each method, in the order of the estimates."""
        first = self.experiments[0].estimates
        return tuple(
            ParameterTable(
                estimate.method,
                self.names,
                tuple(done.name for done in self.experiments),
                np.array([done.vectors[i] for done in self.experiments]),
            )
            for i, estimate in enumerate(first)
        )

    def scatter(self, table: ParameterTable) -> Vector:
        """Return the sample's standard deviation of `errors`, shape (combinations,)."""
        return np.asarray(self.errors(table).std(axis=0, ddof=1))

    def errors(self, table: ParameterTable) -> Matrix:
        """Return vectors less the truth, shape (experiments, combinations).

        Without their parts along directions in which no torque of the experiment
        changes: there every value is as true as any other.
        """
        rows = []
        for done, vector in zip(self.experiments, table.vectors, strict=True):
            N, error = done.excitation.open_directions, vector - self.truth
            rows.append(error - N @ (N.T @ error))
        return np.array(rows)


def reproduce_experiments(
    problem: Problem,
    inertial: ArrayLike,
    *,
    friction: bool = True,
    experiments: Sequence[str] | None = None,
) -> Reproduction:
    """Perform and identify the experiments of a problem's laboratory.

    Parameters
    ----------
    problem : Problem
        With ``[published]``, ``[tasks]`` and ``[laboratory]``.
    inertial : array_like, shape (10 links,)
        Inertial parameters of the robot in the laboratory, such as the body nearest to
        a published vector.
    friction : bool
        Whether its friction is switched on.
    experiments : sequence of str, optional
        Tasks, by default all of the laboratory's.

    Returns
    -------
    Reproduction
        See `perform_experiments`.
    """
    names = (
        laboratory_table(problem).experiments if experiments is None else experiments
    )
    known = laboratory_table(problem).experiments
    for name in names:
        if name not in known:
            raise ProblemError(
                f"{name!r} is not among the laboratory's experiments: "
                f"{', '.join(known)}"
            )
    return perform_experiments(
        problem,
        inertial,
        {name: task_motion(problem, name) for name in names},
        places=[known.index(name) for name in names],
        friction=friction,
    )


def perform_experiments(
    problem: Problem,
    inertial: ArrayLike,
    motions: Mapping[str, Recording],
    *,
    places: Sequence[int] | None = None,
    friction: bool = True,
    seed: int | None = None,
) -> Reproduction:
    """Perform and identify experiments along any motions, in a problem's laboratory.

    Parameters
    ----------
    problem : Problem
        With ``[published]`` and ``[laboratory]``.
    inertial : array_like, shape (10 links,)
        Inertial parameters of the robot in the laboratory.
    motions : mapping of str to Recording
        Uniformly sampled, with velocity and acceleration.
    places : sequence of int, optional
        Number of each experiment's stream of noise; by default in their order.
    friction : bool
        Whether the robot's friction is switched on.
    seed : int, optional
        By default the laboratory's.

    Returns
    -------
    Reproduction
        By four methods: least squares as published, without friction; the
        constrained estimate of the same model; both again with friction and a torque
        offset in the model.
    """
    if not motions:
        raise ProblemError("no experiments to reproduce; name one task or more")
    mine = parametrisation_of(problem)
    known = frozen(inertial, (problem.model.layout.inertial_size,), "inertial")
    laboratory = laboratory_of(problem, known)
    if not friction:
        laboratory = laboratory.without_friction()
    places = list(range(len(motions))) if places is None else places
    seed = laboratory_table(problem).seed if seed is None else seed
    # A stream for each place: leaving some experiments out changes no other.
    streams = np.random.default_rng(seed).spawn(max(places) + 1)
    done = tuple(
        identify_experiment(problem, name, perform(laboratory, motion, streams[place]))
        for (name, motion), place in zip(motions.items(), places, strict=True)
    )
    return Reproduction(mine.names, mine.matrix[:, : len(known)] @ known, done)


def identify_experiment(
    problem: Problem, name: str, log: ExperimentLog
) -> IdentifiedExperiment:
    """Identify one experiment, by each method of `perform_experiments`.

    Parameters
    ----------
    problem : Problem
    name : str
    log : ExperimentLog
    """
    table, mine = laboratory_table(problem), parametrisation_of(problem)
    together = synchronised(log, cutoff=table.cutoff, trim=table.trim)
    recording = together.recording
    drive = DriveTerms(
        viscous=True,
        coulomb="tanh",
        velocity_scale=table.friction.velocity_scale,
        offset=True,
    )
    with_friction = TorqueModel(problem.model.robot, drive)
    estimates = (
        published_least_squares(problem, recording),
        _constrained(problem, problem.model, recording, Method.CONSTRAINED),
        published_least_squares(problem, recording, drive=drive),
        _constrained(
            problem, with_friction, recording, Method.CONSTRAINED_WITH_FRICTION
        ),
    )
    size = problem.model.layout.inertial_size
    C = mine.matrix[:, :size]
    return IdentifiedExperiment(
        name=name,
        log=log,
        synchronised_log=together,
        excitation=_excitation(mine, published_table(problem).fixed, recording),
        estimates=estimates,
        vectors=np.array([C @ estimate.parameters[:size] for estimate in estimates]),
    )


def _constrained(
    problem: Problem, model: TorqueModel, recording: Recording, method: str
) -> Estimate:
    return constrained_least_squares(
        model,
        build_regression(model, recording),
        constraints=problem.constraints,
        prior=problem.prior,
        base=base_parameters(model),
        method=method,
    )


def _excitation(
    mine: Parametrisation, fixed: Sequence[str], recording: Recording
) -> ExperimentExcitation:
    free = mine.others(fixed)
    names = tuple(mine.names[i] for i in free)
    R = mine.factor(recording)[:, free]
    solution = solve_linear(R, np.zeros(len(R)))
    s, rank = solution.singular_values, solution.rank
    directions = np.zeros((len(mine), len(free) - rank))
    directions[free] = solution.null_space
    if directions.size:
        directions = np.linalg.qr(directions)[0]
    return ExperimentExcitation(
        rank=rank,
        condition=float(s[0] / s[rank - 1]),
        open_directions=directions,
        undetermined=open_combinations(solution, names),
        weakest=_weakest(R, rank, names),
    )


def _weakest(R: Matrix, rank: int, names: tuple[str, ...]) -> str:
    _, _, Vt = np.linalg.svd(R / column_sizes(R))
    direction = Vt[rank - 1] / Vt[rank - 1][abs(Vt[rank - 1]).argmax()]
    large = np.where(abs(direction) > _PART, direction, 0.0)
    return linear_combination(large, names, digits=2)


@dataclass(frozen=True, slots=True, eq=False)
class InertiaTable:
    """Entries of the links' inertia about their centres of mass, over experiments.

    Parameters
    ----------
    entries : ndarray, shape (experiments, links, 6), [kg m^2]
        A, B, C and the products D, E, F.  A link without a known mass enters with its
        inertia about its origin.
    true : ndarray, shape (links, 6)
    identifiable : ndarray of bool, shape (links, 6)
        Whether torque determines the entry, given masses and centres of mass; others
        come from the convention of the smallest vector, or from a prior.
    bodies : tuple of str
        The inconsistency of each link's mean, in words.
    """

    method: str
    links: tuple[str, ...]
    entries: Array
    true: Array
    identifiable: BoolArray
    bodies: tuple[str, ...]

    @property
    def mean(self) -> Array:
        """Over the experiments, shape (links, 6)."""
        return np.asarray(self.entries.mean(axis=0))

    @property
    def standard_deviation(self) -> Array:
        """Standard deviation of the sample, shape (links, 6)."""
        return np.asarray(self.entries.std(axis=0, ddof=1))

    @property
    def standard_error(self) -> Array:
        """Standard error of the mean for independent experiments, shape (links, 6)."""
        return np.asarray(self.standard_deviation / np.sqrt(len(self.entries)))


def inertia_tables(
    problem: Problem, inertial: Array, done: Reproduction
) -> tuple[InertiaTable, ...]:
    """Return each method's inertias about the centres of mass.

    Parameters
    ----------
    inertial : ndarray, shape (10 links,)
        The truth.
    """
    model, size = problem.model, problem.model.layout.inertial_size
    true = np.array(list(central_inertia_of(model, inertial).values()))
    identifiable = _identifiable(problem)
    tables = []
    for i, first in enumerate(done.experiments[0].estimates):
        vectors = [e.estimates[i].parameters[:size] for e in done.experiments]
        entries = [list(central_inertia_of(model, x).values()) for x in vectors]
        mean = np.mean(vectors, axis=0).reshape(-1, 10)
        words = tuple(in_words(x) if x[0] > 0.0 else "mass unknown" for x in mean)
        tables.append(
            InertiaTable(
                first.method,
                model.layout.links,
                np.array(entries),
                true,
                identifiable,
                words,
            )
        )
    return tuple(tables)


def _identifiable(problem: Problem) -> BoolArray:
    """Return which entries every vector with the same torque and datasheet shares."""
    model = problem.model
    known = lowered((FixedMasses(), FixedCentresOfMass()), model)
    rows = np.vstack([base_parameters(model).projection, known.A_eq])
    free = null_space(rows, _SILENT)
    moves = np.linalg.norm(free, axis=1)[: model.layout.inertial_size]
    # Ixx, Iyy, Izz; Iyz, Ixz, Ixy in the order m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz.
    places = [4, 6, 9, 8, 7, 5]
    identifiable = moves.reshape(-1, 10)[:, places] <= np.sqrt(_SILENT)
    return np.asarray(identifiable)
