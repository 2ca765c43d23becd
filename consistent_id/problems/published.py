"""A paper's printed estimates, checked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.comparison.feasibility import BaseFeasibility, base_feasibility
from consistent_id.constraints import (
    Constraint,
    FixedCentresOfMass,
    FixedMasses,
    PhysicalConsistency,
    lowered,
)
from consistent_id.constraints.priors import PointToSet
from consistent_id.errors import ProblemError
from consistent_id.estimation.base_least_squares import stationarity_certificate
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.method import Method
from consistent_id.problems.file import PublishedTable
from consistent_id.problems.parametrisation import Combination, Parametrisation
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
    parameter_origins,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_sigma, unconstrained_fit
from consistent_id.regression.torque_along import simulate_torque
from consistent_id.robot.inertia import InertialParameters

_NEAREST = PointToSet(
    slack=1e-4
)  # exact torque: the fit has priority over the nominal parameters


@dataclass(frozen=True, slots=True, eq=False)
class RankReport:
    """Rank of a parametrisation along a motion.

    Parameters
    ----------
    singular_values : ndarray
        Singular values of the regressor with unit columns, relative to the largest.
    null_directions : tuple of str
        Combinations without effect on the torque of the motion.
    """

    columns: tuple[str, ...]
    rank: int
    singular_values: Vector
    null_directions: tuple[str, ...]


@brief
@dataclass(frozen=True, slots=True, eq=False)
class PublishedVector:
    """One printed vector, examined.

    Parameters
    ----------
    feasibility : BaseFeasibility
        The feasibility, with the datasheet's masses and centres of mass.
    nearest : Estimate
        The consistent robot whose torque along the motion differs least.
    torque_change : ndarray, shape (joints,), [N m or N]
        Root-mean-square difference of the two along the motion.
    """

    name: str
    feasibility: BaseFeasibility
    nearest: Estimate
    torque_change: Vector


@brief
@dataclass(frozen=True, slots=True, eq=False)
class PublishedReport:
    """A paper's parametrisation and estimates, checked.

    Parameters
    ----------
    all_columns, free_columns : RankReport
        Ranks with all combinations, and without those fixed from the datasheet.
    mean, standard_deviation : ndarray
        Mean and standard deviation over the experiments, recomputed.
    largest_differences : dict of str to float
        Largest differences between recomputed and printed tables.
    mean_links : dict of str to ndarray
        Inertial parameters of each link, from the mean and the datasheet.
    central_inertia : dict of str to ndarray
        Moments A, B, C and products D, E, F of the mean, recomputed.
    vectors : tuple of PublishedVector
        The mean, then each experiment.
    """

    parametrisation: Parametrisation
    motion: Recording
    all_columns: RankReport
    free_columns: RankReport
    mean: Vector
    standard_deviation: Vector
    largest_differences: dict[str, float]
    mean_links: dict[str, Array]
    central_inertia: dict[str, Array]
    vectors: tuple[PublishedVector, ...]


def parametrisation_of(problem: Problem) -> Parametrisation:
    """Return the published parametrisation of a problem."""
    table = published_table(problem)
    combinations = tuple(
        Combination(c.name, c.meaning, c.unit, c.terms, c.effect)
        for c in table.combinations
    )
    return Parametrisation(problem.model, combinations, tuple(table.zero))


def published_table(problem: Problem) -> PublishedTable:
    """Return the printed results of a problem's paper; an error without a paper."""
    if problem.table.published is None:
        raise ProblemError(f"problem {problem.name!r} has no [published] table")
    return problem.table.published


