"""Payloads of single robots of a fleet: a separate body, fixed to a link.

A load's ten columns are those of the link that carries it, so that along its robot's
motion the link has the parameters ``x + p``, ``x`` shared and ``p`` its own.  Given the
shared parameters, a load is a small cone programme.  Seen from the shared problem, its
best misfit is a convex function of them, and near a point this is a sum of squares: the
load moves as its cone allows, held back by a curvature that follows from slacks and
multipliers.  The part that the load explains is projected out of the robot's rows,
joint by joint, so residuals remain those of joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.singular import pinv, svd
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint, PhysicalConsistency
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.determination import LinearErrors, linear_errors
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.loaded_robot import likely_body
from consistent_id.estimation.payload import datasheet_constraints
from consistent_id.fleet.fleet_model import FleetModel, span
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.linear import independent_columns, solve_linear
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import half_widths, unconstrained_fit
from consistent_id.robot.chains import free_bodies
from consistent_id.robot.inertia import INERTIAL_NAMES, InertialParameters
from consistent_id.robot.model import Datasheet, Link
from consistent_id.robot.parameters import did_you_mean

LOAD = "payload"
"""Name of the body that a robot carries."""

_LEAST = 1e-14  # slack, relative to the largest, that is rounding
_TINY = float(np.finfo(float).tiny)


_OPEN = 1e-6  # part of a unit vector that is not determined, beyond rounding
_TOLD = ("data", "loose", "constraint")


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CarriedBody:
    """The payload of a robot of a fleet.

    Parameters
    ----------
    link : str
        That carries it.
    datasheet : Datasheet
        The datasheet of the load, in the frame of that link.
    """

    link: str
    datasheet: Datasheet = Datasheet()  # noqa: RUF009  frozen


@dataclass(frozen=True, slots=True, eq=False)
class LoadFit:
    """A load that fits best beside given shared parameters, and how it would move.

    Parameters
    ----------
    body : array_like, shape (10,)
    steps : array_like, shape (10, free)
        Directions in which equalities let it move.
    curvature : array_like, shape (any, free)
        ``||curvature v||^2`` is what leaving its cone's faces costs a move
        ``steps @ v``, in the units of the weighted squared misfit.
    misfit : float
        Weighted squared misfit of its robot's shared rows.
    """

    body: Vector
    steps: Matrix
    curvature: Matrix
    misfit: float = np.inf

    def __post_init__(self) -> None:
        free = np.shape(self.steps)[1]
        shapes = {"body": (10,), "steps": (10, free), "curvature": (None, free)}
        freeze_arrays(self, shapes, LOAD)


FREE = LoadFit(np.zeros(10), np.eye(10), np.zeros((0, 10)))
"""A load that may be anything, physical or not."""


@dataclass(frozen=True, slots=True)
class PlacedBody:
    """A robot's payload, and its carrier's index among the shared parameters."""

    carried: CarriedBody
    columns: slice

    def added(self, shared: Vector, body: Vector) -> Vector:
        """Return shared parameters with a load in its carrier."""
        x = shared.copy()
        x[self.columns] += body
        return x


def placed(fleet: FleetModel, carried: CarriedBody, robot: str) -> PlacedBody:
    """Return the load of a robot with the number of the link that carries it.

    Raises
    ------
    ProblemError
        If there is no such link.
    """
    links = fleet.shared.layout.links
    if carried.link not in links:
        near = did_you_mean(carried.link, links)
        raise ProblemError(
            f"fleet: {robot} has a payload on link {carried.link!r}; {near}"
        )
    return PlacedBody(
        carried, fleet.shared.layout.link_slice(links.index(carried.link))
    )


def without_load(
    regression: Regression, place: PlacedBody, load: LoadFit
) -> Regression:
    """Return a robot's regression of shared parameters, its load projected out.

    Exact where the load is `FREE`; else up to second order about its body, and exact
    for the shared parameters beside which that was found.
    """
    rows = [F / s for F, s in zip(regression.factors, regression.sigma, strict=True)]
    ends = np.cumsum([len(part) for part in rows])
    W = np.vstack(rows)
    A = W[:, place.columns]
    W[:, -1] -= A @ load.body
    A = np.vstack([A @ load.steps, load.curvature])
    W = np.vstack([W, np.zeros((len(load.curvature), W.shape[1]))])
    U = span(A)
    explained = load.steps @ pinv(A) @ W
    left = np.split(W - U @ (U.T @ W), ends[:-1])  # curvature goes with the last joint
    factors = (
        triangle(np.asfortranarray(part * s))
        for part, s in zip(left, regression.sigma, strict=True)
    )
    return replace(
        regression,
        factors=tuple(factors),
        noise=_noise_without(regression.noise, place.columns, explained[:, :-1]),
    )


def _noise_without(
    noise: CorrelatedNoise | None, carrier: slice, explained: Matrix
) -> CorrelatedNoise | None:
    """Return scores of rows less what the carrier's columns explain of them."""
    if noise is None:
        return None
    return noise.through(lambda _, N: np.asarray(N - N[:, carrier] @ explained))


