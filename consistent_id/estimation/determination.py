"""The source of each parameter's value: the one classifier behind every table.

Equalities leave some parameters free (`FreeParameters`), and data determine a part of
these.  The rank shows which parameters data and equalities determine, but it ignores
noise: a parameter with an error of ten times its value is not determined by data. It
also ignores inequalities, which may determine parameters that data do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.singular import lstsq, svd
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.sets import Equalities, row_spaces
from consistent_id.regression.base import BaseParameters, parameter_origins
from consistent_id.regression.linear import (
    DATA_RANK_TOLERANCE,
    smallest_solution,
    solve_linear,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    NORMAL,
    ResidualNoise,
    UnconstrainedFit,
    half_widths,
)
from consistent_id.robot.scaling import link_scales

_RANK = 1e-12  # of equalities, relative to the largest singular value

Determination = Literal[
    "data", "combination", "loose", "constraint", "prior", "convention"
]
"""``"data"``: the data determine it, with the equalities among the constraints.
``"combination"``: they determine only sums that contain it. ``"loose"``: the data
depend on it, but bound it only loosely. ``"constraint"``: an equality fixes it, or
constraints restrict it to a small interval. ``"prior"``, ``"convention"``: its value is
the prior's, or that of the smallest of many vectors that fit equally well.
"""

KNOWN = 0.5
"""Width of the 95 % interval, in sizes of the parameter, up to which data determine it:
the value to a quarter, either way."""

PINNED = 0.1
"""Width in sizes up to which constraints determine a parameter."""

USED = 0.1
"""Least share of its joints' torque that a parameter of one size explains. A parameter
that is known to explain less than a tenth of the torque is known well enough for its
use, even if its relative error is above one.
"""

SMALL = (
    "small: the data show that it is small beside the torque, but not its value; half "
    "its 95 % interval is given relative to the value"
)
"""The meaning of this word in tables; see `origin_text`."""

_UNCOUNTED = 10.0  # half an interval over the value, above which it is not stated
_NULL = 1e-9  # singular value of equalities, relative to the largest, that is zero


@dataclass(frozen=True, slots=True, eq=False)
class FreeParameters:
    """Parameters ``x = start + directions y`` that meet all equalities.

    Parameters
    ----------
    start : ndarray, shape (parameters,)
    directions : ndarray, shape (parameters, free)
    """

    start: Vector
    directions: Matrix

    @staticmethod
    def of(constraints: Sequence[Constraint], model: TorqueModel) -> "FreeParameters":
        """Return the parameters that the equalities among constraints leave free."""
        known = lowered(constraints, model)
        width = len(model.layout)
        if not len(known.A_eq):
            return FreeParameters(np.zeros(width), np.eye(width))
        scale = np.linalg.norm(known.A_eq, axis=1, keepdims=True)
        A, b = known.A_eq / scale, known.b_eq / scale[:, 0]
        _, s, Vt = svd(A)
        rank = int((s > _RANK * s[0]).sum())
        return FreeParameters(lstsq(A, b), Vt[rank:].T)

    def determined(self, regression: Regression) -> "FreeParameters":
        """Return the part of the free parameters that data determine."""
        return self.spanned(regression.stacked()[:, :-1] @ self.directions)

    def spanned(self, A: Matrix) -> "FreeParameters":
        """Return the part of the free parameters that rows determine.

        Parameters
        ----------
        A : ndarray, shape (rows, free)
        """
        scale = np.linalg.norm(A, axis=0)
        unit = np.where(scale > 0.0, scale, 1.0)
        _, s, Vt = svd(A / unit, full_matrices=False)
        kept = Vt[s > DATA_RANK_TOLERANCE * s[0]].T if len(s) else Vt.T
        return FreeParameters(self.start, self.directions @ (kept / unit[:, None]))

    def misfit(self, regression: Regression) -> float:
        """Return the least weighted squared misfit over all free parameters."""
        stacked = regression.stacked()
        A, rest = self.reduced(stacked[:, :-1], stacked[:, -1])
        return float(((rest - A @ least_squares(A, rest)) ** 2).sum())

    def reduced(self, Y: Matrix, tau: Vector) -> tuple[Matrix, Vector]:
        """Return rows and their right-hand side in the free directions."""
        return Y @ self.directions, tau - Y @ self.start

    def moves(self, A: Matrix) -> Vector:
        """Return the change of each parameter for which ``||A y||^2`` rises by one.

        These are standard errors for white noise of level one.

        Parameters
        ----------
        A : ndarray, shape (rows, free)
            Rows, of full rank.
        """
        scale = np.linalg.norm(A, axis=0)
        steps = np.linalg.inv(np.linalg.qr(A / scale, mode="r")) / scale[:, None]
        return np.asarray(np.linalg.norm(self.directions @ steps, axis=1))


def least_squares(A: Matrix, b: Vector) -> Vector:
    """Return the smallest solution in unit columns."""
    return smallest_solution(A, b, _RANK)


class LinearErrors(NamedTuple):
    """Standard errors in least squares, and the equalities under which they hold.

    Parameters
    ----------
    values : ndarray, shape (parameters,)
    known : ndarray, shape (rows, parameters)
        Rows of the equalities.
    freedoms : ndarray, shape (parameters,)
        Degrees of freedom of each error.
    """

    values: Vector
    known: Matrix
    freedoms: Vector

    @property
    def quantiles(self) -> Vector:
        """Standard errors either way of 95 % intervals: Student's quantiles."""
        return half_widths(self.freedoms)


