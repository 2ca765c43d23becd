"""Rows of logs for all parameters, and for factors of a whole robot.

A factor is one number: the clock's speed, a gain of all torques, a zero, the angle of a
leaning base.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import or_

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.recordings.recording import Recording
from consistent_id.regression.correlation_lengths import correlation_lengths
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.motion_arrays import RowColumns
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel

ALL_GAINS, ONE_GAIN = "masses or gain", "torque gain"
"""Kinds of factors of the torque: of all joints, and of one."""

RANK = 1e-7
"""Singular value of unit columns, of the largest, below which one counts as zero."""

EXACT = 1e-3
"""Share of the torque: least residual that weights a joint's rows."""


@dataclass(frozen=True, slots=True)
class Factor:
    """A fault with one unknown number.

    Parameters
    ----------
    kind : str
        ``"clock"``, ``"masses or gain"``, ``"torque gain"`` (of one joint), ``"offset
        zero"`` or ``"gravity"``.
    where : str
    least : float
        Least size that is reported: log of the clock's speed or of the gain, [rad or
        m] for zeros and [rad] for the base.
    joint : int
        Place of the joint with the wrong zero or gain.
    axis : tuple of float
        Level unit vector about which the base may lean.
    """

    kind: str
    where: str
    least: float
    joint: int = 0
    axis: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class FactorRows:
    """Rows of logs, which are computed when they are first needed, and once.

    Parameters
    ----------
    model : TorqueModel
        Model of a robot with nominal bodies and a fixed base.
    logs : sequence of Recording
        Prepared, with the robot's joints; few samples suffice.
    loads : bool
        Whether friction may grow with the measured torque.
    given : sequence of rows, optional
        Those of each log, if they are known.
    """

    model: TorqueModel
    logs: Sequence[Recording]
    loads: bool = True
    given: Sequence["_Rows"] | None = None

    @cached_property
    def each(self) -> Sequence["_Rows"]:
        """The rows of each log."""
        if self.given is not None:
            return self.given
        return [_Rows.of(self.model, log, loads=self.loads) for log in self.logs]

    @cached_property
    def own(self) -> list[RowColumns]:
        """The columns of each torque joint that are not zero, of all logs."""
        first, *others = (rows.own for rows in self.each)
        return [_joined(ones) for ones in zip(first, *others, strict=True)]

    @cached_property
    def columns(self) -> Array:
        """The columns of all logs, shape (torque joints, columns, samples)."""
        whole = np.zeros((len(self.own), self.width, self.torque.shape[1]))
        for row, own in zip(whole, self.own, strict=True):
            row[own.places] = own.values
        return whole

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.each[0].width

    def of_group(self, group: "Limb") -> Array:
        """Return the rows of a group, shape (its joints, its columns, samples)."""
        shape = len(group.joints), len(group.columns), self.torque.shape[1]
        rows = np.zeros(shape)
        for row, j in zip(rows, group.joints, strict=True):
            own = self.own[j]
            row[np.searchsorted(group.columns, own.places)] = own.values
        return rows

    def torque_of(self, x: Vector, columns: slice = slice(None)) -> Matrix:
        """Return the torque of some columns, shape (torque joints, samples)."""
        return _torque_of(self.own, x, columns)

    @cached_property
    def torque(self) -> Matrix:
        """The torque of all logs, shape (torque joints, samples)."""
        return np.concatenate([rows.log.torque for rows in self.each], axis=1)

    @cached_property
    def without_loads(self) -> "FactorRows":
        """The same rows without friction that grows with the measured torque."""
        if not self.loads:
            return self
        fewer = [rows.without_loads for rows in self.each]
        return replace(self, loads=False, given=fewer)

    def with_drives_of(self, other: "FactorRows") -> "FactorRows":
        """Return these rows with the drives' columns of other ones, of as many rows."""
        bodies = self.model.layout.inertial_size
        mixed = [
            replace(own, own=_mixed(own.own, its.own, bodies))
            for own, its in zip(self.each, other.each, strict=True)
        ]
        return replace(self, given=mixed)

    @cached_property
    def factors(self) -> list[list[Matrix]]:
        """Triangular factors of each joint's columns and torque, group by group."""
        return [
            [_factor_of(self.own[j], self.torque[j], g.columns) for j in g.joints]
            for g in self.groups
        ]

    @cached_property
    def groups(self) -> list["Limb"]:
        """Joints that share columns, such as those of a leg."""
        there = np.zeros((len(self.own), self.width), dtype=bool)
        for row, columns in zip(there, self.own, strict=True):
            row[columns.places] = True
        groups: list[tuple[list[int], BoolArray]] = []
        for j, own in enumerate(there):
            joined = [g for g in groups if (g[1] & own).any()]
            groups = [g for g in groups if not (g[1] & own).any()]
            joints = sorted([*(k for g in joined for k in g[0]), j])
            groups.append((joints, reduce(or_, (g[1] for g in joined), own)))
        return [Limb(np.array(j), np.flatnonzero(own)) for j, own in groups]


