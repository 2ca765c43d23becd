"""Parameters that robots of one type share, and each robot's own.

Of a joint's rows ``[Y_o Y_s tau]`` let ``U`` span the own columns.  The part that the
own parameters explain, ``U^T [Y_o Y_s tau]``, is stored in as many rows as there are
own parameters; the rest, orthogonal to ``U``, is an ordinary regression of the shared
parameters.  The sum of both squares is that of the whole, for all parameters. Robots'
parts are on disk, not in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.singular import lstsq, pinv, svd
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise

OF_THE_TYPE = ("rotor_inertia", "spring")
"""Drive terms that robots of one type share: rotors and springs."""

_RANK = 1e-10  # relative singular value that is rounding
_SILENT = 1e-12  # norm of a column, relative to the largest, that is rounding
_ROUNDING = 1e-9  # relative violation that is


@dataclass(frozen=True, eq=False)
class FleetModel:
    """A torque model, and its parts that are shared and each robot's own.

    Parameters
    ----------
    whole : TorqueModel
        Model of one robot.
    shared : TorqueModel
        Without own terms.
    common : ndarray of int
        Parameters of `whole` that `shared` has, in its order.
    own : tuple of ndarray of int
        Parameters of `whole` that are a robot's own, by torque joint.
    base : BaseParameters
        Base parameters of `whole`.
    """

    whole: TorqueModel
    shared: TorqueModel
    common: IntArray
    own: tuple[IntArray, ...]
    base: BaseParameters

    def parameters(self, shared: Vector, own: Sequence[Vector]) -> Vector:
        """Return one robot's parameters."""
        x = np.zeros(len(self.whole.layout))
        x[self.common] = shared
        for columns, values in zip(self.own, own, strict=True):
            x[columns] = values
        return x


def fleet_model(model: TorqueModel) -> FleetModel:
    """Take a torque model apart.

    Raises
    ------
    ProblemError
        If no term is a robot's own; then all recordings are those of one robot.
    """
    drive = tuple(
        DriveTerms(terms=[t for t in of_joint.terms if set(t.names) <= {*OF_THE_TYPE}])
        for of_joint in model.terms
    )
    shared = TorqueModel(
        model.robot, drive, couplings=model.couplings, torque_joints=model.torque_joints
    )
    index = {name: i for i, name in enumerate(model.layout.names)}
    common = np.array([index[name] for name in shared.layout.names])
    inertial = model.layout.inertial_size
    own = tuple(
        np.array(
            [
                inertial + i
                for i, (owner, _) in enumerate(model.layout.drive)
                if owner == joint and inertial + i not in common
            ],
            dtype=np.intp,
        )
        for joint in model.torque_joints
    )
    if not any(len(columns) for columns in own):
        raise ProblemError(
            "robots have no friction or offset of their own: give [drive] terms, or "
            "identify all recordings as those of one robot"
        )
    return FleetModel(model, shared, common, own, base_parameters(model))


@dataclass(frozen=True, eq=False)
class GivenSet:
    """Constraints that have been lowered already."""

    rows: ConicSet

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the set."""
        return self.rows


@dataclass(frozen=True, eq=False)
class OwnSet:
    """``A_eq y = b_eq`` and ``A_in y <= b_in`` of one joint's own parameters."""

    A_eq: Matrix
    b_eq: Vector
    A_in: Matrix
    b_in: Vector


def shared_constraints(
    fleet: FleetModel, constraints: Sequence[Constraint]
) -> tuple[Constraint, ...]:
    """Return the constraints on what is shared."""
    own = np.concatenate(fleet.own)
    found: list[Constraint] = []
    for constraint in constraints:
        whole = constraint.lower(fleet.whole)
        touched = [abs(A[:, own]).any(axis=1) for A in (whole.A_eq, whole.A_in)]
        if not np.concatenate(touched).any():
            found.append(constraint)
            continue
        equal, at_most = (np.flatnonzero(~rows) for rows in touched)
        rest = ConicSet(
            whole.A_eq[np.ix_(equal, fleet.common)],
            whole.b_eq[equal],
            tuple(whole.eq_labels[i] for i in equal),
            whole.A_in[np.ix_(at_most, fleet.common)],
            whole.b_in[at_most],
            tuple(whole.in_labels[i] for i in at_most),
        )
        found.append(GivenSet(rest))
    return tuple(found)


