"""The influence of a part of the data: the estimate again without that part.

With ``A`` the weighted base regressor of the other data and ``C`` the covariance of the
torque that they predict, in the coordinates ``y`` of `ResidualNoise`, a change ``d`` of
the base parameters is

    sqrt(y^T C^-1 y / rank)   standard errors, all parameters together,
    ||y|| / sqrt(trace C)     standard errors of the predicted torque.

Standard errors of the other data contain nothing about parameters that only the part
determines, and they grow if the other data are poor.  So the change of torque on other
motions is also compared with the estimate's misfit; it includes the torque of all
parameters that the other data do not determine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import InfeasibleError, NotExcitedError, SolverError
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import constrained_fit
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.slope_reasons import confirmed_joints, doubtful_joints
from consistent_id.estimation.torque_error import Slopes, slopes_on
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regression import build_regression
from consistent_id.regression.residual_noise import UnconstrainedFit
from consistent_id.regression.row_structure import random_rows

SMALL = 1.0
"""Standard errors below which a part of the data has no effect."""

_ROUNDING = 1e-9  # of the largest torque: allowed change of a row without misfit


@dataclass(frozen=True, slots=True)
class Influence:
    """The difference of an estimate from one without a part of its data.

    Parameters
    ----------
    parameters : float
        Root mean square change of the base parameters that the other data determine,
        in their standard errors.
    torque : float
        RMS change of the torque predicted for the other data, in its standard errors.
    elsewhere : float
        RMS change of a row's torque on random motions, or its torque that the other
        data do not determine, over the torque that the estimate misses there if its
        misfit is that of the fit; of the worst row.  NaN where it is not known.
    """

    parameters: float
    torque: float
    elsewhere: float

    @property
    def largest(self) -> float:
        """The larger of both, in standard errors."""
        return max(self.parameters, self.torque)

    @property
    def small(self) -> bool:
        """Whether the part changes less than chance does, and less than the misfit."""
        return self.largest < SMALL and self.elsewhere < 1.0


def influence(
    estimate: Estimate,
    change: Vector,
    others: UnconstrainedFit,
    whole: UnconstrainedFit | None = None,
) -> Influence:
    """Return the difference of parameters, in standard errors of the other data.

    Parameters
    ----------
    estimate : Estimate
        The estimate from all data.
    change : ndarray, shape (parameters,)
        The estimate, less the same one without a part of its data.
    others : UnconstrainedFit
        Least squares on the other data.
    whole : UnconstrainedFit, optional
        Least squares on all data, if the others may determine less.
    """
    base, noise = others.base, others.noise
    A = others.regression.stacked()[:, list(base.independent)]
    y = (A @ noise.steps).T @ (A @ (base.projection @ change))
    C = noise.scatter
    together = float(y @ np.linalg.solve(C, y))
    return Influence(
        parameters=float(np.sqrt(max(together, 0.0) / noise.rank)),
        torque=float(np.linalg.norm(y) / np.sqrt(np.trace(C))),
        elsewhere=_elsewhere(estimate, change, others, whole),
    )


def _elsewhere(
    estimate: Estimate,
    change: Vector,
    others: UnconstrainedFit,
    whole: UnconstrainedFit | None,
) -> float:
    """Return the change of torque on random motions, see `Influence`."""
    model, fit = estimate.model, estimate.fit
    if fit is None or not model.robot.connected:
        return np.nan
    every = replace(model, torque_joints=()) if model.robot.floating else model
    rows = random_rows(every)
    own = dict(zip(fit.joints, fit.misfits, strict=True))
    misfits = [own.get(name, fit.misfit) for name in every.torque_joints]
    torque = rows.rms(estimate.parameters)
    missed = np.maximum(misfits * torque, _ROUNDING * torque.max(initial=0.0))
    changed = rows.rms(change)
    if whole is not None and others.noise.rank < whole.noise.rank:
        lost = _lost(rows.norms, estimate.parameters, others, whole)
        changed = np.maximum(changed, rows.rms(lost))
    return float(np.max(changed / np.maximum(missed, np.finfo(float).tiny)))


def _lost(
    norms: Vector, x: Vector, others: UnconstrainedFit, whole: UnconstrainedFit
) -> Vector:
    """Return the part of parameters that all data determine, and the others do not.

    Parts are orthogonal where each parameter is measured by its torque.
    """
    size = np.where(norms > 0.0, norms, 1.0)
    seen = _determined(whole, size) @ (x * size)
    seen = _determined(whole, size).T @ seen
    again = _determined(others, size)
    return np.asarray((seen - again.T @ (again @ seen)) / size)


def _determined(free: UnconstrainedFit, size: Vector) -> Matrix:
    """Return orthonormal rows: the combinations of parameters that data determine."""
    rows = free.noise.coordinates @ free.base.projection / size
    return np.asarray(np.linalg.qr(rows.T)[0].T)


@dataclass(frozen=True, slots=True, eq=False)
class Refit:
    """An estimate from a part of the data.

    Parameters
    ----------
    parameters : ndarray, shape (parameters,)
    free : UnconstrainedFit
        Least squares on the same data.
    """

    parameters: Vector
    free: UnconstrainedFit


def without(
    estimate: Estimate, recordings: Sequence[Recording], *, joints: Sequence[str] = ()
) -> Refit | None:
    """Estimate again, under the same constraints and prior, without some joints' rows.

    Parameters
    ----------
    estimate : Estimate
        Constrained.
    recordings : sequence of Recording
        Prepared; where their torque is not known, rows are left out.
    joints : sequence of str
        Joints whose torque is left out.

    Returns
    -------
    Refit or None
        None if the data that are left determine no estimate.
    """
    under = estimate.fitted_under
    try:
        problem = _problem_without(estimate, recordings, joints)
        if problem is None or under is None:
            return None
        fitted = constrained_fit(problem, under.prior)
    except (InfeasibleError, NotExcitedError, SolverError):
        return None
    return Refit(fitted.parameters, problem.free)


def least_squares_on(
    estimate: Estimate, recordings: Sequence[Recording]
) -> UnconstrainedFit | None:
    """Return least squares on recordings, with the weights of an estimate.

    Parameters
    ----------
    estimate : Estimate
        Constrained.
    recordings : sequence of Recording
        Prepared.

    Returns
    -------
    UnconstrainedFit or None
        None if they determine no estimate.
    """
    try:
        problem = _problem_without(estimate, recordings, ())
    except (NotExcitedError, SolverError):
        return None
    return None if problem is None else problem.free


def _problem_without(
    estimate: Estimate, recordings: Sequence[Recording], joints: Sequence[str]
) -> FitProblem | None:
    under, model = estimate.fitted_under, estimate.model
    kept = tuple(name for name in model.torque_joints if name not in joints)
    if under is None or not kept:
        return None
    part = replace(model, torque_joints=kept)
    weights = under.weights[[model.torque_joints.index(name) for name in kept]]
    regression = build_regression(part, recordings).weighted(weights)
    base = base_parameters(part)
    return FitProblem.of(part, regression, under.constraints, base)


def confirmed_slopes(
    estimate: Estimate, recordings: Sequence[Recording]
) -> Slopes | None:
    """Return slopes of doubtful joints on the bodies that the other joints determine.

    Joints are doubtful if the nominal bodies do not explain their torque.  Their gains,
    if wrong, do not change the bodies that the other joints determine.  All are left
    out together; joints that the others confirm are then included again.

    Parameters
    ----------
    estimate : Estimate
        Constrained.
    recordings : sequence of Recording
        Its training recordings, prepared.

    Returns
    -------
    Slopes or None
        None if no joint is doubtful, or all are.
    """
    doubtful = () if estimate.fit is None else doubtful_joints(estimate.fit)
    known: dict[str, tuple[float, float, float, float]] = {}
    while doubtful:
        found = _cross_slopes(estimate, recordings, doubtful)
        if found is None:
            break
        values = zip(
            found.slopes, found.explained, found.expected, found.errors, strict=True
        )
        known.update(zip(found.joints, values, strict=True))
        left = tuple(j for j in doubtful if j not in confirmed_joints(found))
        if len(left) == len(doubtful):
            break
        doubtful = left
    return Slopes(tuple(known), *np.array(list(known.values())).T) if known else None


def _cross_slopes(
    estimate: Estimate, recordings: Sequence[Recording], joints: Sequence[str]
) -> Slopes | None:
    """Return slopes of joints' torque on the bodies estimated without these joints.

    None if the other joints determine no bodies, or if these joints have no rows of
    their own: rows of a robot on its feet belong to several joints.
    """
    refit = without(estimate, recordings, joints=joints)
    if refit is None:
        return None
    own = replace(estimate.model, torque_joints=tuple(joints))
    bodies = refit.parameters[: own.layout.inertial_size]
    try:
        regression = build_regression(own, recordings)
    except NotExcitedError:
        return None
    found = slopes_on(own, regression, bodies)
    # Of a line through residuals: their share, over as many as are independent.
    left = np.maximum(1.0 / np.maximum(found.explained, 1e-300) - 1.0, 0.0)
    errors = abs(found.slopes) * np.sqrt(left / regression.effective)
    return replace(found, errors=np.nan_to_num(errors, nan=np.inf))