@dataclass(frozen=True, slots=True, eq=False)
class Limb:
    """Joints that share columns with no others: their bodies are fitted by themselves.

    Parameters
    ----------
    joints, columns : ndarray of int
    """

    joints: IntArray
    columns: IntArray

    @property
    def part(self) -> tuple[IntArray, IntArray]:
        """Their rows and columns."""
        return self.joints[:, None], self.columns


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of one log, filtered like its torque.

    Parameters
    ----------
    log : SampleRows
    own : list of RowColumns
        Of each torque joint, those that are not zero: the model's, then rotor inertias
        and friction that it may lack.
    width : int
        Number of columns.
    """

    log: SampleRows
    own: list[RowColumns]
    width: int

    @classmethod
    def of(cls, model: TorqueModel, log: Recording, *, loads: bool = True) -> "_Rows":
        rows = SampleRows.of(model, log)
        rotors = rows.filtered(rows.change[:, None])
        frictions = rows.frictions(rows.smooth_torque())
        more = np.concatenate([rotors, frictions[:, : None if loads else -1]], axis=1)
        first, (joints, each) = len(model.layout), more.shape[:2]
        own = []
        for j, (whole, further) in enumerate(zip(rows.own(), more, strict=True)):
            places = [*whole.places, *range(first + j * each, first + (j + 1) * each)]
            values = np.concatenate([whole.values, further])
            own.append(_seen(RowColumns(np.array(places), values)))
        return cls(rows, own, first + joints * each)

    @property
    def without_loads(self) -> "_Rows":
        """The same without the last of each joint's own columns."""
        first, joints = len(self.log.model.layout), len(self.own)
        number = np.arange(self.width - first)
        each = len(number) // joints
        kept = np.append(np.full(first, True), number % each < each - 1)
        places = np.cumsum(kept) - 1
        fewer = [
            RowColumns(places[o.places[there]], o.values[there])
            for o in self.own
            for there in [kept[o.places]]
        ]
        return _Rows(self.log, fewer, int(kept.sum()))

    def torque_of(self, x: Vector, columns: slice = slice(None)) -> Matrix:
        """Return the torque of some columns, shape (torque joints, samples)."""
        return _torque_of(self.own, x, columns)

    def slopes(self, x: Vector, factors: Sequence[Factor]) -> Array:
        """Return torque per unit of each factor, (torque joints, factors, samples).

        Torque is changed by a clock ``exp(f)`` times too slow, by a gain ``exp(f)`` of
        all joints or of one, by positions that are ``f`` too small, by gravity that
        leans.
        """
        layout, gravity = self.log.model.layout, self.log.model.robot.gravity
        inertial = layout.inertial_size
        bodies = np.zeros(len(layout))
        bodies[:inertial] = x[:inertial]
        moved = [f.joint for f in factors if f.kind == "offset zero"]
        zeros = np.zeros((0, 0, 0))
        if moved:
            zeros = self.log.slopes_by_position(bodies, moved)
        torque = np.zeros((0, 0))
        if any(f.kind in (ALL_GAINS, ONE_GAIN) for f in factors):
            torque = self.torque_of(x)
        found = []
        for factor in factors:
            if factor.kind == "clock":
                whole = self.torque_of(x, slice(inertial))
                part = 2.0 * (whole - self.log.at_rest(x[:inertial], gravity))
            elif factor.kind in (ALL_GAINS, ONE_GAIN):
                part = torque
                if factor.kind == ONE_GAIN:
                    own = np.array(self.log.model.torque_joints) == factor.where
                    part = torque * own[:, None]
            elif factor.kind == "offset zero":
                part = zeros[:, moved.index(factor.joint)]
            else:
                turned = np.cross(factor.axis, gravity)
                part = self.log.at_rest(x[:inertial], turned)
            found.append(part)
        return np.stack(found, axis=1)