def determinations(
    model: TorqueModel,
    free: UnconstrainedFit,
    errors: LinearErrors,
    x: Vector,
    *,
    elsewhere: Determination,
) -> tuple[Determination, ...]:
    """Return the source of each parameter's value.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the data.
    errors : LinearErrors
        Errors of the data, under the equalities that hold by assumption.
    x : ndarray, shape (parameters,)
        The estimate.
    elsewhere : str
        The source of parameters that neither data nor equalities determine.
    """
    rows = free.solution.row_space @ free.base.projection
    origins = parameter_origins(rows, errors.known, elsewhere=elsewhere)
    size = parameter_sizes(model, free.regression, x)
    loose = 2.0 * errors.quantiles * errors.values > KNOWN * size
    found: list[Determination] = []
    for origin, is_loose in zip(origins, loose, strict=True):
        if origin == "data":
            found.append("loose" if is_loose else "data")
        elif origin == "constraint":
            found.append("constraint")
        else:
            found.append("combination" if origin == "combination" else elsewhere)
    return tuple(found)


def pinned(
    found: Sequence[Determination], width: Vector, size: Vector
) -> tuple[Determination, ...]:
    """Mark parameters that constraints determine and data do not.

    Parameters
    ----------
    found : sequence of str
        See `determinations`.
    width : ndarray, shape (parameters,)
        Width of consistent intervals.
    size : ndarray, shape (parameters,)
        See `parameter_sizes`.
    """
    held = width <= PINNED * size
    return tuple(
        "constraint" if is_held and origin != "data" else origin
        for origin, is_held in zip(found, held, strict=True)
    )


class Determined(NamedTuple):
    """The source of each parameter's value, and its standard error.

    Parameters
    ----------
    origins : tuple of str
        See `determinations`.
    errors : ndarray, shape (parameters,)
        See `stated_errors`.
    quantiles : ndarray, shape (parameters,)
        See `LinearErrors.quantiles`.
    """

    origins: tuple[Determination, ...]
    errors: Vector
    quantiles: Vector

    def partly_along(self, ratios: Vector) -> "Determined":
        """Return these with the mean of both variances.

        Where the truth is on a boundary, noise makes it active in half of all data
        sets.

        Parameters
        ----------
        ratios : ndarray, shape (parameters,)
            Standard errors along active inequalities over those without them.
        """
        return self._replace(errors=self.errors * np.sqrt((1.0 + ratios**2) / 2.0))

    def biased(self, shift: Vector) -> "Determined":
        """Return these with a bias added to the errors.

        Parameters
        ----------
        shift : ndarray, shape (parameters,)
            How far a prior moved the parameters from the best fit.
        """
        return self._replace(errors=np.hypot(self.errors, shift))


