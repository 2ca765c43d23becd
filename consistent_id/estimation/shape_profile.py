"""The least misfit as a function of friction's shapes, and its profiles.

Variable projection [Golub2003]_: for given shapes the best coefficients are those of
linear least squares, so the misfit depends on the shapes alone.  At the best
coefficients, the misfit's derivative is that of the columns, with fixed coefficients.
A profile of the misfit along one shape gives its confidence interval.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector, freeze_arrays
from consistent_id.errors import NotExcitedError
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.friction_shapes import (
    FrictionShape,
    ShapeRegression,
    with_shapes,
)
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

# Step of a shape's logarithm; errors of central differences are its square
_STEP = 1e-5
_FIRST = 0.05  # first step of a profile, in the logarithm of the shape
_BEYOND = 2.0  # profiles are followed until this many times the interval's half width
_MOST = 40  # steps on either side


@dataclass(frozen=True, slots=True, eq=False)
class ShapeGroup:
    """Shapes that have one value in common.

    Parameters
    ----------
    name : str
        Name of the shape, or of its kind where joints share it.
    """

    name: str
    members: tuple[FrictionShape, ...]

    @property
    def kind(self) -> str:
        """Kind of all members."""
        return self.members[0].kind

    @property
    def unit(self) -> str:
        """Unit of all members."""
        return self.members[0].unit

    @property
    def value(self) -> float:
        """The members' present value, or the geometric mean of several."""
        return float(np.exp(np.mean([np.log(s.value) for s in self.members])))


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """The least weighted misfit at given shapes.

    Parameters
    ----------
    parameters : ndarray, shape (parameters,)
        A best fit: the smallest in the base parameters.
    half_log : float
        ``log ||R x - z||``, half the logarithm of the sum of squares.
    slope : ndarray, shape (groups,)
        Its derivative by the logarithm of each group's value.
    """

    model: TorqueModel
    regression: Regression
    parameters: Vector
    half_log: float
    slope: Vector


@dataclass(frozen=True, slots=True, eq=False)
class ShapeMisfit:
    """The function from shapes to misfits.

    Parameters
    ----------
    sigma : ndarray, shape (torque joints,)
        Noise by which each joint's rows are divided.
    """

    data: ShapeRegression
    base: BaseParameters
    groups: tuple[ShapeGroup, ...]
    sigma: Vector

    def model(self, log_values: Vector) -> TorqueModel:
        """Return the torque model with these shapes."""
        return with_shapes(self.data.model, self._named(log_values))

    def at(self, log_values: Vector) -> Misfit:
        """Return the least misfit at the logarithms of the groups' values.

        Raises
        ------
        NotExcitedError
            If the fit is exact: an exact fit identifies no shapes.
        """
        model = self.model(log_values)
        columns = self.data.columns(model)
        regression = self.data.regression(model, columns).weighted(self.sigma)
        R, base = regression.stacked(), list(self.base.independent)
        x = np.zeros(len(model.layout))
        x[base] = smallest_solution(R[:, base], R[:, -1])
        size = float(np.linalg.norm(R @ np.append(x, -1.0)))
        if size <= 1e-14 * np.linalg.norm(R[:, -1]):
            raise NotExcitedError("the fit is exact: shapes are not identifiable")
        residuals = self.data.residuals(x, columns)
        scaled = [r / s**2 for r, s in zip(residuals, self.sigma, strict=True)]
        slope = self._slope(log_values, x, scaled) / size**2
        return Misfit(model, regression, x, float(np.log(size)), slope)

    def _slope(self, log_values: Vector, x: Vector, scaled: list[Vector]) -> Vector:
        """Return half the derivative of the sum of squares, per group."""
        # Columns depend only on the shapes of their own joint, so all joints' shapes of
        # one kind are moved together, and separated by their columns.
        slope = np.zeros(len(self.groups))
        layout = self.data.model.layout
        group_of = {
            (shape.owner, shape.kind): g
            for g, group in enumerate(self.groups)
            for shape in group.members
        }
        for kind in {group.kind for group in self.groups}:
            step = _STEP * np.array([group.kind == kind for group in self.groups])
            ahead, back = (
                self.data.columns(self.model(log_values + move))
                for move in (step, -step)
            )
            for r, rows in enumerate(self.data.rows):
                parts = scaled[r] @ (ahead[r] - back[r]) / (2.0 * _STEP)
                for column, part in zip(rows.shaped, parts, strict=True):
                    owner, _ = layout.drive[column - layout.inertial_size]
                    if (owner, kind) in group_of:
                        slope[group_of[owner, kind]] += part * x[column]
        return slope

    def _named(self, log_values: Array) -> Mapping[str, float]:
        return {
            shape.name: float(np.exp(value))
            for group, value in zip(self.groups, log_values, strict=True)
            for shape in group.members
        }


