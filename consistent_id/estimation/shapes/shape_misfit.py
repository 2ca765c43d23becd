"""The least misfit as a function of friction's shapes, with its exact derivative.

Variable projection [Golub2003]_: for given shapes the best coefficients are those of
linear least squares; what is left depends on the shapes alone.  Where coefficients are
the best, the misfit's derivative is that of the columns, with coefficients held.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import NotExcitedError
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.friction_shape_regression import ShapeRegression
from consistent_id.regression.friction_shapes import Shape, with_shapes
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

_STEP = 1e-5  # of a shape's logarithm: central differences err by its square


@dataclass(frozen=True, slots=True, eq=False)
class ShapeGroup:
    """Shapes that have one value in common.

    Parameters
    ----------
    name : str
        Of the shape, or of its kind where joints share it.
    """

    name: str
    members: tuple[Shape, ...]

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
            If nothing is left of the torque: an exact fit identifies no shapes.
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
        # Columns depend on the shapes of their own joint alone, so that all joints'
        # shapes of one kind are moved at once, and distinguished by their columns.
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