def check_published(problem: Problem) -> PublishedReport:
    """Recompute and examine everything that a problem's ``[published]`` table prints.

    Raises
    ------
    ProblemError
        If the table's shapes do not fit, or its combinations are incomplete.
    """
    table = published_table(problem)
    mine = parametrisation_of(problem)
    experiments = _experiments(table.experiments, mine)
    _require_lengths(table, mine)
    motion = problem.motion(table.motion)
    R = mine.factor(motion)[:, :-1]
    free = mine.others(table.fixed)
    mean, deviation = experiments.mean(axis=0), experiments.std(axis=0, ddof=1)
    known = lowered((FixedMasses(), FixedCentresOfMass()), problem.model)
    printed_mean = np.array(table.mean) if table.mean else mean
    vectors = {"mean": printed_mean} | {
        f"experiment {i}": row for i, row in enumerate(experiments, start=1)
    }
    standard = {name: mine.parameters(alpha, known) for name, alpha in vectors.items()}
    inertia = central_inertia_of(problem.model, standard["mean"])
    base, links = base_parameters(problem.model), problem.model.layout.links
    still = np.zeros(len(problem.model.layout))
    compressed = build_regression(
        problem.model, simulate_torque(problem.model, still, motion)
    )
    return PublishedReport(
        parametrisation=mine,
        motion=motion,
        all_columns=_rank(R, mine, list(range(len(mine)))),
        free_columns=_rank(R, mine, free),
        mean=mean,
        standard_deviation=deviation,
        largest_differences=_differences(table, mean, deviation, inertia),
        mean_links=dict(zip(links, standard["mean"].reshape(-1, 10), strict=True)),
        central_inertia=inertia,
        vectors=tuple(
            _examined(problem, name, x, base, compressed)
            for name, x in standard.items()
        ),
    )


def _require_lengths(table: PublishedTable, mine: Parametrisation) -> None:
    """Refuse a printed row whose number of values is not that of its names."""
    for name in ("mean", "standard_deviation"):
        length = len(getattr(table, name))
        if length not in (0, len(mine)):
            raise ProblemError(
                f"[published] {name}: {length} values, expected {len(mine)}"
            )
    for link, row in table.central_inertia.items():
        if link not in mine.model.layout.links or len(row) != 6:
            raise ProblemError(
                f"[published.central_inertia] {link}: {len(row)} values, expected 6 "
                f"for one of {', '.join(mine.model.layout.links)}"
            )


def _experiments(rows: Sequence[Sequence[float]], mine: Parametrisation) -> Matrix:
    if len(rows) < 2 or any(len(row) != len(mine) for row in rows):
        raise ProblemError(
            f"[published] experiments: expected 2 or more rows of {len(mine)} values, "
            f"got rows of {sorted({len(row) for row in rows})}"
        )
    return np.array(rows, dtype=np.float64)


def _rank(R: Matrix, mine: Parametrisation, columns: list[int]) -> RankReport:
    solution = solve_linear(R[:, columns], np.zeros(len(R)))
    names = tuple(mine.names[i] for i in columns)
    return RankReport(
        columns=names,
        rank=solution.rank,
        singular_values=solution.singular_values / solution.singular_values[0],
        null_directions=open_combinations(solution, names),
    )


def _differences(
    table: PublishedTable, mean: Vector, deviation: Vector, inertia: dict[str, Array]
) -> dict[str, float]:
    """Return the largest difference between printed and recomputed values."""
    pairs: dict[str, tuple[Array, Sequence[float]]] = {
        "mean": (mean, table.mean),
        "standard deviation": (deviation, table.standard_deviation),
    }
    for link, row in table.central_inertia.items():
        pairs[f"central inertia of {link}"] = (inertia[link], row)
    return {
        name: float(abs(computed - np.array(printed)).max())
        for name, (computed, printed) in pairs.items()
        if len(printed)
    }


def central_inertia_of(model: TorqueModel, x: Vector) -> dict[str, Array]:
    """Return A, B, C, D, E, F of each link; products are ``-Iyz, -Ixz, -Ixy``.

    They are about the centre of mass, or about the origin if the mass is unknown.
    """
    tables = {}
    for k, name in enumerate(model.layout.links):
        body = InertialParameters(x[10 * k : 10 * k + 10])
        # For a link without a known mass, the inertia about the origin is used.
        matrix = body.central_inertia if body.mass > 0.0 else body.inertia
        A, B, C = np.diag(matrix)
        tables[name] = np.array([A, B, C, -matrix[1, 2], -matrix[0, 2], -matrix[0, 1]])
    return tables


