"""What is known of a robot before any measurement, as convex sets.

There is one small value per idea.  Each lowers itself to a `ConicSet` over the
parameters of a torque model; any number of them combine.
"""

from consistent_id.constraints.datasheet import (
    CentreOfMassBoxes,
    FixedBodies,
    FixedCentresOfMass,
    FixedMasses,
    MassBounds,
    PhysicalConsistency,
)
from consistent_id.constraints.motors import EqualMotors, Motor, RotorInertias
from consistent_id.constraints.parameter_constraints import (
    FixedParameters,
    LinearRelation,
    NonNegativeDrive,
    ParameterBounds,
    SharedMotors,
)
from consistent_id.constraints.rows import Constraint, lowered
from consistent_id.constraints.shape import CentreOfMassIn, DensityOn
from consistent_id.constraints.symmetry import EqualLinks, SymmetricLink, TotalMass
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
    "MassBounds",
    "Motor",
    "NonNegativeDrive",
    "ParameterBounds",
    "PhysicalConsistency",
    "Polytope",
    "RotorInertias",
    "SharedMotors",
    "SymmetricLink",
    "TotalMass",
    "lowered",
    "mesh_vertices",
]
