"""The tables of constraints and of the prior, turned into values."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from consistent_id.constraints import (
    CentreOfMassBoxes,
    CentreOfMassIn,
    Constraint,
    DensityOn,
    Ellipsoid,
    EqualLinks,
    EqualMotors,
    FixedBodies,
    FixedCentresOfMass,
    FixedMasses,
    FixedParameters,
    LinearRelation,
    MassBounds,
    Motor,
    NonNegativeDrive,
    ParameterBounds,
    PhysicalConsistency,
    Polytope,
    RotorInertias,
    SharedMotors,
    SymmetricLink,
    TotalMass,
    mesh_vertices,
)
from consistent_id.constraints.priors import Penalty, PointToSet, Prior
from consistent_id.errors import ProblemError
from consistent_id.problems.file import JointTable
from consistent_id.problems.parameter_tables import (
    ConstraintsTable,
    PriorTable,
    RelationTable,
    ShapeTable,
)


def constraints_of(
    table: ConstraintsTable, folder: Path, joints: Mapping[str, JointTable]
) -> tuple[Constraint, ...]:
    """Return the constraints of a table; meshes are files in a folder.

    The tables of joints describe their motors.

    Raises
    ------
    ProblemError
        If a relation or a shape is invalid.
    """
    chosen: list[Constraint] = [PhysicalConsistency(table.margin)]
    chosen += _of_bodies(table)
    if table.drive_signs:
        dissipative = table.drive_signs == "dissipative"
        chosen.append(NonNegativeDrive(dissipative=dissipative))
    if table.shared_motors:
        chosen.append(SharedMotors())
    chosen += [EqualMotors(joints) for joints in table.equal_motors]
    motors = _motors(joints)
    if motors and table.rotor_inertias == "datasheet":
        chosen.append(RotorInertias(motors, table.rotor_inertia_tolerance))
    if table.fixed:
        chosen.append(FixedParameters(table.fixed))
    if table.bounds:
        chosen.append(
            ParameterBounds({k: (low, high) for k, (low, high) in table.bounds.items()})
        )
    if table.total_mass is not None:
        total = table.total_mass
        low, high = total if isinstance(total, list) else (total, total)
        chosen.append(TotalMass(low, high))
    chosen += [_relation(relation) for relation in table.relations]
    chosen += [EqualLinks(e.first, e.second, e.mirror) for e in table.equal_links]
    chosen += [SymmetricLink(link, planes) for link, planes in table.symmetric.items()]
    chosen += [
        CentreOfMassIn(s.link, _shape(s, folder)) for s in table.centre_of_mass_in
    ]
    chosen += [DensityOn(s.link, _shape(s, folder)) for s in table.density_on]
    return tuple(chosen)


def prior_of(table: PriorTable, file: Path) -> Prior:
    """Return the prior of a table.

    Raises
    ------
    ProblemError
        If it has both a slack and a weight.
    """
    if table.weight is None:
        return PointToSet(table.slack, table.distance, table.inside)
    if table.slack is not None:
        raise ProblemError(
            f"{file}: [prior] has both slack = {table.slack} and weight = "
            f"{table.weight}; give a slack or a weight, not both"
        )
    return Penalty(table.weight, table.distance, table.inside)


def _of_bodies(table: ConstraintsTable) -> list[Constraint]:
    """Return the constraints on masses and centres of mass, or on whole bodies."""
    if table.bodies == "model":
        return [FixedBodies()]
    chosen: list[Constraint] = []
    if table.known_links:
        chosen.append(FixedBodies(tuple(table.known_links)))
    if table.masses == "datasheet":
        chosen.append(FixedMasses())
    elif table.masses == "bounds":
        chosen.append(MassBounds())
    if table.centres_of_mass == "datasheet":
        chosen.append(FixedCentresOfMass())
    elif table.centres_of_mass == "box":
        chosen.append(CentreOfMassBoxes())
    return chosen


def _motors(joints: Mapping[str, JointTable]) -> dict[str, Motor]:
    """Return the motors that have an inertia, and a gear ratio beside."""
    motors = {}
    for name, joint in joints.items():
        if joint.motor_inertia is None:
            continue
        if joint.gear_ratio is None:
            raise ProblemError(
                f"[joints.{name}]: motor_inertia without gear_ratio; the motor acts "
                f"on the link through its gear: give both"
            )
        motors[name] = Motor(joint.motor_inertia, joint.gear_ratio)
    return motors


def _relation(table: RelationTable) -> LinearRelation:
    low = -np.inf if table.lower is None else table.lower
    high = np.inf if table.upper is None else table.upper
    return LinearRelation(table.terms, low, high)


def _shape(table: ShapeTable, folder: Path) -> Ellipsoid | Polytope:
    shapes = (table.ellipsoid, table.box, table.hull, table.mesh)
    given = [s for s in shapes if s is not None]
    if len(given) != 1:
        raise ProblemError(
            f"shape of link {table.link!r}: {len(given)} shapes, expected one of "
            "ellipsoid, box, hull and mesh"
        )
    if table.ellipsoid is not None:
        return Ellipsoid(
            np.array(table.ellipsoid.centre), np.array(table.ellipsoid.semi_axes)
        )
    if table.box is not None:
        return Polytope.box(*table.box)
    if table.mesh is None:
        return Polytope.hull(np.array(table.hull))
    vertices = mesh_vertices(folder / table.mesh, scale=table.mesh_scale)
    if table.mesh_shape == "ellipsoid":
        return Ellipsoid.around(vertices)
    return Polytope.hull(vertices)