@dataclass(frozen=True, slots=True, eq=False)
class LoadProblem:
    """A load beside given shared parameters, as an estimation problem of its own."""

    model: TorqueModel
    regression: Regression
    base: BaseParameters
    constraints: Sequence[Constraint]


def load_problem(
    regression: Regression, place: PlacedBody, shared: Vector
) -> LoadProblem:
    """Return the problem of a robot's own parameters for given shared ones."""
    model = load_model(regression.joints, None)
    factors = tuple(
        triangle(np.asfortranarray(np.column_stack([F[:, place.columns], F @ z])))
        for F in regression.factors
        for z in (np.append(-shared, 1.0),)
    )
    noise = regression.noise
    if noise is not None:
        noise = noise.through(lambda _, N: N[:, place.columns])
    own = replace(
        regression,
        layout=model.layout,
        factors=factors,
        fingerprint=model.fingerprint,
        noise=noise,
    )
    split = independent_columns(own.stacked()[:, :-1])
    base = BaseParameters(model.layout, *split, fingerprint=model.fingerprint)
    sheet = Link(LOAD, None, place.carried.datasheet)
    constraints = (PhysicalConsistency(), *datasheet_constraints(sheet))
    return LoadProblem(model, own, base, constraints)


def load_model(
    joints: tuple[str, ...], nominal: InertialParameters | None
) -> TorqueModel:
    """Return a body of ten parameters, with a row for each joint that feels it."""
    return TorqueModel(free_bodies(LOAD, {LOAD: nominal}), torque_joints=joints)


