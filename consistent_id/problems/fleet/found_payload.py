"""What single robots of a fleet were found to carry, and how well that is known."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.determination import linear_errors
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.load.loaded_robot import likely_body
from consistent_id.problems.fleet.payloads import (
    LOAD,
    LoadProblem,
    PlacedBody,
    load_model,
    load_problem,
)
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression
from consistent_id.regression.residual_noise import residual_noise
from consistent_id.robot.inertia import INERTIAL_NAMES, InertialParameters

_OPEN = 1e-6  # part of a unit vector that is not told, beyond rounding
_TOLD = ("data", "loose", "constraint")


@dataclass(frozen=True, slots=True, eq=False)
class FoundPayload:
    """What one robot of a fleet carries.

    Parameters
    ----------
    link : str
        That carries it, in whose frame it is.
    estimate : Estimate
        Of its ten parameters beside the fleet's bodies, certified.
    standard_errors : array_like, shape (10,)
        Of least squares, by the noise of this robot and by the errors of the bodies
        that all share; infinite where the data do not tell a parameter by itself.
    """

    link: str
    estimate: Estimate
    standard_errors: Vector

    def __post_init__(self) -> None:
        freeze_arrays(self, {"standard_errors": (10,)}, LOAD, finite=False)

    @property
    def body(self) -> InertialParameters:
        """The constrained estimate: physically consistent."""
        return InertialParameters(self.estimate.parameters)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, ready for JSON: errors that are infinite are None."""
        values = self.estimate.parameters.tolist()
        errors = [e if np.isfinite(e) else None for e in self.standard_errors.tolist()]
        return {
            "payload": {
                "link": self.link,
                "optimum": self.estimate.certificate.verdict,
                "parameters": dict(zip(INERTIAL_NAMES, values, strict=True)),
                "standard_errors": dict(zip(INERTIAL_NAMES, errors, strict=True)),
            }
        }


@dataclass(frozen=True, slots=True, eq=False)
class SharedErrors:
    """How far the shared parameters may be off.

    Parameters
    ----------
    root : ndarray, shape (parameters, rank)
        Times its transpose their covariance, as far as data and equalities tell.
    open : ndarray, shape (parameters, any)
        Directions that neither tells.
    """

    root: Matrix
    open: Matrix

    def of(self, functionals: Matrix) -> Vector:
        """Return each row's standard error, infinite if nothing tells it."""
        errors = np.linalg.norm(functionals @ self.root, axis=1)
        norms = np.linalg.norm(functionals, axis=1), np.linalg.norm(self.open, axis=0)
        loose = abs(functionals @ self.open) > _OPEN * np.outer(*norms)
        return np.where(loose.any(axis=1), np.inf, errors)


def shared_errors(shared: Regression, bodies: Estimate, known: Matrix) -> SharedErrors:
    """Return the errors of what robots share.

    Parameters
    ----------
    shared : Regression
        Of all robots.
    known : ndarray, shape (rows, parameters)
        Rows of the equalities.
    """
    noise = residual_noise(shared, bodies.base)
    norms = np.linalg.norm(known, axis=1, keepdims=True)
    T = np.eye(known.shape[1])
    if norms.any():
        _, s, Vt = np.linalg.svd(known / np.where(norms > 0.0, norms, 1.0))
        T = Vt[int((s > _OPEN).sum()) :].T
    rows = np.linalg.pinv(noise.steps) @ bodies.base.projection @ T
    found = solve_linear(rows, np.zeros(len(rows)))
    return SharedErrors(T @ found.pseudo_inverse @ noise.root.T, T @ found.kernel)


def found_payload(
    regression: Regression,
    place: PlacedBody,
    bodies: Estimate,
    errors: SharedErrors,
) -> FoundPayload:
    """Return what a robot carries beside the fleet's bodies.

    Parameters
    ----------
    regression : Regression
        Of this robot, link and load as one body.
    bodies : Estimate
        What all robots share.
    errors : SharedErrors
        Of the bodies.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    own = load_problem(regression, place, bodies.parameters)
    R, columns = own.regression.stacked(), list(own.base.independent)
    likely = likely_body(own.base.lift(solve_linear(R[:, columns], R[:, -1]).x))
    model = load_model(regression.joints, likely)
    estimate = constrained_least_squares(
        model,
        replace(own.regression, fingerprint=model.fingerprint),
        constraints=own.constraints,
        base=replace(own.base, fingerprint=model.fingerprint),
        method=LOAD,
    )
    by_noise = _own_errors(own, estimate)
    W = regression.stacked()
    moved = np.linalg.pinv(W[:, place.columns]) @ W[:, :-1]
    return FoundPayload(
        place.carried.link, estimate, np.hypot(by_noise, errors.of(moved))
    )


def _own_errors(own: LoadProblem, estimate: Estimate) -> Vector:
    """Return errors by the robot's own noise; infinite where its data do not tell."""
    model = own.model
    known = np.vstack([c.lower(model).A_eq for c in own.constraints])
    noise = residual_noise(own.regression, own.base)
    found = linear_errors(own.base, noise, known)
    told = np.array([origin in _TOLD for origin in estimate.origins])
    return np.where(told, found, np.inf)