def _torque_of(rows: Sequence[RowColumns], x: Vector, columns: slice) -> Matrix:
    """Return the torque of some columns; those beyond `x` do not count."""
    some = np.zeros(
        1 + max((int(o.places[-1]) for o in rows if len(o.places)), default=0)
    )
    known = np.arange(len(x))[columns]
    known = known[known < len(some)]
    some[known] = x[known]
    return np.stack([some[own.places] @ own.values for own in rows])


def _seen(own: RowColumns) -> RowColumns:
    """Return the columns that are not zero."""
    there = own.values.any(axis=1)
    return own if there.all() else RowColumns(own.places[there], own.values[there])


def _joined(ones: Sequence[RowColumns]) -> RowColumns:
    """Return a joint's columns of logs one after another."""
    if len(ones) == 1:
        return ones[0]
    places = reduce(np.union1d, (one.places for one in ones))
    parts = []
    for one in ones:
        part = np.zeros((len(places), one.values.shape[1]))
        part[np.searchsorted(places, one.places)] = one.values
        parts.append(part)
    return RowColumns(places, np.concatenate(parts, axis=1))


def _mixed(
    bodies_of: Sequence[RowColumns], drives_of: Sequence[RowColumns], bodies: int
) -> list[RowColumns]:
    """Return the columns of bodies of some rows, and the others of other rows."""
    found = []
    for one, other in zip(bodies_of, drives_of, strict=True):
        first, last = one.places < bodies, other.places >= bodies
        found.append(
            RowColumns(
                np.concatenate([one.places[first], other.places[last]]),
                np.concatenate([one.values[first], other.values[last]]),
            )
        )
    return found


def _factor_of(own: RowColumns, torque: Vector, columns: IntArray) -> Matrix:
    """Return the triangular factor of some columns, in their order, and the torque."""
    R = triangle(np.concatenate([own.values, torque[None]]).T)
    factor = np.zeros((len(R), len(columns) + 1))
    factor[:, [*np.searchsorted(columns, own.places), len(columns)]] = R
    return factor


def relative_noise(rows: FactorRows) -> Vector:
    """Return each joint's noise over its torque, as if samples were independent.

    It is the residual of least squares times the root of the number of samples over
    which it is correlated.
    """
    rest, size = residual_of(rows)
    ends = np.cumsum([len(log) for log in rows.logs])[:-1]
    lengths = correlation_lengths(np.split(rest.T, ends))
    sigma = np.maximum(torque_sizes(rest), EXACT * size)
    return np.asarray(sigma / size * np.sqrt(lengths))


def residual_of(logs: FactorRows) -> tuple[Matrix, Vector]:
    """Return the residual of least squares, and the size of each joint's torque.

    Joints are weighted by their residuals in turn.
    """
    torque = logs.torque
    size = torque_sizes(torque)
    sigma, rest = size, torque
    for _ in range(3):
        x = np.zeros(logs.width)
        for group, factors in zip(logs.groups, logs.factors, strict=True):
            errors = sigma[group.joints]
            rows = [F / error for F, error in zip(factors, errors, strict=True)]
            R = triangle(np.asfortranarray(np.vstack(rows)))
            x[group.columns] = smallest_solution(R[:, :-1], R[:, -1], RANK)
        rest = torque - logs.torque_of(x)
        sigma = np.maximum(torque_sizes(rest), EXACT * size)
    return rest, size


def torque_sizes(torque: Matrix) -> Vector:
    """Return the root mean square of each joint's torque."""
    return np.asarray(np.maximum(np.sqrt(np.mean(torque**2, axis=1)), 1e-300))
