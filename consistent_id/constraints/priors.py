"""Priors for parameters that the data do not determine: nearness to the nominal robot.

Distances to it are in dimensionless parameters.  Per link, with the whitened
pseudo-inertia ``S = J0^-1/2 J J0^-1/2``:

- pullback: ``||S - 1||_F^2``, scale-free, frame-free, the second order of the next;
- entropic: ``2 (tr S - log det S - 4)``, the log-det divergence [Lee2020]_, which keeps
  every link away from the boundary of the consistency cone;
- Euclidean: the squares of parameters divided by typical masses and lengths.

Friction and drive terms add their squares, divided by typical sizes.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.sets import svec
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.robot.scaling import link_scales, reference_bodies

Distance = Literal["pullback", "euclidean", "entropic"]
"""Distances of a robot from the nominal one; see `nominal_distance`."""

INSIDE = 0.1
"""Share of its nominal body that every link contains, if the data allow it: its
thickness is at least a third of the nominal one.
"""

_THINNEST = 1e-13  # relative eigenvalues below which a link is flat up to rounding


@brief
@dataclass(frozen=True, slots=True)
class PointToSet:
    """Among all estimates that fit nearly best, take the one nearest to the nominal.

    Parameters
    ----------
    slack : float, optional
        Relative increase of the weighted misfit norm that counts as "nearly best".  By
        default the increase for one standard error of all determined parameters
        together (``chi^2 <= 1``, noise as correlated as the residuals).  A slack of
        1e-6 delivers the optimum itself, to 2e-6 of the squared misfit.
    distance : {"pullback", "euclidean", "entropic"}
        See `nominal_distance`.
    inside : float
        Share of its nominal body that every link contains, so that it stays off the
        boundary of physical consistency; zero for none.  It is reduced until it moves
        the determined parameters by at most a quarter of a standard error, and the
        slack is reduced by the same amount.

    Notes
    -----
    For a link without a nominal body, a ball of its typical mass and length is used
    (`reference_bodies`); friction and drive terms are shrunk towards zero.
    """

    slack: float | None = None
    distance: Distance = "pullback"
    inside: float = INSIDE

    def __post_init__(self) -> None:
        if self.slack is not None and not 0.0 < self.slack < 1.0:
            raise ProblemError(f"slack is {self.slack}, expected between 0 and 1")
        _require_known(self.distance, self.inside)

    def relative_slack(self, error: float, least: float) -> float:
        """Return the slack, given the squared misfit of one standard error.

        Parameters
        ----------
        error : float
            Squared misfit that a move by one standard error adds.
        least : float
            Squared misfit of the best fit.
        """
        return misfit_increase(error, least) if self.slack is None else self.slack


@brief
@dataclass(frozen=True, slots=True)
class Penalty:
    """Weigh the distance to nominal against the misfit.

    ``minimise ||R x - z||^2 + weight r^2 distance(x)^2`` over the constraints, with
    ``r`` the residual norm of least squares: with a weight of one, a distance of one
    costs as much as the whole residual of least squares.

    Parameters
    ----------
    weight : float
        Positive; `cross_validated` chooses it from the training data.
    distance : {"pullback", "euclidean", "entropic"}
    inside : float
        See `PointToSet`.
    """

    weight: float
    distance: Distance = "pullback"
    inside: float = INSIDE

    def __post_init__(self) -> None:
        if not 0.0 < self.weight < np.inf:
            raise ProblemError(f"weight is {self.weight}, expected a positive number")
        _require_known(self.distance, self.inside)


Prior = PointToSet | Penalty


def misfit_increase(added: float, least: float) -> float:
    """Return the relative increase of a misfit norm whose square grows from `least`."""
    return float(np.expm1(0.5 * np.log1p(added / least)))


def _require_known(distance: str, inside: float) -> None:
    if not 0.0 <= inside < 1.0:
        raise ProblemError(f"inside is {inside}, expected from 0 to less than 1")
    if distance not in get_args(Distance):
        known = ", ".join(get_args(Distance))
        raise ProblemError(f"distance is {distance!r}, expected one of {known}")


class LocalRows(NamedTuple):
    """``||G v - g||^2``, the squared distance near a point up to a constant."""

    G: Matrix
    g: Vector


@brief
@dataclass(frozen=True, slots=True, eq=False)
class QuadraticDistance:
    """``||G u - g||``, the same rows everywhere; zero at the nominal robot."""

    G: Matrix
    g: Vector
    nominal: Vector

    def squared(self, u: Vector) -> float:
        """Return the squared distance of a point."""
        return float(np.sum((self.G @ u - self.g) ** 2))

    def local(self, u: Vector) -> LocalRows:
        """Return the rows near `u`."""
        return LocalRows(self.G, self.g)


@dataclass(frozen=True, slots=True, eq=False)
class Along:
    """The entropic distance along a step: eigenvalues are ``1 + t rates`` of before.

    Parameters
    ----------
    rates : ndarray, shape (links, 4)
    trace : float
        Change of the whitened pseudo-inertias' traces along the step.
    drive, moves : ndarray
        Drive terms, and their change along the step.
    """

    rates: Array
    trace: float
    drive: Vector
    moves: Vector

    def slope(self, t: float) -> float:
        """Return the derivative of the squared distance, inside the cone."""
        bodies = self.trace - float(np.sum(self.rates / (1.0 + t * self.rates)))
        drive = float(self.moves @ (self.drive + t * self.moves))
        return 2.0 * (bodies + drive)

    def furthest(self, kept: float) -> float:
        """Return the largest share of the step, at most one, with large eigenvalues.

        None falls below `kept` times its value before.
        """
        fastest = float(self.rates.min())
        return min(1.0, (1.0 - kept) / -fastest) if fastest < 0.0 else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class EntropicDistance:
    """Twice the log-det divergence of all links, and drive terms squared.

    Parameters
    ----------
    whitened : ndarray, shape (links, 10, 4, 4)
        ``S_k(u) = sum_i u_ki whitened_ki``.
    nominal : ndarray, shape (parameters,)
    """

    whitened: Array
    nominal: Vector

    def squared(self, u: Vector) -> float:
        """Return the squared distance; infinite where a link is not consistent."""
        S = self._bodies(u)
        values = np.linalg.eigvalsh(S)
        if values.min() <= _THINNEST * max(values.max(), 1.0):
            return np.inf
        divergence = float(np.sum(values - np.log(values) - 1.0))
        return 2.0 * divergence + float(np.sum(u[10 * len(S) :] ** 2))

    def local(self, u: Vector) -> LocalRows:
        """Return the rows of the second-order expansion at `u`, where it is finite."""
        S = self._bodies(u)
        n = len(S)
        G = np.eye(len(u))
        g = np.zeros(len(u))
        for k, (body, basis) in enumerate(zip(S, self.whitened, strict=True)):
            values, vectors = np.linalg.eigh(body)
            root = (vectors / np.sqrt(values)) @ vectors.T
            own = slice(10 * k, 10 * k + 10)
            # G^T (G u - g) = G^T svec(S - 1) is the gradient tr W_i - tr S^-1 W_i.
            G[own, own] = svec(root @ basis @ root).T
            g[own] = svec(2.0 * np.eye(4) - body)
        g[10 * n :] = 0.0
        return LocalRows(G, g)

    def along(self, u: Vector, step: Vector) -> "Along":
        """Return the distance along a step from `u`."""
        n = 10 * len(self.whitened)
        S, change = self._bodies(u), self._bodies(step)
        values, vectors = np.linalg.eigh(S)
        root = (vectors / np.sqrt(values)[:, None]) @ np.swapaxes(vectors, 1, 2)
        return Along(
            rates=np.linalg.eigvalsh(root @ change @ root),
            trace=float(np.trace(change, axis1=1, axis2=2).sum()),
            drive=u[n:],
            moves=step[n:],
        )

    def _bodies(self, u: Vector) -> Array:
        n = len(self.whitened)
        links = u[: 10 * n].reshape(n, 10)
        return np.asarray(np.einsum("ki,kiab->kab", links, self.whitened))


NominalDistance = QuadraticDistance | EntropicDistance


def nominal_distance(
    model: TorqueModel, distance: Distance, unit: Vector
) -> NominalDistance:
    """Return the distance for variables ``u = x / unit``.

    Parameters
    ----------
    distance : {"pullback", "euclidean", "entropic"}
    unit : ndarray, shape (parameters,)
        Typical sizes of all parameters; the distance of drive terms uses them, too.
    """
    layout, inertial = model.layout, model.layout.inertial_size
    nominal, bodies = nominal_point(model, unit), reference_bodies(model.robot)
    if distance == "entropic":
        links = unit[:inertial].reshape(-1, 10)
        whitened = np.array(
            [
                size[:, None, None] * _whitened(body)
                for body, size in zip(bodies, links, strict=True)
            ]
        )
        return EntropicDistance(whitened, nominal)
    G = np.diag(1.0 / unit)
    if distance == "pullback":
        for k, body in enumerate(bodies):
            own = layout.link_slice(k)
            G[own, own] = svec(_whitened(body)).T
    else:
        G[:inertial, :inertial] = np.diag(1.0 / link_scales(model.robot).units)
    g = G[:, :inertial] @ bodies.ravel()
    return QuadraticDistance(G * unit, g, nominal)


def nominal_point(model: TorqueModel, unit: Vector) -> Vector:
    """Return the nominal robot, without friction or drives, as ``u = x / unit``."""
    bodies = reference_bodies(model.robot).ravel()
    return np.append(bodies, np.zeros(len(unit) - len(bodies))) / unit


def pullback_distance(x: Vector, reference: Array) -> float:
    """Return ``||J0^-1/2 (J(x) - J0) J0^-1/2||_F`` of one link's ten parameters."""
    return float(np.linalg.norm(svec(_whitened(reference)).T @ (x - reference)))


def _whitened(body: Vector) -> Array:
    """Return ``J0^-1/2 E_i J0^-1/2`` for the ten unit parameters, shape (10, 4, 4)."""
    values, vectors = np.linalg.eigh(pseudo_inertia(body))
    root = (vectors / np.sqrt(values)) @ vectors.T
    return np.asarray(root @ PSEUDO_INERTIA_BASIS @ root)
