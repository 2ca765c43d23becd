"""Fits of a choice to each fold, from triangular factors of all columns of blocks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.constraints import lowered
from consistent_id.constraints.cones.repeated import minimisers
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.priors import nominal_distance
from consistent_id.problems.constraints import constraints_of
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.selection.choice import Choice, applied
from consistent_id.problems.selection.samples import (
    EDGES,
    NUMBERS,
    SampledPart,
    Samples,
    folds,
    left_out,
)
from consistent_id.problems.stated_model import described, drive_of
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.drive.gear_coupling import GearCoupling, coupled_joints
from consistent_id.regression.drive.laws import direction
from consistent_id.regression.drive.term import DriveTerm, JointSamples, term_columns
from consistent_id.regression.linear import extended, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import row_structure
from consistent_id.robot.scaling import link_scales

_WEIGHT = 1e-4
"""Weight of the squared distance to nominal, in units of the residual.  A distance of
one costs about one unit of chi squared with ten thousand rows, or a tenth with a
thousand. It determines parameters that the data do not determine, and hardly moves the
others.
"""

RATES = (-3, -2)
"""Columns of `candidate_columns`: the rates of Coulomb friction and of the torque."""

UNSEEN = 1e-12
"""Size of a drive column over that of the torque below which the column counts as zero,
such as a Stribeck term of a joint that is never slow: its parameter would have to be
1e12.
"""

_TIED = 1e-5
"""Relative change of a block's squared error above which the block counts as won or
lost. Smaller changes are the solver's rounding, or the block has no rows.
"""


class Key(NamedTuple):
    """A drive column: joint or coupling, coefficient, and law with its shapes."""

    owner: str
    name: str
    term: DriveTerm


@dataclass(frozen=True, eq=False)
class JointFactors:
    """The rows of one joint: bodies' and drive columns, rates, torque.

    Rates are those of Coulomb friction and of the torque, [1/s] and [N m/s or N/s].

    Parameters
    ----------
    expand : ndarray, shape (bodies' columns, 10 links)
        Map from the kept inertial columns to all of them.
    places : mapping of Key to int
        Places of drive columns.
    cells : ndarray, shape (cells, rows, columns)
        Triangular factor of each cell; short ones are filled up with rows of zeros.
    """

    expand: Matrix
    places: Mapping[Key, int]
    cells: Array

    @cached_property
    def training(self) -> Array:
        """For each fold, the factor of the rows outside it, as `cells` are."""
        before, after = _cumulated(self.cells), _cumulated(self.cells[::-1])
        outside = []
        for _, out in folds():
            parts = before[out[0]], after[len(self.cells) - 1 - out[-1]]
            outside.append(reduce(_joined, [R for R in parts if R is not None]))
        return np.array(outside)


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """Factors of all torque joints, and the number of rows in each cell."""

    joints: tuple[JointFactors, ...]
    counts: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class JointColumns:
    """The columns of one joint's rows, but for the torque and its rate.

    Parameters
    ----------
    expand : ndarray, shape (bodies' columns, 10 links)
        Map from the kept inertial columns to all of them.
    keys : tuple of Key
        Keys of drive columns.
    values : ndarray, shape (columns, rows)
        The last one is the rate of Coulomb friction.
    """

    expand: Matrix
    keys: tuple[Key, ...]
    values: Matrix


def columns_of(
    bodies: TorqueModel,
    samples: Samples,
    terms: Sequence[Sequence[DriveTerm]],
    couplings: Sequence[GearCoupling],
    *,
    widths: Sequence[float],
    band: float,
) -> tuple[JointColumns, ...]:
    """Return the columns of all torque joints.

    Parameters
    ----------
    bodies : TorqueModel
        The model without drive terms.
    terms : sequence of sequence of DriveTerm
        Drive terms of each of the robot's joints.
    widths : sequence of float, [rad/s or m/s]
        Width of friction's change of sign of each of the robot's joints.
    band : float, [Hz]
        Band in which torque is predicted.
    """
    found = []
    for row, (name, (places, expand)) in enumerate(
        zip(bodies.torque_joints, row_structure(bodies), strict=True)
    ):
        width = widths[bodies.robot.joint_names.index(name)]
        own = _OwnColumns(bodies, row, name, terms, couplings, width, band)
        drive = samples.filtered(row, own.along)
        values = np.concatenate([samples.inertial[row][places], drive.T])
        found.append(JointColumns(expand, own.keys, values))
    return tuple(found)


def factors_of(columns: Sequence[JointColumns], samples: Samples) -> Factors:
    """Compress rows to triangular factors.

    Parameters
    ----------
    samples : Samples
        Their torque may be delayed.
    """
    number = len(EDGES) - 1
    where = [np.flatnonzero(samples.cell == place) for place in range(number)]
    joints = []
    for row, own in enumerate(columns):
        ends = [samples.torque_rate[:, row], samples.torque[:, row]]
        joints.append(_joint_factors(own, np.vstack([own.values, *ends]), where))
    return Factors(tuple(joints), np.array([len(rows) for rows in where]))


@dataclass(frozen=True, slots=True, eq=False)
class _OwnColumns:
    """The drive columns of one joint's row; the last column is a rate.

    The rate is how fast Coulomb friction changes within the band, [1/s].
    """

    bodies: TorqueModel
    row: int
    name: str
    terms: Sequence[Sequence[DriveTerm]]
    couplings: Sequence[GearCoupling]
    width: float
    band: float

    @property
    def _joint(self) -> int:
        return self.bodies.robot.joint_names.index(self.name)

    @property
    def _pairs(self) -> list[tuple[GearCoupling, tuple[int, int]]]:
        """Couplings of the joint, and both joints of each."""
        own = [c for c in self.couplings if self.name in (c.first, c.second)]
        return [(c, coupled_joints(self.bodies.robot, c)) for c in own]

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of all columns but the last."""
        found = [
            Key(coupling.label, label, term)
            for coupling, _ in self._pairs
            for label, term in zip(
                coupling.names,
                (term for term in coupling.terms for _ in term.names),
                strict=True,
            )
        ]
        own = self.terms[self._joint]
        return (*found, *(Key(self.name, n, term) for term in own for n in term.names))

    def along(self, part: SampledPart) -> list[Vector]:
        """Return the columns along all samples of a part."""
        along, j = part.motion.along, self._joint
        found = []
        for coupling, pair in self._pairs:
            rates = [along.dq[:, i] for i in pair], [along.ddq[:, i] for i in pair]
            found += [both[pair.index(j)] for both in coupling.columns(*rates)]
        carried = None if part.load is None else part.load[:, self.row]
        q, dq, ddq = (x[:, j] for x in (along.q, along.dq, along.ddq))
        motion = JointSamples(q, dq, ddq, carried)
        for term in self.terms[j]:
            found += list(term_columns(term, motion))
        half = 0.25 / self.band
        ahead, behind = (direction(dq + h * ddq, self.width) for h in (half, -half))
        return [*found, np.asarray((ahead - behind) / (2.0 * half))]


def _joint_factors(
    own: JointColumns, columns: Matrix, where: Sequence[IntArray]
) -> JointFactors:
    """Return the factors of columns in the rows of each cell."""
    cells = np.zeros((len(where), len(columns), len(columns)))
    for cell, rows in zip(cells, where, strict=True):
        R = triangle(np.take(columns, rows, axis=1).T)
        cell[: len(R)] = R
    places = {key: len(own.expand) + i for i, key in enumerate(own.keys)}
    return JointFactors(own.expand, places, cells)


def _cumulated(cells: Array) -> list[Matrix | None]:
    """Return the joint factors of the first 0, 1, 2, ... cells, but not of all."""
    return [None, *accumulate(cells[:-1], _joined)]


def _joined(first: Matrix, second: Matrix) -> Matrix:
    return extended(np.array(first, order="F"), np.array(second, order="F"))


@dataclass(frozen=True, slots=True, eq=False)
class CandidateModel:
    """A torque model and the set that its parameters lie in.

    Parameters
    ----------
    model : TorqueModel
    keys : tuple of Key
        Keys of the drive parameters, in the layout's order.
    domain : ConicSet
        The set, in original units.
    nonnegative : ndarray of bool, shape (drive parameters,)
        True for parameters that the constraints keep from being negative.
    """

    model: TorqueModel
    keys: tuple[Key, ...]
    domain: ConicSet
    nonnegative: BoolArray


def candidate_of(
    choice: Choice, table: ProblemTable, folder: Path, bodies: TorqueModel
) -> CandidateModel:
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
    keys = tuple(
        Key(*place, term)
        for place, term in zip(model.layout.drive, model.column_terms, strict=True)
    )
    low, _ = domain.box
    return CandidateModel(model, keys, domain, low[size:] >= 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class FoldFits:
    """A candidate, fitted without each fold in turn.

    Parameters
    ----------
    candidate : CandidateModel
    parameters : ndarray, shape (folds, parameters)
    """

    candidate: CandidateModel
    parameters: Matrix


def fitted(
    candidate: CandidateModel, factors: Factors, sigma: Vector, size: float
) -> FoldFits:
    """Fit a candidate under its constraints, one fold after another left out.

    Parameters
    ----------
    candidate : CandidateModel
    factors : Factors
    sigma : ndarray, shape (torque joints,), [N m or N]
        Scale of each joint's rows, by which they are divided.
    size : float
        Misfit that counts as one when the prior's weight is set.

    Raises
    ------
    SolverError
        If the solver returns no point.
    """
    unit = _units(candidate, factors, sigma)
    distance = nominal_distance(candidate.model, "pullback", unit)
    origin, scales = distance.nominal, np.append(unit, 1.0)
    # Parameters are differences from the nominal robot's, so the prior's goal is zero.
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


def _units(candidate: CandidateModel, factors: Factors, sigma: Vector) -> Vector:
    """Return typical sizes of bodies, and sizes of drive terms that give all torque."""
    squares = np.zeros(len(candidate.keys))
    torque = 0.0
    for joint, s in zip(factors.joints, sigma, strict=True):
        own = [joint.places.get(key, -2) for key in candidate.keys]
        for R in joint.cells:
            norms = np.sum(R**2, axis=0) / s**2
            torque += float(norms[-1])
            squares += [norms[place] if place >= 0 else 0.0 for place in own]
    norms = np.sqrt(squares)
    seen = norms > UNSEEN * np.sqrt(torque)
    drive = np.where(seen, np.sqrt(torque) / np.where(seen, norms, 1.0), 1.0)
    return np.concatenate([link_scales(candidate.model.robot).units, drive])


def _all_columns(candidate: CandidateModel, joint: JointFactors) -> Array:
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
    candidate: CandidateModel, joint: JointFactors, R: Matrix, base: BaseParameters
) -> Matrix:
    """Return base columns, drive columns, rates and torque of rows.

    Parameters
    ----------
    candidate : CandidateModel
    joint : JointFactors
    R : ndarray
        One of the joint's factors.
    base : BaseParameters
        Base parameters of the bodies.
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


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Squared torque errors of each fold and joint, each joint's over its own scale.

    Parameters
    ----------
    squares : ndarray, shape (folds, torque joints)
    """

    squares: Matrix

    @property
    def blocks(self) -> Vector:
        """Squared error on each block."""
        return np.asarray(self.squares.sum(axis=1))

    @property
    def total(self) -> float:
        """Squared error over all blocks, averaged over the numbers of blocks."""
        return float(self.squares.sum()) / len(NUMBERS)


@dataclass(frozen=True, slots=True)
class Gain:
    """The gain of one choice over another.

    Parameters
    ----------
    share : float
        Relative decrease of the squared error.
    error : float
        Its standard error, from the blocks.
    won : float
        Among the blocks on which the error differs, the share on which it is smaller.
    """

    share: float
    error: float
    won: float


def gain(before: HeldOut, after: HeldOut) -> Gain:
    """Return the gain of the second over the first, on the same rows."""
    return _gain(before.blocks, after.blocks)


def joint_gains(before: HeldOut, after: HeldOut) -> tuple[Gain, ...]:
    """Return the same for each torque joint's own squared error."""
    pairs = zip(before.squares.T, after.squares.T, strict=True)
    return tuple(_gain(first, second) for first, second in pairs)


def _gain(before: Vector, after: Vector) -> Gain:
    """Return the gain between two errors on each fold."""
    less = before - after
    starts = np.cumsum((0, *NUMBERS))
    variances = [
        n * float(np.var(less[a : a + n], ddof=1))
        for n, a in zip(NUMBERS, starts[:-1], strict=True)
    ]
    error = float(np.mean(np.sqrt(variances)))
    total = max(float(before.sum()) / len(NUMBERS), 1e-300)
    share = float(less.sum()) / len(NUMBERS) / total
    decided = less[abs(less) > _TIED * total]
    won = float(np.mean(decided > 0.0)) if len(decided) else 0.0
    return Gain(share, error / total, won)


def held_out(fits: FoldFits, factors: Factors, sigma: Vector) -> HeldOut:
    """Return the errors of each fit on the fold that was left out of it."""
    return HeldOut(
        np.column_stack(
            [
                joint_errors(fits.candidate, fits.parameters, joint) / s**2
                for joint, s in zip(factors.joints, sigma, strict=True)
            ]
        )
    )


def joint_errors(candidate: CandidateModel, x: Matrix, joint: JointFactors) -> Vector:
    """Return a joint's squared error on each fold, `x` of shape (folds, parameters)."""
    z = own_parameters(candidate, x, joint)
    squares = np.sum((joint.cells @ z.T) ** 2, axis=1)
    return np.asarray(np.sum(squares.T, axis=1, where=left_out()))


def own_parameters(candidate: CandidateModel, x: Matrix, joint: JointFactors) -> Array:
    """Return ``[x, -1]`` of each fold in the columns of a joint's factors."""
    size = candidate.model.layout.inertial_size
    kept = len(joint.expand)
    z = np.zeros((len(x), joint.cells[0].shape[1]))
    z[:, :kept] = x[:, :size] @ joint.expand.T
    for i, key in enumerate(candidate.keys):
        if key in joint.places:
            z[:, joint.places[key]] = x[:, size + i]
    z[:, -1] = -1.0
    return z