@dataclass(frozen=True, slots=True, eq=False)
class ShapeProfile:
    """One shape: its value, its interval, and the curve of the least misfit.

    Parameters
    ----------
    members : tuple of str
        Shapes that have this value.
    low, high : float
        Confidence interval, or the bounds of the search where it reaches them.
    curve : array_like, shape (points, 2)
        Values, and the misfit there relative to the best, with all other parameters
        fitted again.
    low_found, high_found : bool
        Whether the interval ends before the bound of the search.
    """

    name: str
    members: tuple[str, ...]
    value: float
    low: float
    high: float
    unit: str
    curve: Array
    low_found: bool
    high_found: bool

    def __post_init__(self) -> None:
        freeze_arrays(self, {"curve": (None, 2)})

    @property
    def determined(self) -> bool:
        """Whether the data bound the shape on both sides."""
        return self.low_found and self.high_found

    def __str__(self) -> str:
        text = f"{self.name} = {self.value:.3g} {self.unit}"
        if self.determined:
            return f"{text} [{self.low:.3g}, {self.high:.3g}]"
        open_side = "at least" if self.low_found else "at most"
        if not (self.low_found or self.high_found):
            return f"{text}, which the data do not determine"
        limit = self.low if self.low_found else self.high
        return f"{text}, by the data {open_side} {limit:.3g}"


class LeastMisfit(NamedTuple):
    """The least misfit over all shapes, and the rise of it that noise allows.

    Parameters
    ----------
    misfit : callable
        Misfit of the logarithms of all shapes.
    best : ndarray, shape (shapes,)
        Logarithms of the best shapes.
    box : ndarray, shape (shapes, 2)
        Bounds of the search.
    allowed : float
        See `allowed_rise`.
    """

    misfit: Callable[[Vector], Misfit]
    best: Vector
    box: Array
    allowed: float


def allowed_rise(independent: float, confidence: float) -> float:
    """Return by how much half the logarithm of the sum of squares may rise.

    An interval contains the shapes whose sum of squares is below ``exp(chi2 / N)`` of
    the least, with the chi-square quantile of one degree of freedom and `independent`
    samples ``N``.
    """
    from scipy.special import chdtri

    return float(chdtri(1, 1.0 - confidence) / independent / 2.0)


def profile(minimum: LeastMisfit, group: ShapeGroup, place: int) -> ShapeProfile:
    """Follow the least misfit as one shape moves away from the best.

    The ends of the interval are interpolated in the root of the logarithm, which is
    straight for a quadratic.

    Parameters
    ----------
    place : int
        Index of the group among all shapes.
    """
    misfit, best, box, allowed = minimum
    least = misfit(best).half_log
    points = [(best[place], 0.0)]
    for side in (-1.0, 1.0):
        end = box[place][int(side > 0)]
        step, u, others, before = _FIRST, best[place], best, 0.0
        for _ in range(_MOST):
            u = np.clip(u + side * step, *box[place])
            others, found = _least_at(misfit, place, u, others, box)
            root = np.sqrt(max(found - least, 0.0) / allowed)
            points.append((u, side * root))
            if u == end or root > _BEYOND:
                break
            # Steps grow while the misfit changes little, and shrink where it changes
            # much.
            last, before = abs(root - before), root
            step *= 2.0 if last < 0.25 else 0.5 if last > 1.0 else 1.0
    ordered = np.array(sorted(points))
    low, low_found = _crossing(ordered[ordered[:, 1] <= 0.0][::-1], -1.0)
    high, high_found = _crossing(ordered[ordered[:, 1] >= 0.0], 1.0)
    relative = np.exp(ordered[:, 1] ** 2 * allowed)
    return ShapeProfile(
        name=group.name,
        members=tuple(shape.name for shape in group.members),
        value=float(np.exp(best[place])),
        low=float(np.exp(low)),
        high=float(np.exp(high)),
        unit=group.unit,
        curve=np.column_stack([np.exp(ordered[:, 0]), relative]),
        low_found=low_found,
        high_found=high_found,
    )


def _least_at(
    misfit: Callable[[Vector], Misfit], place: int, u: float, start: Vector, box: Array
) -> tuple[Vector, float]:
    """Return the least misfit with one shape fixed."""
    fixed = np.array(start)
    fixed[place] = u
    free = [i for i in range(len(start)) if i != place]
    if not free:
        return fixed, misfit(fixed).half_log
    from scipy.optimize import minimize

    def value(v: Vector) -> tuple[float, Vector]:
        full = fixed.copy()
        full[free] = v
        found = misfit(full)
        return found.half_log, found.slope[free]

    options = {"ftol": 1e-10, "gtol": 1e-6, "maxiter": 30}
    result = minimize(
        value,
        fixed[free],
        jac=True,
        method="L-BFGS-B",
        bounds=box[free],
        options=options,
    )
    fixed[free] = result.x
    return fixed, float(result.fun)


def _crossing(side: Array, level: float) -> tuple[float, bool]:
    """Return where a side of the profile, from the best outwards, reaches a level."""
    for near, far in pairwise(side):
        if abs(far[1]) >= 1.0:
            share = (level - near[1]) / (far[1] - near[1])
            return float(near[0] + share * (far[0] - near[0])), True
    return float(side[-1][0]), False