def own_sets(fleet: FleetModel, whole: ConicSet) -> tuple[OwnSet, ...]:
    """Return the constraints on own parameters, joint by joint.

    Raises
    ------
    ProblemError
        If one ties own parameters to shared ones, or to those of another joint.
    """
    every = np.concatenate(fleet.own)
    pieces = []
    for A, b, labels in (
        (whole.A_eq, whole.b_eq, whole.eq_labels),
        (whole.A_in, whole.b_in, whole.in_labels),
    ):
        owns = np.flatnonzero(A[:, every].any(axis=1))
        of_joints = []
        for columns in fleet.own:
            inside = [i for i in owns if not np.delete(A[i], columns).any()]
            owns = np.setdiff1d(owns, inside)
            of_joints.append((A[np.ix_(inside, columns)], b[inside]))
        if len(owns):
            raise ProblemError(
                f"fleet: {labels[owns[0]]} relates friction or offsets to other "
                f"parameters; a fleet needs separate ones for each joint"
            )
        pieces.append(of_joints)
    return tuple(
        OwnSet(*equal, *at_most) for equal, at_most in zip(*pieces, strict=True)
    )


@dataclass(frozen=True, eq=False)
class RobotShare:
    """One robot's part.

    Parameters
    ----------
    shared : Regression
        Regression of the shared parameters, its `sigma` the robot's own noise.
    own : tuple of ndarray, each shape (rank, own + shared + 1)
        ``[A B t]``: the own parameters ``y`` add ``||A y + B x - t||^2`` to the squared
        misfit, joint by joint, [N m or N].
    torque : float, [N m or N]
        Norm of the torque of all joints.
    alone : float, [N m or N]
        Residual norm of least squares of this robot alone.
    level : ndarray, shape (joints,), [N m or N]
        Equivalent white noise of each joint.
    """

    name: str
    shared: Regression
    own: tuple[Matrix, ...]
    torque: float
    alone: float
    level: Vector


def robot_share(name: str, fleet: FleetModel, regression: Regression) -> RobotShare:
    """Take a robot's own parameters out of its regression."""
    sigma = joint_noise(fleet.whole, regression, base=fleet.base)
    factors, own, explained = [], [], []
    for j, mine in enumerate(fleet.own):
        F = regression.factors[j]
        A, B = F[:, mine], F[:, [*fleet.common, -1]]
        U = span(A)
        taken = U.T @ B
        own.append(np.hstack([U.T @ A, taken]))
        factors.append(triangle(np.asfortranarray(B - U @ taken)))
        explained.append(pinv(U.T @ A) @ taken[:, :-1])

    def left(j: int, N: Matrix) -> Matrix:
        return np.asarray(N[:, fleet.common] - N[:, fleet.own[j]] @ explained[j])

    noise = regression.noise
    shared = Regression(
        layout=fleet.shared.layout,
        joints=regression.joints,
        factors=tuple(factors),
        counts=regression.counts,
        sigma=sigma,
        fingerprint=fleet.shared.fingerprint,
        noise=None if noise is None else noise.through(left),
        peaks=regression.peaks,
    )
    counts = np.array(regression.counts, dtype=np.float64)
    columns = [*fleet.base.independent, -1]
    rows = np.vstack([F[:, columns] for F in regression.factors])
    R = triangle(np.asfortranarray(rows))
    return RobotShare(
        name=name,
        shared=shared,
        own=tuple(own),
        torque=float(np.linalg.norm(regression.torque_rms * np.sqrt(counts))),
        alone=float(abs(R[-1, -1])) if len(R) == R.shape[1] else 0.0,
        level=sigma * np.sqrt(regression.correlation),
    )


def span(A: Matrix) -> Matrix:
    """Return orthonormal columns that span those of a matrix, up to rounding."""
    norms = np.linalg.norm(A, axis=0)
    heard = norms > _SILENT * norms.max(initial=0.0)
    U, s, _ = svd(A[:, heard] / norms[heard], full_matrices=False)
    return U[:, s > DATA_RANK_TOLERANCE * s.max(initial=1e-300)]


@dataclass(frozen=True, eq=False)
class OwnFit:
    """A joint's own parameters, and which of their bounds hold them.

    Parameters
    ----------
    values : ndarray, shape (own,)
    bound : tuple of int
        Rows of ``A_in y <= b_in`` that are reached and would be passed.
    """

    values: Vector
    bound: tuple[int, ...]


