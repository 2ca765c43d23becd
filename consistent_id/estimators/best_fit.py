"""The least misfit that constraints allow, made dimensionless and certified."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._arrays import Matrix, Vector
from consistent_id.base import BaseParameters
from consistent_id.certificate import Optimality, solve_certified
from consistent_id.cone_program import ConeSolution, LeastNorm
from consistent_id.conic import ConicSet
from consistent_id.constraints import Constraint, lowered
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.feasibility import find_interior
from consistent_id.priors import Distance, distance_to_nominal
from consistent_id.regression import Regression, require_match
from consistent_id.regressor import TorqueModel
from consistent_id.scaling import link_scales

EXACT_FIT = 1e-6
"""Misfit, relative to the torque, that counts as none."""

# Misfits are measured in units of the residual, or of a millionth of the torque: half
# a unit squared is theirs.
REFERENCE = 0.5
_USABLE = 1e-5  # violation beyond which a point is no answer at all


@dataclass(frozen=True, slots=True, eq=False)
class ScaledFit:
    """The fit in dimensionless variables ``u = x / unit`` and units of the residual.

    Parameters
    ----------
    M, z : ndarray
        ``||M u - z||`` is the misfit beyond that of least squares, in units of `size`.
    residual : float
        The misfit of least squares, in units of `size`.
    size : float
        The unit of misfits: that of least squares, or a millionth of the torque.
    domain : ConicSet
    unit : ndarray, shape (parameters,)
    """

    M: Matrix
    z: Vector
    residual: float
    size: float
    domain: ConicSet
    unit: Vector


@dataclass(frozen=True, slots=True, eq=False)
class BestFit:
    """The best fit under constraints, and what the prior's stage needs besides.

    Parameters
    ----------
    scaled : ScaledFit
    solution : ConeSolution
    optimality : Optimality
    G, g : ndarray
        ``||G u - g||`` is the distance to nominal, in dimensionless variables.
    """

    scaled: ScaledFit
    solution: ConeSolution
    optimality: Optimality
    G: Matrix
    g: Vector

    @property
    def parameters(self) -> Vector:
        """The best fitting parameters, in original units; open ones as they fell."""
        return self.solution.u * self.scaled.unit


def best_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters,
    distance: Distance = "pullback",
) -> BestFit:
    """Return the least weighted misfit over the constraints, certified.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    scaled = scaled_fit(model, regression, base, lowered(constraints, model))
    drive_units = scaled.unit[model.layout.inertial_size :]
    G, g = distance_to_nominal(model, distance, drive_units)
    G = G * scaled.unit
    centre = nominal_point(G, g)
    fit = LeastNorm(scaled.M, scaled.z, scaled.domain)
    solution, optimality = solved(fit, centre)
    return BestFit(scaled, solution, optimality, G, g)


def scaled_fit(
    model: TorqueModel, regression: Regression, base: BaseParameters, domain: ConicSet
) -> ScaledFit:
    """Return the fit over a set, made dimensionless.

    Raises
    ------
    ProblemError, NotExcitedError
        See `require_match`.
    """
    require_match(model, regression, base)
    R = regression.stacked()
    columns = list(base.independent)
    Q, R_base = np.linalg.qr(R[:, columns])
    z = Q.T @ R[:, -1]
    residual = float(np.linalg.norm(R[:, -1] - Q @ z))
    inertial = link_scales(model.robot).units
    norms = np.linalg.norm(R[:, model.layout.inertial_size : -1], axis=0)
    drive = np.linalg.norm(R[:, -1]) / np.where(norms > 0.0, norms, np.inf)
    drive = np.where(drive > 0.0, drive, 1.0)
    unit = np.concatenate([inertial, drive])
    size = max(residual, EXACT_FIT * float(np.linalg.norm(R[:, -1])), 1e-300)
    return ScaledFit(
        M=R_base @ (base.projection * unit) / size,
        z=z / size,
        residual=residual / size,
        size=size,
        domain=domain.normalised(unit),
        unit=unit,
    )


def nominal_point(G: Matrix, g: Vector) -> Vector:
    """Return the nominal robot in dimensionless variables."""
    return np.asarray(np.linalg.lstsq(G, g, rcond=None)[0], dtype=np.float64)


def solved(problem: LeastNorm, centre: Vector) -> tuple[ConeSolution, Optimality]:
    """Solve and certify; when nothing comes of it, ask if a solution can exist."""
    try:
        solution, optimality = solve_certified(problem, centre, reference=REFERENCE)
    except SolverError as failure:
        reason = str(failure)
    else:
        if optimality.violation <= _USABLE:
            return solution, optimality
        reason = f"the best point violates constraints by {optimality.violation:.1e}"
    interior = find_interior(problem.domain)
    if interior.proves_empty:
        raise InfeasibleError(
            "no parameters satisfy these constraints together. To blame: "
            f"{'; '.join(interior.to_blame)}. Loosen one of them, or check the "
            "datasheet values and the margin"
        )
    raise SolverError(
        "no usable optimum, though no contradiction in the constraints was proven: "
        f"{reason}"
    )
