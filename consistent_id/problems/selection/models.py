"""A choice as a torque model with its constraints, ready to be fitted to any fold."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.constraints import lowered
from consistent_id.constraints.cones.least_norm import LeastNorm, solve_least_norm
from consistent_id.constraints.cones.programmes import COARSE
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.distances import nominal_distance
from consistent_id.problems.constraints import constraints_of
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.model import described, drive_of
from consistent_id.problems.selection.choice import Choice, applied
from consistent_id.problems.selection.factors import Factors, JointFactors, Key
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import triangle
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
    candidate: Candidate,
    factors: Factors,
    base: BaseParameters,
    sigma: Vector,
    folds: Sequence[int],
    size: float,
) -> FoldFits:
    """Fit a candidate under its constraints, one fold after another left out.

    Parameters
    ----------
    candidate : Candidate
    factors : Factors
    base : BaseParameters
        Of the bodies.
    sigma : ndarray, shape (torque joints,), [N m or N]
        By which joints' rows are divided.
    folds : sequence of int
        Which ones.
    size : float
        Misfit that counts as one, for the prior's sake.

    Raises
    ------
    SolverError
        If the solver returns no point.
    """
    unit = _units(candidate, factors, sigma)
    distance = nominal_distance(candidate.model, "pullback", unit)
    prior = np.sqrt(_WEIGHT) * np.column_stack(distance.local(distance.nominal))
    domain = candidate.domain.normalised(unit)
    found = []
    for fold in folds:
        R = _stacked(candidate, factors, base, sigma, fold) / size
        G = R[:, :-1] @ _spread(base, candidate)
        rows = np.column_stack([G * unit, R[:, -1]])
        whole = triangle(np.asfortranarray(np.vstack([rows, prior])))
        problem = LeastNorm(whole[:, :-1], whole[:, -1], domain)
        solution = solve_least_norm(problem, tolerance=COARSE, origin=distance.nominal)
        found.append(solution.u * unit)
    return FoldFits(candidate, np.array(found))


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


def _stacked(
    candidate: Candidate,
    factors: Factors,
    base: BaseParameters,
    sigma: Vector,
    fold: int,
) -> Matrix:
    """Return one factor of base columns, drive columns and torque."""
    rows = [
        np.delete(
            candidate_columns(candidate, joint, joint.training[fold], base), RATES, 1
        )
        for joint in factors.joints
    ]
    scaled = [own / s for own, s in zip(rows, sigma, strict=True)]
    return triangle(np.asfortranarray(np.vstack(scaled)))


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


def _spread(base: BaseParameters, candidate: Candidate) -> Matrix:
    """Return base and drive parameters of all parameters."""
    drive = len(candidate.keys)
    P = base.projection
    whole = np.zeros((len(P) + drive, P.shape[1] + drive))
    whole[: len(P), : P.shape[1]] = P
    whole[len(P) :, P.shape[1] :] = np.eye(drive)
    return whole
