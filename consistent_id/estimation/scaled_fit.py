"""A constrained fit made dimensionless: parameters, misfit and constraints near one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.distances import nominal_point
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.same_model import require_match
from consistent_id.robot.scaling import link_scales

EXACT_FIT = 1e-6
"""Misfit, relative to the torque, that counts as none."""

_STILL = 1e-3
"""Share of the largest column of the same drive term below which a column is the
encoder's noise: its joint stands still.  Noise does not say what a typical parameter
is, else a prior would let friction of a joint at rest be anything."""

# Misfits are measured in units of the residual, or of a millionth of the torque: half
# a unit squared is theirs.
REFERENCE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ScaledFit:
    """``minimise ||M u - z||`` over a set, ``u = x / unit``.

    Parameters
    ----------
    M, z : ndarray
        Of the base regressor's factor, divided by `size`.
    residual : float
        What no parameters explain, divided by `size`.
    constraints : ConicSet
        In original units.
    domain : ConicSet
        The same, normalised.
    centre : ndarray, shape (parameters,)
        The nominal robot.
    unit : ndarray, shape (parameters,)
    projection : ndarray, shape (base, parameters)
        Base parameters of ``u``.
    size : float, [N m], or dimensionless if weighted
        Residual norm of least squares, or a millionth of the torque's.
    """

    M: Matrix
    z: Vector
    residual: float
    constraints: ConicSet
    domain: ConicSet
    centre: Vector
    unit: Vector
    projection: Matrix
    size: float

    @property
    def problem(self) -> LeastNorm:
        """The least-norm problem."""
        return LeastNorm(self.M, self.z, self.domain)

    def excess(self, u: Vector) -> float:
        """Return the squared misfit beyond `residual` squared."""
        return float(np.sum((self.M @ u - self.z) ** 2))

    def with_factor(self, factor: Matrix) -> "ScaledFit":
        """Return the fit to other data, in the same units.

        Parameters
        ----------
        factor : ndarray, shape (rows, base + 1)
            Triangular factor of base columns and torque; see `base_factor`.
        """
        b = len(self.projection)
        scaled = factor / self.size
        rows = np.vstack([scaled, np.zeros((max(b + 1 - len(scaled), 0), b + 1))])
        return replace(
            self,
            M=rows[:b, :b] @ self.projection,
            z=rows[:b, b],
            residual=float(abs(rows[b, b])),
        )


def base_factor(regression: Regression, base: BaseParameters) -> Matrix:
    """Return the triangular factor of base columns and torque, weights applied."""
    R = regression.stacked()
    return triangle(np.asfortranarray(R[:, [*base.independent, -1]]))


def scaled_fit(
    model: TorqueModel,
    regression: Regression,
    base: BaseParameters,
    constraints: Sequence[Constraint],
) -> ScaledFit:
    """Make a fit dimensionless.

    Raises
    ------
    ProblemError, NotExcitedError
        See `require_match`.
    """
    require_match(model, regression, base)
    R = regression.stacked()
    factor = base_factor(regression, base)
    torque = float(np.linalg.norm(R[:, -1]))
    residual = float(abs(factor[-1, -1])) if len(factor) > len(base) else 0.0
    inertial = link_scales(model.robot).units
    norms = _drive_columns(model, R)
    drive = torque / np.where(norms > 0.0, norms, np.inf)
    unit = np.concatenate([inertial, np.where(drive > 0.0, drive, 1.0)])
    possible = lowered(constraints, model)
    blank = ScaledFit(
        M=np.zeros((0, len(unit))),
        z=np.zeros(0),
        residual=0.0,
        constraints=possible,
        domain=possible.normalised(unit),
        centre=nominal_point(model, unit),
        unit=unit,
        projection=base.projection * unit,
        size=max(residual, EXACT_FIT * torque, 1e-300),
    )
    return blank.with_factor(factor)


def _drive_columns(model: TorqueModel, R: Matrix) -> Vector:
    """Return norms of the drive terms' columns, those of joints at rest raised."""
    norms = np.linalg.norm(R[:, model.layout.inertial_size : -1], axis=0)
    terms = np.array([term for _, term in model.layout.drive])
    for term in set(terms.tolist()):
        same = terms == term
        norms[same] = np.maximum(norms[same], _STILL * norms[same].max())
    return np.asarray(norms)
