"""A choice as a torque model with its constraints, ready to be fitted to any fold."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.constraints import lowered
from consistent_id.constraints.cones.quadratic import minimisers
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.distances import nominal_distance
from consistent_id.problems.constraints import constraints_of
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.model import described, drive_of
from consistent_id.problems.selection.choice import Choice, applied
from consistent_id.problems.selection.factors import Factors, JointFactors, Key
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import link_scales

_WEIGHT = 1e-4
"""Of the squared distance to nominal, in units of the residual: a distance of one costs
about one unit of chi squared with some ten thousand rows, or a tenth with a thousand.
It settles what data leave open and moves nothing else."""

RATES = (-3, -2)
"""Columns of `candidate_columns`: the rates of Coulomb friction and of the torque."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A torque model and the set that its parameters lie in.

    Parameters
    ----------
    model : TorqueModel
    keys : tuple of Key
        Of the drive parameters, in the layout's order.
    domain : ConicSet
        In original units.
    nonnegative : ndarray of bool, shape (drive parameters,)
        Which of them the constraints keep from being negative.
    """

    model: TorqueModel
    keys: tuple[Key, ...]
    domain: ConicSet
    nonnegative: BoolArray


def candidate_of(
    choice: Choice, table: ProblemTable, folder: Path, bodies: TorqueModel
) -> Candidate:
    """Return a choice as a torque model with constraints.

    Raises
    ------
    ProblemError
        If the choice contradicts itself or the file's constraints.
    """
    table = applied(table, choice, bodies.robot)
    model = drive_of(table, described(bodies.robot, table))
    domain = lowered(constraints_of(table.constraints, folder, table.joints), model)
    size = model.layout.inertial_size
    owners_names = model.layout.drive
    keys = tuple(
        Key(owner, name, term)
        for (owner, name), term in zip(owners_names, model.column_terms, strict=True)
    )
    low, _ = domain.box
    return Candidate(model, keys, domain, low[size:] >= 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class FoldFits:
    """A candidate fitted to what is left when each fold is left out.

    Parameters
    ----------
    candidate : Candidate
    parameters : ndarray, shape (folds, parameters)
    """

    candidate: Candidate
    parameters: Matrix


def fitted(
    candidate: Candidate, factors: Factors, sigma: Vector, size: float
) -> FoldFits:
    """Fit a candidate under its constraints, one fold after another left out.

    Parameters
    ----------
    candidate : Candidate
    factors : Factors
    sigma : ndarray, shape (torque joints,), [N m or N]
        By which joints' rows are divided.
    size : float
        Misfit that counts as one, for the prior's sake.

    Raises
    ------
    SolverError
        If the solver returns no point.
    """
    unit = _units(candidate, factors, sigma)
    distance = nominal_distance(candidate.model, "pullback", unit)
    origin, scales = distance.nominal, np.append(unit, 1.0)
    # About the nominal robot torque is what that leaves, and the prior asks for zero.
    squares = np.zeros((len(factors.joints[0].training), len(scales), len(scales)))
    for joint, s in zip(factors.joints, sigma, strict=True):
        rows = _all_columns(candidate, joint) * (scales / (s * size))
        rows[:, :, -1] -= rows[:, :, :-1] @ origin
        squares += rows.transpose(0, 2, 1) @ rows
    G = distance.local(origin).G
    P = squares[:, :-1, :-1] + _WEIGHT * G.T @ G
    domain = candidate.domain.normalised(unit).moved(origin)
    steps = minimisers(P, -squares[:, :-1, -1], domain)
    return FoldFits(candidate, (origin + steps) * unit)


def _units(candidate: Candidate, factors: Factors, sigma: Vector) -> Vector:
    """Return typical sizes: of bodies, and of what alone would give the torque."""
    squares = np.zeros(len(candidate.keys))
    torque = 0.0
    for joint, s in zip(factors.joints, sigma, strict=True):
        own = [joint.places.get(key, -2) for key in candidate.keys]
        for R in joint.cells:
            norms = np.sum(R**2, axis=0) / s**2
            torque += float(norms[-1])
            squares += [norms[place] if place >= 0 else 0.0 for place in own]
    norms = np.sqrt(squares)
    drive = np.where(norms > 0.0, np.sqrt(torque) / np.where(norms > 0, norms, 1), 1.0)
    return np.concatenate([link_scales(candidate.model.robot).units, drive])


def _all_columns(candidate: Candidate, joint: JointFactors) -> Array:
    """Return all parameters' columns and torque, without each fold in turn."""
    R, kept = joint.training, len(joint.expand)
    first = candidate.model.layout.inertial_size
    own = np.zeros((*R.shape[:2], len(candidate.model.layout) + 1))
    own[:, :, :first] = R[:, :, :kept] @ joint.expand
    for i, key in enumerate(candidate.keys, start=first):
        if key in joint.places:
            own[:, :, i] = R[:, :, joint.places[key]]
    own[:, :, -1] = R[:, :, -1]
    return own


def candidate_columns(
    candidate: Candidate, joint: JointFactors, R: Matrix, base: BaseParameters
) -> Matrix:
    """Return base columns, drive columns, rates and torque of rows.

    Parameters
    ----------
    candidate : Candidate
    joint : JointFactors
    R : ndarray
        A factor of the joint's.
    base : BaseParameters
        Of the bodies.
    """
    independent, kept = list(base.independent), len(joint.expand)
    first = len(independent)
    own = np.zeros((len(R), first + len(candidate.keys) + 3))
    own[:, :first] = R[:, :kept] @ joint.expand[:, independent]
    for i, key in enumerate(candidate.keys, start=first):
        if key in joint.places:
            own[:, i] = R[:, joint.places[key]]
    own[:, -3:] = R[:, -3:]
    return own
