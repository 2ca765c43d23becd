"""A paper's parametrisation, and its printed estimates, checked.

Papers write ``tau = Y alpha`` in combinations of their own, often with gravity's share
of a parameter under another name than its inertial share, and under assumptions such as
"the centre of mass lies on the axis".  Given the combinations, their regressor follows
from the robot's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, chunks
from consistent_id._support.singular import lstsq, pinv, svd
from consistent_id._support.tables import brief
from consistent_id.comparison.feasibility import BaseFeasibility, base_feasibility
from consistent_id.constraints import (
    Constraint,
    FixedCentresOfMass,
    FixedMasses,
    PhysicalConsistency,
    lowered,
)
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.priors import PointToSet
from consistent_id.errors import ProblemError
from consistent_id.estimation.base_least_squares import stationarity_certificate
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.method import Method
from consistent_id.problems.file import PublishedTable
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording, states
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
    parameter_origins,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression, build_regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_sigma, unconstrained_fit
from consistent_id.regression.torque_along import simulate_torque
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.parameters import require_known

Effect = Literal["inertia", "gravity"]

_INCOMPLETE = 1e-9  # share of the regressor that combinations may fail to express
# The torque is exact: the fit has priority over the nominal parameters.
_NEAREST = PointToSet(slack=1e-4)


@dataclass(frozen=True, slots=True)
class Combination:
    """One named combination of parameters.

    Parameters
    ----------
    terms : mapping of str to float
        Coefficients of the model's parameters, by name.
    effect : {"inertia", "gravity"}
        Whether it stands for its parameters' share in inertial or in gravity torque.
    """

    name: str
    meaning: str
    unit: str
    terms: Mapping[str, float]
    effect: Effect = "inertia"


@dataclass(frozen=True, slots=True, eq=False)
class Parametrisation:
    """A robot's torque as ``Y(q, dq, ddq) alpha``, ``alpha = C x``.

    Parameters
    ----------
    zero : tuple of str
        Parameters that the parametrisation takes for zero.

    Raises
    ------
    ProblemError
        If a name is unknown, or the combinations do not express the model's torque.
    """

    model: TorqueModel
    combinations: tuple[Combination, ...]
    zero: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.zero:
            self.model.layout.index(name)
        rng = np.random.default_rng(0)
        state = rng.uniform(-2.0, 2.0, (3, 8, len(self.model.robot)))
        names = self.model.layout.names
        free = [i for i, name in enumerate(names) if name not in self.zero]
        full = self.model.regressor(*state)[:, free]
        mine = np.einsum(
            "jas,ap->jps", self.regressor(*state), self.matrix[:, free], optimize=True
        )
        missing = abs(full - mine).max(axis=(0, 2))
        if missing.max() > _INCOMPLETE * abs(full).max():
            worst = names[free[int(missing.argmax())]]
            raise ProblemError(
                f"the combinations do not express the model's torque: {worst} has an "
                "effect that none of them carries. Complete them, or list it as zero"
            )

    def __len__(self) -> int:
        return len(self.combinations)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the combinations."""
        return tuple(c.name for c in self.combinations)

    @property
    def matrix(self) -> Matrix:
        """``C``, shape (combinations, parameters)."""
        C = np.zeros((len(self), len(self.model.layout)))
        for row, combination in zip(C, self.combinations, strict=True):
            for name, coefficient in combination.terms.items():
                row[self.model.layout.index(name)] = coefficient
        return C

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return ``Y``, shape (joints, combinations, samples)."""
        inertial, gravity = self._lifts()
        still = replace(self.model.robot, gravity=np.zeros(3))
        Y0 = replace(self.model, robot=still).regressor(q, dq, ddq)
        Yg = self.model.regressor(q, dq, ddq) - Y0
        return np.asarray(
            np.einsum("jps,pa->jas", Y0, inertial)
            + np.einsum("jps,pa->jas", Yg, gravity)
        )

    def factor(self, recording: Recording) -> Matrix:
        """Return the triangular factor of ``[Y, tau]`` along a recording.

        Without torque the last column is zero.
        """
        measured = recording.of(self.model.torque_joints).torque
        motion = states(recording.of(self.model.robot.joint_names))
        R = np.zeros((0, len(self) + 1))
        for part in chunks(len(recording), 4096):
            Y = self.regressor(*(values[part] for values in motion))
            tau = np.zeros((Y.shape[2], len(Y)))
            if measured is not None:
                tau = measured[part]
            rows = np.hstack([np.concatenate(list(Y), axis=1).T, tau.T.reshape(-1, 1)])
            R = triangle(np.asfortranarray(np.vstack([R, rows])))
        return R

    def places(self, names: Sequence[str]) -> list[int]:
        """Return the places of named combinations."""
        require_known(names, self.names, "no combination named")
        return [self.names.index(name) for name in names]

    def others(self, names: Sequence[str]) -> list[int]:
        """Return the places of all combinations but those named."""
        named = self.places(names)
        return [i for i in range(len(self)) if i not in named]

    def parameters(self, alpha: Vector, known: ConicSet) -> Vector:
        """Return the smallest parameters with these combinations and known values.

        `known` holds equalities, such as the datasheet's masses, met exactly; the
        combinations are met as nearly as their rounding allows.
        """
        start = lstsq(known.A_eq, known.b_eq)
        _, s, Vt = svd(known.A_eq)
        rank = int((s > 1e-12 * s.max(initial=0.0)).sum())
        free = Vt[rank:].T
        rest = lstsq(self.matrix @ free, alpha - self.matrix @ start, 1e-10)
        return np.asarray(start + free @ rest)

    def _lifts(self) -> tuple[Matrix, Matrix]:
        """Return maps to parameters: for the inertial and for the gravity share."""
        C = self.matrix
        unused = [self.model.layout.index(name) for name in self.zero]
        C[:, unused] = 0.0
        maps = []
        for effect in ("inertia", "gravity"):
            mine = np.array([c.effect == effect for c in self.combinations])
            lift = np.zeros(C.T.shape)
            if mine.any():
                lift[:, mine] = pinv(C[mine])
            maps.append(lift)
        return maps[0], maps[1]


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