def _examined(
    problem: Problem,
    name: str,
    x: Vector,
    base: BaseParameters,
    compressed: Regression,
) -> PublishedVector:
    """Examine a vector along a motion; the torque in `compressed` does not count."""
    model = problem.model
    assumed: tuple[Constraint, ...] = (
        PhysicalConsistency(margin=0.0),
        FixedMasses(),
        FixedCentresOfMass(),
    )
    feasibility = base_feasibility(
        model, base, base.projection @ x, constraints=assumed
    )
    factors = tuple(np.c_[F[:, :-1], F[:, :-1] @ x] for F in compressed.factors)
    regression = replace(compressed, factors=factors)
    nearest = constrained_least_squares(
        model,
        regression,
        constraints=problem.constraints,
        prior=_NEAREST,
        base=base,
        method=f"nearest to {name}",
    )
    change = regression.residual_rms(nearest.parameters)
    return PublishedVector(name, feasibility, nearest, change)


def published_least_squares(
    problem: Problem,
    recording: Recording,
    *,
    base: BaseParameters | None = None,
    drive: DriveTerms | None = None,
) -> Estimate:
    """Identify as in the paper: its parameters, some fixed from the datasheet.

    Where the paper's ``Y^T Y`` is singular, the result is the smallest of all vectors
    that fit best, and the estimate names the combinations that are not identifiable.

    Parameters
    ----------
    base : BaseParameters, optional
        Base parameters of the problem's model, or of the model with `drive`.
    drive : DriveTerms, optional
        Friction and drive terms of each joint that the paper left out.
    """
    started = perf_counter()
    mine, table = parametrisation_of(problem), published_table(problem)
    if drive is not None:
        mine = _with_drive(mine, drive)
    model = mine.model
    known = lowered((FixedMasses(), FixedCentresOfMass()), model)
    fixed, free = mine.places(table.fixed), mine.others(table.fixed)
    alpha = mine.matrix @ mine.parameters(np.zeros(len(mine)), known)
    R = mine.factor(recording)
    target = R[:, -1] - R[:, fixed] @ alpha[fixed]
    solution = solve_linear(R[:, free], target)
    alpha[free] = solution.x
    x = mine.parameters(alpha, known)
    base = base_parameters(model) if base is None else base
    regression = build_regression(model, recording)
    names = tuple(mine.names[i] for i in free)
    return Estimate(
        method=Method.AS_PUBLISHED
        if drive is None
        else Method.AS_PUBLISHED_WITH_FRICTION,
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=parameter_origins(
            solution.row_space @ mine.matrix[free], known.A_eq, elsewhere="convention"
        ),
        undetermined=open_combinations(solution, names),
        sigma=residual_sigma(regression, x, solution.rank),
        certificate=stationarity_certificate(R[:, free], target, solution),
        notes=(
            f"the data determine {solution.rank} of {len(free)} free parameters; this "
            "is the smallest of all vectors that fit best",
        ),
        seconds=perf_counter() - started,
        fit=fit_of(model, unconstrained_fit(regression, base), x),
    )


def _with_drive(mine: Parametrisation, drive: DriveTerms) -> Parametrisation:
    """Return a parametrisation with all drive parameters as further combinations."""
    model = TorqueModel(mine.model.robot, drive)
    layout, start = model.layout, model.layout.inertial_size
    added = tuple(
        Combination(name, name, unit, {name: 1.0})
        for name, unit in zip(layout.names[start:], layout.units[start:], strict=True)
    )
    return Parametrisation(model, (*mine.combinations, *added), mine.zero)
