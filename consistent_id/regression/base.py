"""Base parameters: the combinations of parameters that are identifiable.

Some columns of the regressor are zero or are combinations of others, for every motion
of the robot.  The independent ones carry the base parameters [Gautier1991]_: with
``W_dep = W_ind K``, torque depends on ``x_ind + K x_dep`` alone.  How many of them a
recording determines is `excitation_of`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import single_threaded
from consistent_id._support.singular import singular_values, svd
from consistent_id._support.tables import brief
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.regression.linear import (
    STRUCTURAL_TOLERANCE,
    ColumnSplit,
    LinearSolution,
    solve_linear,
    split_at_gap,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import RowModel, random_rows
from consistent_id.robot.parameters import ParameterLayout

_PURE = 1e-6  # part of a unit vector outside a row space, or in it, that is rounding
_ROUND = 1e-10  # entries of K below this are rounding errors


@brief
@dataclass(frozen=True, slots=True, eq=False)
class BaseParameters:
    """The linear map from parameters to base parameters, and its readable form.

    Parameters
    ----------
    layout : ParameterLayout
    independent, dependent : tuple of int
        Columns whose parameters lead a base parameter, and those regrouped into them
        (or without any effect), each in ascending order.
    regrouping : array_like, shape (independent, dependent)
        ``K`` in ``x_base = x_ind + K x_dep``.
    fingerprint : str
        Fingerprint of the torque model they are of, if known.
    near : tuple of str
        Sentences on what is regrouped though a small part of it is independent, as
        rounded angles of the robot's file make it.
    """

    layout: ParameterLayout
    independent: tuple[int, ...]
    dependent: tuple[int, ...]
    regrouping: Matrix
    fingerprint: str = ""
    near: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = (len(self.independent), len(self.dependent))
        freeze_arrays(self, {"regrouping": shape})

    def __len__(self) -> int:
        return len(self.independent)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the leading parameters."""
        return tuple(self.layout.names[i] for i in self.independent)

    @property
    def projection(self) -> Matrix:
        """``P`` with ``x_base = P x``, shape (base, parameters)."""
        P = np.zeros((len(self), len(self.layout)))
        P[range(len(self)), list(self.independent)] = 1.0
        P[:, list(self.dependent)] = self.regrouping
        return P

    @property
    def groupings(self) -> tuple[str, ...]:
        """Each base parameter as a readable sum, such as ``"a.Ixx - a.Iyy"``."""
        return tuple(
            linear_combination(row, self.layout.names) for row in self.projection
        )

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of the parameters that no motion of this robot makes identifiable."""
        regrouped: list[bool] = np.any(self.regrouping, axis=0).tolist()
        return tuple(
            self.layout.names[i]
            for i, has_effect in zip(self.dependent, regrouped, strict=True)
            if not has_effect
        )

    def lift(self, base: Vector) -> Vector:
        """Return the smallest parameter vector with these base parameters."""
        P = self.projection
        return P.T @ np.linalg.solve(P @ P.T, base)


@single_threaded
def base_parameters(
    model: RowModel, *, seed: int = 0, last: Sequence[int] = ()
) -> BaseParameters:
    """Find the base parameters of a robot from random motions, deterministically.

    Columns are taken from left to right: the first of several dependent ones leads the
    group, as in [Gautier1991]_.  A combination that is independent only because of a
    rounded number in the robot's file is regrouped too, and `BaseParameters.near` says
    so.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    seed : int
    last : sequence of int
        Parameters whose columns are taken after all others: those of them that lead are
        what the data show of them whatever the others are, and their base parameters
        hold none of the others.
    """
    columns = random_rows(model, seed=seed).stacked()
    kinds = model.layout.kinds
    order = [*(i for i in range(len(kinds)) if i not in set(last)), *last]
    found = split_at_gap(columns[:, order], [kinds[i] for i in order])
    split = _in_places(found.split, np.array(order))
    near = {order[c]: effect for c, effect in found.near.items()}
    exact = BaseParameters(model.layout, *split, fingerprint=model.fingerprint)
    nearly = ((i, c) for i, c in enumerate(split.dependent) if c in near)
    sentences = [_near_sentence(exact, i, near[c]) for i, c in nearly]
    return replace(exact, near=tuple(sentences))


def base_of_some(
    model: RowModel, named: Sequence[int], *, seed: int = 0
) -> BaseParameters:
    """Find the base parameters of some parameters, all others being known.

    Those of a load, for one, that a second log adds to a robot that is identified.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    named : sequence of int
        The unknown parameters.  The others count as dependent, without effect.
    seed : int
    """
    kinds, order = model.layout.kinds, np.array(sorted(named), dtype=int)
    columns = random_rows(model, seed=seed).stacked()[:, order]
    found = split_at_gap(columns, [kinds[i] for i in order]).split
    independent, among, own = _in_places(found, order)
    others = [i for i in range(len(kinds)) if i not in independent]
    regrouping = np.zeros((len(independent), len(others)))
    regrouping[:, [others.index(i) for i in among]] = own
    return BaseParameters(
        model.layout,
        independent,
        tuple(others),
        regrouping,
        fingerprint=model.fingerprint,
    )


def _in_places(split: ColumnSplit, order: Array) -> ColumnSplit:
    """Return the split of columns that were taken in an order, by their own places."""
    independent, dependent = (
        order[np.array(places, dtype=int)]
        for places in (split.independent, split.dependent)
    )
    rows, columns = np.argsort(independent), np.argsort(dependent)
    return ColumnSplit(
        tuple(independent[rows].tolist()),
        tuple(dependent[columns].tolist()),
        split.regrouping[np.ix_(rows, columns)],
    )


def _near_sentence(base: BaseParameters, place: int, part: float) -> str:
    name = base.layout.names[base.dependent[place]]
    alike = linear_combination(base.regrouping[:, place], base.names)
    like = "has no effect" if alike == "0" else f"acts like {alike}"
    return (
        f"{name} {like}, except for {part:.1g} of its effect, which comes from a "
        "rounded number in the robot's geometry and counts as zero"
    )


def require_match(
    model: TorqueModel, regression: Regression, base: BaseParameters
) -> None:
    """Refuse a regression or base parameters of another torque model, or no torque.

    Raises
    ------
    ProblemError
        If layouts, joints or fingerprints differ.
    NotExcitedError
        If a joint's torque is zero throughout: a dead channel, not a joint at ease.
    """
    require_same_model(model, regression, base)
    rms = regression.torque_rms
    dead = [j for j, size in zip(regression.joints, rms, strict=True) if size == 0.0]
    if dead:
        raise NotExcitedError(
            f"the torque is zero throughout for {', '.join(dead)}; check column, unit "
            "and gain, or leave the joint out of the model's torque_joints"
        )


def require_same_model(
    model: RowModel, regression: Regression, base: BaseParameters
) -> None:
    """Refuse a regression or base parameters of another torque model.

    Raises
    ------
    ProblemError
        If layouts, joints or fingerprints differ.
    """
    for what, found in (("regression", regression), ("base parameters", base)):
        same = found.layout == model.layout and found.fingerprint in (
            "",
            model.fingerprint,
        )
        if not same:
            raise ProblemError(
                f"the {what} are of another torque model: geometry, gravity, drive "
                "terms or names differ. Build them with this model"
            )
    if regression.joints != model.torque_joints:
        raise ProblemError(
            f"the regression is of joints {regression.joints}, the model has torques "
            f"of {model.torque_joints}"
        )


def parameter_origins(
    data: Matrix, known: Matrix, *, elsewhere: str
) -> tuple[str, ...]:
    """Return the source of each parameter's value.

    Parameters
    ----------
    data : ndarray, shape (rows, parameters)
        Rows of the regression that the data determine.
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.
    elsewhere : str
        Name for what determines parameters that neither touches.

    Returns
    -------
    tuple of str
        ``"constraint"`` (the equalities alone fix it), ``"data"`` (data and equalities
        do), ``"combination"`` (they fix only sums it is part of), or `elsewhere`.
    """
    fixed = _part_in_row_space(known)
    seen = _part_in_row_space(np.vstack([data, known]))
    return tuple(
        "constraint"
        if f > 1.0 - _PURE
        else "data"
        if s > 1.0 - _PURE
        else "combination"
        if s > _PURE
        else elsewhere
        for f, s in zip(fixed, seen, strict=True)
    )


def _part_in_row_space(A: Matrix) -> Vector:
    """Squared length of each unit vector's projection on the rows of a matrix."""
    if not A.any():
        return np.zeros(A.shape[1])
    norms = np.linalg.norm(A, axis=1, keepdims=True)
    _, s, Vt = svd(A / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
    rows = Vt[s > STRUCTURAL_TOLERANCE * s[0]]
    return np.asarray(np.sum(rows**2, axis=0))


@dataclass(frozen=True, slots=True)
class ConditionNumber:
    """A condition number with its matrix in words; without them it means nothing.

    Parameters
    ----------
    value : float
        Largest over smallest singular value; infinite if the rank is deficient, up to
        rounding: the smallest is below ``eps max(shape)`` of the largest.
    basis : str
        Columns of the matrix.
    scaling : str
        ``"none"``, or ``"unit columns"``.
    """

    value: float
    basis: str
    scaling: str

    def __str__(self) -> str:
        return f"{self.value:.4g} ({self.basis}; column scaling: {self.scaling})"


def condition_number(
    matrix: Matrix, *, basis: str, unit_columns: bool = False
) -> ConditionNumber:
    """Return the condition number of a regressor (never of its square).

    A triangular factor has the same singular values as the matrix it came from.

    Parameters
    ----------
    matrix : ndarray, shape (rows, columns)
    basis : str
        Columns of the matrix.
    unit_columns : bool
        Whether columns are divided by their norms first.

    Raises
    ------
    NotExcitedError
        If the matrix is empty or zero.
    """
    if matrix.size == 0 or not matrix.any():
        raise NotExcitedError("the regressor is zero: the motion excites no parameter")
    if unit_columns:
        norms = np.linalg.norm(matrix, axis=0)
        matrix = matrix / np.where(norms > 0.0, norms, 1.0)
    singular = singular_values(matrix)
    rounding = np.finfo(np.float64).eps * max(matrix.shape) * singular[0]
    deficient = len(singular) < matrix.shape[1] or singular[-1] <= rounding
    value = np.inf if deficient else singular[0] / singular[-1]
    scaling = "unit columns" if unit_columns else "none"
    return ConditionNumber(float(value), basis, scaling)


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """The excitation of the robot by the training data.

    Parameters
    ----------
    structural_rank : int
        Number of base parameters, from random motions.
    data_rank : int
        Number of them that the data determine.
    condition : tuple of ConditionNumber
        Condition numbers of the base regressor, unscaled and with unit columns.
    undetermined : tuple of str
        Combinations of base parameters that the data do not determine.
    """

    structural_rank: int
    data_rank: int
    condition: tuple[ConditionNumber, ...]
    undetermined: tuple[str, ...]


def excitation_of(regression: Regression, base: BaseParameters) -> Excitation:
    """Return rank and condition of the base regressor in the data."""
    columns = list(base.independent)
    R = regression.stacked()
    solution = solve_linear(R[:, columns], R[:, -1])
    return Excitation(
        structural_rank=len(base),
        data_rank=solution.rank,
        condition=tuple(
            condition_number(
                R[:, columns], basis=f"{len(base)} base columns", unit_columns=unit
            )
            for unit in (False, True)
        ),
        undetermined=open_combinations(solution, base.names),
    )


def open_combinations(
    solution: LinearSolution, names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the combinations of unknowns that a solution leaves open, in words."""
    return tuple(linear_combination(v, names) for v in solution.null_space.T)


def linear_combination(
    coefficients: Vector, names: tuple[str, ...], *, digits: int = 4
) -> str:
    """Write ``sum_i c_i name_i`` for people, leaving out what is zero."""
    terms: list[str] = []
    for c, name in zip(coefficients, names, strict=True):
        if abs(c) <= _ROUND:
            continue
        size = "" if abs(abs(c) - 1.0) < _ROUND else f"{abs(c):.{digits}g} "
        sign = ("-" if c < 0 else "") if not terms else ("- " if c < 0 else "+ ")
        terms.append(f"{sign}{size}{name}")
    return " ".join(terms) or "0"