def determined(
    model: TorqueModel,
    free: UnconstrainedFit,
    known: Matrix,
    x: Vector,
    *,
    elsewhere: Determination,
) -> Determined:
    """Return the sources of an estimate's values, with errors from its data's noise.

    Parameters
    ----------
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.
    x, elsewhere
        See `determinations`.
    """
    errors = linear_errors(free.base, free.noise, known)
    origins = determinations(model, free, errors, x, elsewhere=elsewhere)
    stated = stated_errors(errors.values, origins)
    return Determined(origins, stated, errors.quantiles)


def loose_trunk(model: TorqueModel, origins: Sequence[str]) -> tuple[str, ...]:
    """Return the mass and first moments of a floating trunk that are not determined.

    Parameters
    ----------
    origins : sequence of str
        Source of each parameter, as in `determinations`.
    """
    robot, determined = model.robot, ("data", "constraint")
    if not robot.floating or not len(robot):
        return ()
    pairs = zip(model.layout.names[:4], origins, strict=False)
    return tuple(name for name, origin in pairs if origin not in determined)


def origin_text(
    origin: str, value: float, error: float, quantile: float = NORMAL
) -> str:
    """Return the source of a parameter, for people.

    A parameter that the data determine may be small: its interval is narrow relative to
    the size that matters in use (`USED`), but contains zero.  Then half the 95 %
    interval, `quantile` standard errors, over the value is stated with the word.

    Examples
    --------
    >>> origin_text("data", 2.0, 0.1), origin_text("data", 0.1, 0.15)
    ('data', 'small (± 294 %)')
    """
    half = quantile * error
    if origin != "data" or not half > abs(value):
        return origin
    if half > _UNCOUNTED * abs(value):
        return f"small (± more than {100.0 * _UNCOUNTED:.0f} %)"
    return f"small (± {100.0 * half / abs(value):.0f} %)"


def stated_errors(
    errors: Vector, origins: Sequence[Determination], shift: Vector | float = 0.0
) -> Vector:
    """Return the standard errors of the parameters that the data determine, else NaN.

    Parameters
    ----------
    errors : ndarray, shape (parameters,)
        Errors from noise; see `linear_errors`.
    shift : ndarray, shape (parameters,), or float
        How far a prior moved the parameters from the best fit: its bias.
    """
    seen = np.array([origin in ("data", "loose") for origin in origins])
    return np.where(seen, np.hypot(errors, shift), np.nan)


def parameter_sizes(model: TorqueModel, regression: Regression, x: Vector) -> Vector:
    """Return the size of each parameter: its value, or the value that matters in use.

    The latter explains `USED` of the torque of the joints that depend on it.  If no
    joint does, the size is the link's typical one.
    """
    units, n = link_scales(model.robot).units, model.layout.inertial_size
    sizes = np.append(units, np.ones(len(x) - n))
    squares = np.array([np.sum(F**2, axis=0) for F in regression.factors])
    columns, torque = squares[:, :-1], squares[:, -1]
    felt = columns > 0.0  # by each joint, shape (joints, parameters)
    used = felt.any(axis=0)
    ratio = (torque @ felt)[used] / columns.sum(axis=0)[used]
    sizes[used] = USED * np.sqrt(ratio)
    return np.maximum(sizes, abs(x))


def linear_errors(
    base: BaseParameters, noise: ResidualNoise, known: Matrix
) -> LinearErrors:
    """Return each parameter's standard error in least squares under equalities.

    For parameters that data and equalities do not determine, it is that of the smallest
    solution, and is meaningless.
    """
    M = noise.coordinates @ base.projection
    free = _unseen(known)
    A = free.along(M)
    if not A.any():
        nothing = np.zeros(M.shape[1])
        return LinearErrors(nothing, known, np.full(len(nothing), np.inf))
    inverse = solve_linear(A, np.zeros(len(A))).pseudo_inverse
    values, axes = np.linalg.eigh(noise.scatter)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    moves = free.steps @ inverse  # of the parameters, by a change of ``y``
    errors = np.linalg.norm(moves @ root, axis=1)
    return LinearErrors(errors, known, noise.freedoms_along(moves))


def _unseen(rows: Matrix) -> Equalities:
    """Return the steps in the null space of rows."""
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return row_spaces(rows / np.where(norms > 0.0, norms, 1.0), tolerance=_NULL)
