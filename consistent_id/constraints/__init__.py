"""Prior knowledge of a robot as convex sets of parameters.

Each kind of knowledge is a small value.  Each value lowers itself to a `ConicSet` over
the parameters of a torque model; any number of them can be combined.
"""

from consistent_id.constraints.delivered_bodies import LinkCondition, link_conditions
from consistent_id.constraints.links import (
    CentreOfMassBoxes,
    CentreOfMassIn,
    DensityOn,
    EqualLinks,
    FixedBodies,
    FixedCentresOfMass,
    FixedMasses,
    MassBounds,
    PhysicalConsistency,
    SymmetricLink,
    TotalMass,
)
from consistent_id.constraints.parameter_constraints import (
    EqualMotors,
    FixedParameters,
    LinearRelation,
    Motor,
    NonNegativeDrive,
    ParameterBounds,
    RotorInertias,
    SharedMotors,
)
from consistent_id.constraints.priors import Penalty, PointToSet
from consistent_id.constraints.rows import Constraint, lowered
from consistent_id.robot.solids import Ellipsoid, Polytope, mesh_vertices

__all__ = [
    "CentreOfMassBoxes",
    "CentreOfMassIn",
    "Constraint",
    "DensityOn",
    "Ellipsoid",
    "EqualLinks",
    "EqualMotors",
    "FixedBodies",
    "FixedCentresOfMass",
    "FixedMasses",
    "FixedParameters",
    "LinearRelation",
    "LinkCondition",
    "MassBounds",
    "Motor",
    "NonNegativeDrive",
    "ParameterBounds",
    "Penalty",
    "PhysicalConsistency",
    "PointToSet",
    "Polytope",
    "RotorInertias",
    "SharedMotors",
    "SymmetricLink",
    "TotalMass",
    "link_conditions",
    "lowered",
    "mesh_vertices",
]