def own_fit(rows: Matrix, shared: Vector, limits: OwnSet) -> OwnFit:
    """Return the own parameters that fit best beside given shared ones.

    A convex programme with a handful of rows: the first set of them that satisfies the
    optimality conditions is the answer.

    Parameters
    ----------
    rows : ndarray, shape (rank, own + shared + 1)
        See `RobotShare.own`.
    shared : ndarray, shape (shared,)

    Raises
    ------
    InfeasibleError
        If no own parameters satisfy the limits.
    """
    size = rows.shape[1] - len(shared) - 1
    A, t = rows[:, :size], rows[:, -1] - rows[:, size:-1] @ shared
    for number in range(min(size, len(limits.b_in)) + 1):
        for bound in combinations(range(len(limits.b_in)), number):
            y0, Z = _held(limits, bound)
            y = y0 + Z @ lstsq(A @ Z, t - A @ y0, _RANK)
            inside = limits.A_in @ y - limits.b_in <= _ROUNDING * (1.0 + abs(y).max())
            if inside.all() and _pushed(A.T @ (A @ y - t), limits, bound):
                return OwnFit(y, bound)
    raise InfeasibleError("no friction and offsets of a joint satisfy the constraints")


def bound_rows(rows: Matrix, shared: int, limits: OwnSet, fit: OwnFit) -> Matrix:
    """Return the part that own parameters at their bounds do not explain.

    Returns
    -------
    ndarray, shape (any, shared + 1)
        Rows of the shared parameters and torque.
    """
    size = rows.shape[1] - shared - 1
    y0, Z = _held(limits, fit.bound)
    U = span(rows[:, :size] @ Z)
    rest = rows[:, size:].copy()
    rest[:, -1] -= rows[:, :size] @ y0
    return np.asarray(rest - U @ (U.T @ rest))


def _held(limits: OwnSet, bound: tuple[int, ...]) -> tuple[Vector, Matrix]:
    """Return a point at the bounds, and the steps along them, as columns."""
    E = np.vstack([limits.A_eq, limits.A_in[list(bound)]])
    e = np.append(limits.b_eq, limits.b_in[list(bound)])
    U, s, Vt = svd(E)
    rank = int((s > _RANK).sum())
    y0 = Vt[:rank].T @ ((U[:, :rank].T @ e) / s[:rank])
    return y0, Vt[rank:].T


def _pushed(gradient: Vector, limits: OwnSet, bound: tuple[int, ...]) -> bool:
    """Return whether the misfit would fall beyond each bound, not inside it."""
    if not bound:
        return True
    E = np.vstack([limits.A_eq, limits.A_in[list(bound)]])
    pulls = lstsq(E.T, -gradient, _RANK)[len(limits.b_eq) :]
    return bool((pulls >= -_ROUNDING * (1.0 + abs(gradient).max())).all())


def write_share(path: Path, share: RobotShare) -> None:
    """Write the regression of a robot's part."""
    regression, noise = share.shared, share.shared.noise
    arrays = {f"factor{j}": F for j, F in enumerate(regression.factors)}
    if noise is not None:
        arrays |= {f"scores{j}": N for j, N in enumerate(noise.scores)}
        arrays |= {f"shared{j}": N for j, N in enumerate(noise.shapes)}
        arrays["effective"] = noise.effective
        arrays["freedom"] = noise.freedom
        arrays["blocks"] = np.array(noise.beyond)
    np.savez(
        path,
        counts=np.array(regression.counts),
        sigma=regression.sigma,
        peaks=regression.peaks,
        **arrays,  # type: ignore[arg-type]
    )


def read_share(path: Path, fleet: FleetModel) -> Regression:
    """Read what `write_share` wrote."""
    joints = fleet.shared.torque_joints
    with np.load(path) as file:
        noise = None
        if "effective" in file:
            scores, shapes = (
                tuple(
                    file[f"{part}{j}"]
                    for j in range(len(joints))
                    if f"{part}{j}" in file
                )
                for part in ("scores", "shared")
            )
            noise = CorrelatedNoise(
                file["effective"],
                scores,
                file["freedom"],
                float(file["blocks"]),
                shapes,
            )
        return Regression(
            layout=fleet.shared.layout,
            joints=joints,
            factors=tuple(file[f"factor{j}"] for j in range(len(joints))),
            counts=tuple(file["counts"].tolist()),
            sigma=file["sigma"],
            fingerprint=fleet.shared.fingerprint,
            noise=noise,
            peaks=file["peaks"],
        )
