"""Triangular factors of all columns that a model may have, block by block.

Every model is a selection of columns, every fold a QR of triangles: rows are read once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.problems.selection.blocks import EDGES, folds
from consistent_id.problems.selection.samples import Samples
from consistent_id.regression.drive.coulomb import direction
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive.term import DriveTerm, JointSamples, term_columns
from consistent_id.regression.drive_entries import coupled_joints
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import row_structure
from consistent_id.regression.triangles import extended, triangle


class Key(NamedTuple):
    """A drive column: of a joint or a coupling, a coefficient, its law with shapes."""

    owner: str
    name: str
    term: DriveTerm


@dataclass(frozen=True, slots=True, eq=False)
class JointFactors:
    """The rows of one joint: bodies' and drive columns, rates, torque.

    Rates are those of Coulomb friction and of the torque, [1/s] and [N m/s or N/s].

    Parameters
    ----------
    expand : ndarray, shape (bodies' columns, 10 links)
        How all inertial columns follow from those that are kept.
    places : mapping of Key to int
        Of drive columns.
    cells : ndarray, shape (cells, rows, columns)
        Triangular factor of each cell; below short ones, zeros.
    training : ndarray, shape (folds, rows, columns)
        Of what is left when a fold is left out, for each fold.
    """

    expand: Matrix
    places: Mapping[Key, int]
    cells: Array
    training: Array


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """Factors of all torque joints, and rows behind each cell."""

    joints: tuple[JointFactors, ...]
    counts: IntArray


def factors_of(
    bodies: TorqueModel,
    samples: Samples,
    terms: Sequence[Sequence[DriveTerm]],
    couplings: Sequence[GearCoupling],
    *,
    width: float,
    band: float,
    least_speed: float | None = None,
    load: Vector | None = None,
) -> Factors:
    """Compress rows to triangular factors.

    Parameters
    ----------
    bodies : TorqueModel
        Without drive terms.
    terms : sequence of sequence of DriveTerm
        Of each of the robot's joints.
    width : float, [rad/s or m/s]
        Of friction's change of sign.
    band : float, [Hz]
        In which torque is predicted.
    least_speed : float, optional
        Share of top speed below which rows are left out.
    load : ndarray, shape (10 links,), optional
        Inertial parameters that loads are computed from.
    """
    kept = samples.speed >= (0.0 if least_speed is None else least_speed)
    cell = samples.cell[kept]
    number = len(EDGES) - 1
    coupled = _coupling_columns(bodies, samples, couplings)
    rates = samples.torque_rate
    joints = []
    for row, (name, (places, expand)) in enumerate(
        zip(bodies.torque_joints, row_structure(bodies), strict=True)
    ):
        inertial = samples.inertial[row]
        columns = dict(coupled.get(name, {}))
        columns |= _drive_columns(bodies, samples, name, terms, load, inertial)
        ends = [_friction_rate(bodies, samples, name, width, band)]
        ends += [rates[:, row], samples.torque[:, row]]
        rows = np.column_stack([inertial[places].T, *columns.values(), *ends])[kept]
        joints.append(_joint_factors(rows, cell, number, expand, tuple(columns)))
    return Factors(tuple(joints), np.bincount(cell, minlength=number))


def _joint_factors(
    rows: Matrix, cell: IntArray, number: int, expand: Matrix, keys: tuple[Key, ...]
) -> JointFactors:
    width = rows.shape[1]
    cells = np.zeros((number, width, width))
    for place in range(number):
        R = triangle(np.asfortranarray(rows[cell == place]))
        cells[place, : len(R)] = R
    before, after = _cumulated(cells), _cumulated(cells[::-1])[::-1]
    training = [_joined(before[out[0]], after[out[-1] + 1]) for _, out in folds()]
    places = {key: len(expand) + i for i, key in enumerate(keys)}
    return JointFactors(expand, places, cells, np.array(training))


def _cumulated(cells: Array) -> list[Matrix]:
    """Return the factor of no cell, of the first, of the first two, and so on."""
    return list(accumulate(cells, _joined, initial=np.zeros(cells.shape[1:])))


def _joined(first: Matrix, second: Matrix) -> Matrix:
    return extended(np.array(first, order="F"), np.array(second, order="F"))


def _drive_columns(
    bodies: TorqueModel,
    samples: Samples,
    name: str,
    terms: Sequence[Sequence[DriveTerm]],
    load: Vector | None,
    inertial: Matrix,
) -> dict[Key, Vector]:
    j = bodies.robot.joint_names.index(name)
    carried = None if load is None else load @ inertial
    motion = JointSamples(samples.q[:, j], samples.dq[:, j], samples.ddq[:, j], carried)
    found = {}
    for term in terms[j]:
        values = term_columns(term, motion)
        for coefficient, column in zip(term.names, values, strict=True):
            full = np.broadcast_to(column, (len(samples.q),))
            found[Key(name, coefficient, term)] = full
    return found


def _friction_rate(
    bodies: TorqueModel, samples: Samples, name: str, width: float, band: float
) -> Vector:
    """Return how fast a joint's Coulomb friction changes within the band, [1/s]."""
    j, half = bodies.robot.joint_names.index(name), 0.25 / band
    dq, ddq = samples.dq[:, j], samples.ddq[:, j]
    ahead, behind = (direction(dq + step * ddq, width) for step in (half, -half))
    return np.asarray((ahead - behind) / (2.0 * half))


def _coupling_columns(
    bodies: TorqueModel, samples: Samples, couplings: Sequence[GearCoupling]
) -> dict[str, dict[Key, Vector]]:
    found: dict[str, dict[Key, Vector]] = {}
    names = bodies.robot.joint_names
    for coupling in couplings:
        pair = coupled_joints(bodies.robot, coupling)
        rates = [samples.dq[:, j] for j in pair], [samples.ddq[:, j] for j in pair]
        columns = coupling.columns(*rates)
        terms = [term for term in coupling.terms for _ in term.names]
        for label, term, both in zip(coupling.names, terms, columns, strict=True):
            key = Key(coupling.label, label, term)
            for j, column in zip(pair, both, strict=True):
                found.setdefault(names[j], {})[key] = column
    return found