def load_fit(regression: Regression, place: PlacedBody, shared: Vector) -> LoadFit:
    """Return the load that fits a robot best beside given shared parameters.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    own = load_problem(regression, place, shared)
    found = best_fit(own.model, own.regression, own.constraints, base=own.base)
    domain, unit = found.scaled.domain, found.scaled.unit
    steps = _free_steps(domain)
    curvature = found.scaled.size * _curvature(found) @ steps
    return LoadFit(found.parameters, unit[:, None] * steps, curvature, found.misfit**2)


def _free_steps(domain: ConicSet) -> Matrix:
    """Return an orthonormal basis of the steps that equalities allow."""
    _, s, Vt = svd(domain.A_eq)
    return np.asarray(Vt[int((s > _LEAST).sum()) :].T)


def _curvature(found: BestFit) -> Matrix:
    """Return rows ``L`` with ``||L du||^2`` what constraints cost a small step.

    For a slack ``s`` with a multiplier ``z`` this is ``z / s`` times the square of its
    change.  For a matrix ``J`` with multipliers ``Z``, which have the same axes, it is
    ``(z_i + z_j) / (s_i + s_j)`` times that of the entry ``ij`` along these axes.
    """
    domain, u = found.scaled.domain, found.solution.u
    dual = found.solution.multipliers
    slack = domain.b_in - domain.A_in @ u
    rows = [np.sqrt(_ratio(dual.at_most, slack))[:, None] * domain.A_in]
    for block, Z in zip(domain.blocks, dual.blocks, strict=True):
        J = block.value(u)
        sizes = [max(float(np.linalg.norm(M)), _TINY) for M in (J, Z)]
        _, axes = np.linalg.eigh(J / sizes[0] - Z / sizes[1])
        s, z = (np.einsum("ki,kl,li->i", axes, M, axes) for M in (J, Z))
        costs = _ratio(np.add.outer(z, z), np.add.outer(s, s))
        changes = np.sqrt(costs) * (axes.T @ block.coefficients @ axes)
        rows.append(changes.reshape(len(u), -1).T)
    return np.vstack(rows)


def _ratio(multipliers: Array, slacks: Array) -> Array:
    """Return multipliers over slacks, both taken to be positive."""
    least = _LEAST * max(float(abs(slacks).max(initial=0.0)), _TINY)
    return np.maximum(multipliers, 0.0) / np.maximum(slacks, least)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class FoundPayload:
    """The payload of one robot of a fleet.

    Parameters
    ----------
    link : str
        That carries it, in whose frame it is.
    estimate : Estimate
        Estimate of the load's ten parameters beside the fleet's bodies, certified.
    standard_errors : array_like, shape (10,)
        Standard errors of least squares, by the noise of this robot and by the errors
        of the bodies that all share; infinite where the data do not determine a
        parameter by itself.
    quantiles : array_like, shape (10,)
        Standard errors either way of a 95 % interval: Student's, for the degrees of
        freedom of the noise's part; errors of the shared bodies count as known.
    """

    link: str
    estimate: Estimate
    standard_errors: Vector
    quantiles: Vector

    def __post_init__(self) -> None:
        shapes = {"standard_errors": (10,), "quantiles": (10,)}
        freeze_arrays(self, shapes, LOAD, finite=False)

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
    """Errors of the shared parameters.

    Parameters
    ----------
    root : ndarray, shape (parameters, rank)
        Times its transpose, it is their covariance in directions that data and
        equalities determine.
    open : ndarray, shape (parameters, any)
        Directions that neither determines.
    """

    root: Matrix
    open: Matrix

    def of(self, functionals: Matrix) -> Vector:
        """Return each row's standard error, infinite if no data determine it."""
        errors = np.linalg.norm(functionals @ self.root, axis=1)
        norms = np.linalg.norm(functionals, axis=1), np.linalg.norm(self.open, axis=0)
        loose = abs(functionals @ self.open) > _OPEN * np.outer(*norms)
        return np.where(loose.any(axis=1), np.inf, errors)


def shared_errors(shared: Regression, bodies: Estimate, known: Matrix) -> SharedErrors:
    """Return the errors of the shared parameters.

    Parameters
    ----------
    shared : Regression
        Regression of all robots.
    known : ndarray, shape (rows, parameters)
        Rows of the equalities.
    """
    noise = unconstrained_fit(shared, bodies.base).noise
    norms = np.linalg.norm(known, axis=1, keepdims=True)
    T = np.eye(known.shape[1])
    if norms.any():
        _, s, Vt = svd(known / np.where(norms > 0.0, norms, 1.0))
        T = Vt[int((s > _OPEN).sum()) :].T
    rows = pinv(noise.steps) @ bodies.base.projection @ T
    found = solve_linear(rows, np.zeros(len(rows)))
    return SharedErrors(T @ found.pseudo_inverse @ noise.root.T, T @ found.kernel)


def found_payload(
    regression: Regression,
    place: PlacedBody,
    bodies: Estimate,
    errors: SharedErrors,
) -> FoundPayload:
    """Return the load that a robot carries beside the fleet's bodies.

    Parameters
    ----------
    regression : Regression
        Regression of this robot, link and load as one body.
    bodies : Estimate
        The estimate that all robots share.
    errors : SharedErrors
        Errors of the bodies.

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
    W = regression.stacked()
    moved = pinv(W[:, place.columns]) @ W[:, :-1]
    of_noise = _own_errors(own)
    total = np.hypot(of_noise.values, errors.of(moved))
    # [Satterthwaite1946]_: shares of the variance by noise.
    shares = of_noise.values**2 / np.where(total > 0.0, total, 1.0) ** 2
    freedoms = of_noise.freedoms / np.maximum(shares, _LEAST) ** 2
    told = np.array([origin in _TOLD for origin in estimate.origins])
    return FoundPayload(
        place.carried.link,
        estimate,
        np.where(told, total, np.inf),
        half_widths(freedoms),
    )


def _own_errors(own: LoadProblem) -> LinearErrors:
    """Return errors by the robot's own noise."""
    model = own.model
    known = np.vstack([c.lower(model).A_eq for c in own.constraints])
    noise = unconstrained_fit(own.regression, own.base).noise
    return linear_errors(own.base, noise, known)
