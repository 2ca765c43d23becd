"""What robots of one type share, and what each has of its own.

Links, rotor inertias, springs and coupled gears are of the type.  Friction and offsets
are each robot's own.  Own terms of a joint are in that joint's rows alone, so that a
robot's own parameters are eliminated joint by joint.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import ProblemError
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import TorqueModel

OF_THE_TYPE = ("rotor_inertia", "spring")
"""Drive terms that robots of one type share: masses and springs that were built in."""


@dataclass(frozen=True, eq=False)
class FleetModel:
    """A torque model, and its parts that are shared and each robot's own.

    Parameters
    ----------
    whole : TorqueModel
        Of one robot.
    shared : TorqueModel
        Without own terms.
    common : ndarray of int
        Parameters of `whole` that `shared` has, in its order.
    own : tuple of ndarray of int
        Parameters of `whole` that are a robot's own, by torque joint.
    base : BaseParameters
        Of `whole`.
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
        If no term is a robot's own; then recordings of all robots are those of one.
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
            "no friction or offset is a robot's own: give [drive] terms, or identify "
            "all recordings as those of one robot"
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
                f"fleet: {labels[owns[0]]} ties friction or offsets to other "
                "parameters; robots of a fleet have those joint by joint"
            )
        pieces.append(of_joints)
    return tuple(
        OwnSet(*equal, *at_most) for equal, at_most in zip(*pieces, strict=True)
    )
