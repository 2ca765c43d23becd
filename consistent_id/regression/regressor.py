"""The torque model: torques as a linear function of the parameters.

``tau = Y(q, dq, ddq) x``, where ``x`` holds ten inertial parameters per link and the
drive terms of each joint and of coupled joints.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    checked,
    chunks,
    freeze,
    frozen,
)
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling, coupled_joints
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.loads import body_torques, checked_reference
from consistent_id.regression.newton_euler import (
    JointGeometry,
    floats,
    joint_geometry,
    link_motions,
    regressor_entries,
)
from consistent_id.regression.row_names import (
    BASE_ROWS,
    BASE_UNITS,
    CONTACT_FREE,
    KeptColumns,
    Room,
    in_newton,
    rows_in_order,
    shorter,
)
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout

CHUNK = 4072
"""Samples per chunk: keeps the recursion's arrays in the processor's cache.

An odd multiple of a line of the cache, which holds 8 numbers: columns that lie a power
of two apart share few places there.
"""


@brief
@dataclass(frozen=True, slots=True, eq=False)
class TorqueModel:
    """A robot's torque as a linear function of its parameters.

    Parameters
    ----------
    robot : RobotModel
    drive : DriveTerms or tuple of DriveTerms
        Friction and drive terms, for all joints alike or joint by joint.
    couplings : tuple of GearCoupling
        Terms that two joints share.
    torque_joints : tuple of str
        Joints whose torque is known, in the robot's order; by default all.  The others
        move, and what they carry weighs on the joints before them, but they have no
        row.  Where the base floats, the six `BASE_ROWS` come before the joints; they
        alone need no torque.
    load_reference : array_like, shape (10 links,), optional
        Inertial parameters from which the torque that a joint transmits is computed,
        where friction depends on it; by default the nominal robot's.  An estimate's
        own, put here, refine it.
    wrench_bias : bool
        Whether the sensor of the base wrench has an unknown offset: six parameters.

    Attributes
    ----------
    coupled : tuple of tuple of int
        Places of each coupling's two joints.
    layout : ParameterLayout
    fingerprint : str
        Fingerprint of geometry, gravity, drive terms, couplings and rows: what belongs
        together has the same.

    Examples
    --------
    >>> from consistent_id import DHRow, DriveTerms, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0)])
    >>> torque = TorqueModel(arm, DriveTerms(viscous=True))
    >>> torque.regressor([[0.1, 0.2]], [[0, 0]], [[0, 0]]).shape
    (2, 22, 1)
    """

    robot: RobotModel
    drive: DriveTerms | tuple[DriveTerms, ...] = field(default_factory=DriveTerms)
    couplings: tuple[GearCoupling, ...] = ()
    torque_joints: tuple[str, ...] = ()
    load_reference: Vector | None = None
    wrench_bias: bool = False
    terms: tuple[DriveTerms, ...] = field(init=False)
    coupled: tuple[tuple[int, int], ...] = field(init=False)
    layout: ParameterLayout = field(init=False)
    fingerprint: str = field(init=False)

    def __post_init__(self) -> None:
        robot, drive = self.robot, self.drive
        require_type(robot, RobotModel, "robot")
        if isinstance(drive, DriveTerms):
            drive = (drive,) * len(robot)
        if len(drive) != len(robot):
            raise ProblemError(
                f"drive terms for {len(drive)} joints, but the robot has {len(robot)}"
            )
        couplings = tuple(self.couplings)
        coupled = tuple(coupled_joints(robot, coupling) for coupling in couplings)
        rows = rows_in_order(self.torque_joints, robot)
        columns = [
            (joint.name, joint, name)
            for joint, of_joint in zip(robot.driven, drive, strict=True)
            for name in of_joint.names
        ] + [
            (coupling.label, robot.driven[first], name)
            for coupling, (first, _) in zip(couplings, coupled, strict=True)
            for name in coupling.names
        ]
        freeze(self, terms=drive, couplings=couplings, coupled=coupled)
        freeze(self, torque_joints=rows)
        biased = self.biased_rows
        units = [
            term.unit[joint.kind == "prismatic"]
            for (_, joint, _), term in zip(columns, self.column_terms, strict=True)
        ]
        layout = ParameterLayout(
            links=robot.link_names,
            drive=(
                *((owner, name) for owner, _, name in columns),
                *((name, "bias") for name in biased),
            ),
            drive_units=(*units, *(BASE_UNITS[name] for name in biased)),
        )
        freeze(self, layout=layout)
        load = checked_reference(robot, drive, self.load_reference)
        freeze(self, load_reference=load)
        freeze(self, fingerprint=self._digest())

    def _digest(self) -> str:
        """Return a digest of all that the parameters and the rows depend on."""
        robot, load = self.robot, self.load_reference
        content = (
            f"({_geometry(robot)}, {self.terms!r}, {self.couplings!r}, "
            f"{self.layout!r}, {self.torque_joints!r})"
        )
        content += "" if load is None else repr(load.tolist())
        content += repr(robot.transmissions) if len(robot) < len(robot.joints) else ""
        return sha256(content.encode()).hexdigest()[:16]

    @property
    def column_terms(self) -> tuple[DriveTerm, ...]:
        """The drive term of each column after the inertial ones."""
        terms = [term for joint in self.terms for term in joint.terms]
        terms += [term for coupling in self.couplings for term in coupling.terms]
        return tuple(term for term in terms for _ in term.names)

    @property
    def rows(self) -> dict[int, int]:
        """The row of each generalised coordinate that has one.

        Those of a floating base are numbered after the joints, as in `joint_motions`.
        """
        if self.torque_joints == (CONTACT_FREE,):
            raise ProblemError(
                "rows without contact forces combine all rows, by the contacts; give "
                "their base parameters (contact_free_base) and regression "
                "(contact_free_rows)"
            )
        coordinates = (*self.robot.joint_names, *BASE_ROWS)
        places = [coordinates.index(name) for name in self.torque_joints]
        return {j: row for row, j in enumerate(places)}

    @property
    def forces(self) -> BoolArray:
        """True for rows that are forces, in N; the others are torques, in N m."""
        names = self.torque_joints
        return np.array([in_newton(self.robot, name) for name in names], dtype=bool)

    @property
    def biased_rows(self) -> tuple[str, ...]:
        """The rows whose sensor has a bias, if it does."""
        if not self.wrench_bias:
            return ()
        if not set(BASE_ROWS) <= set(self.torque_joints):
            raise ProblemError(
                "wrench_bias belongs to the sensor of the base's wrench, but the model "
                "has no such rows; load the robot with base='floating', or leave the "
                "bias out"
            )
        return BASE_ROWS

    @property
    def load_references(self) -> dict[int, Vector]:
        """Inertial parameters that the load is computed from.

        Joints without a row, or without friction that depends on the load, have none.
        """
        if self.load_reference is None:
            return {}
        drives = enumerate(self.terms)
        loaded = {j for j, terms in drives if terms.needs_load}
        return {j: self.load_reference for j in self.rows if j in loaded}

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        base: BaseMotion | None = None,
    ) -> Array:
        """Return the regressor of samples.

        Parameters
        ----------
        q, dq, ddq : array_like, shape (samples, joints)
            Positions [rad or m] and their derivatives [per s, per s^2].
        base : BaseMotion, optional
            Motion of the base, if it floats.

        Returns
        -------
        ndarray, shape (torque joints, parameters, samples)
            Joint-major: ``tau[:, j] = Y[j].T @ x``.

        Raises
        ------
        ProblemError
            If a shape is wrong or a value is not finite.
        """
        Y = np.zeros((len(self.torque_joints), len(self.layout), len(np.asarray(q))))
        if Y.shape[2] <= CHUNK:
            for _ in self._filled(Y, q, dq, ddq, base):
                pass
            return Y
        for part, block in self.chunks(q, dq, ddq, base=base):
            Y[:, :, part] = block
        return Y

    def chunks(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = CHUNK,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Array]]:
        """Yield ``(samples, regressor)`` piece by piece, in constant memory.

        The regressor's array is reused: consume it before the next step.
        """
        shape = len(self.torque_joints), len(self.layout), min(size, len(np.asarray(q)))
        yield from self._filled(np.zeros(shape), q, dq, ddq, base)

    def kept_chunks(
        self,
        kept: Sequence[IntArray],
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = CHUNK,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield ``(samples, rows)`` of some columns, piece by piece.

        Parameters
        ----------
        kept : sequence of ndarray
            Wanted columns of each torque joint, none of them zero for all motions.
        q, dq, ddq, size, base
            See `chunks`.

        Yields
        ------
        samples : slice
        rows : sequence of ndarray, each shape (samples, columns wanted + 1)
            In Fortran's order; the last column is left for the torque.  The arrays are
            reused, and may be destroyed.
        """
        samples = min(size, len(np.asarray(q)))
        some = KeptColumns.empty(kept, len(self.layout), samples)
        if self.load_references:  # a load takes all columns of its row
            for part, block in self.chunks(q, dq, ddq, size, base=base):
                wanted = some.first(block.shape[2])
                for rows, row, chosen in zip(wanted.blocks, block, kept, strict=True):
                    rows[:, :-1] = row[chosen].T
                yield part, wanted.blocks
            return
        for part, filled in self._filled(some, q, dq, ddq, base):
            yield part, filled.blocks

    def _filled(
        self,
        out: Room,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        base: BaseMotion | None,
    ) -> Iterator[tuple[slice, Room]]:
        """Yield ``(samples, out)`` with the regressor of as many samples as fit in."""
        motion, moves = self._checked(q, dq, ddq, base)
        samples, joints = motion[0].shape
        geometry, size = joint_geometry(self.robot), out.shape[2]
        # Made once: what is freed after each piece goes back to the system and returns
        # page by page, which costs as much as the recursion.
        state = np.empty((3, joints, size))
        waves = np.empty((len(self.robot.joints), 2, size))
        for part in chunks(samples, size):
            few = slice(part.stop - part.start)
            block = out if few.stop == size else shorter(out, few.stop)
            for own, x in zip(state, motion, strict=True):
                own[:, few] = x[part].T
            carried = None if moves is None else np.ascontiguousarray(moves[part].T)
            self._fill(block, geometry, state[:, :, few], carried, waves[:, :, few])
            yield part, block

    def _checked(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, base: BaseMotion | None
    ) -> tuple[list[Array], Array | None]:
        """Return a motion of the robot and of its base, as arrays of one length."""
        motion = [
            checked(x, (None, len(self.robot)), name)
            for x, name in ((q, "q"), (dq, "dq"), (ddq, "ddq"))
        ]
        samples = len(motion[0])
        for x, name in zip(motion, ("q", "dq", "ddq"), strict=True):
            if len(x) != samples:
                raise ProblemError(f"{name} has {len(x)} samples, q has {samples}")
        moves = None if base is None else base.stacked
        if moves is not None and len(moves) != samples:
            raise ProblemError(f"base motion has {len(moves)} samples, q has {samples}")
        return motion, moves

    def predict(
        self,
        x: ArrayLike,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        base: BaseMotion | None = None,
    ) -> Array:
        """Return torques of parameters `x`, shape (samples, torque joints), [N m or N].

        In the order of `torque_joints`.

        Parameters
        ----------
        x : array_like, shape (parameters,)
        q, dq, ddq : array_like, shape (samples, joints)
            Position [rad or m], velocity and acceleration.
        base : BaseMotion, optional
            Motion of a floating base.
        """
        x = frozen(x, (len(self.layout),), "parameters")
        state, moves = self._checked(q, dq, ddq, base)
        bodies, row = [x[: self.layout.inertial_size]], self.rows
        if self.load_references:
            bodies.append(np.asarray(self.load_reference))
        torque, *carried = self.rigid_torques(bodies, state, moves)
        for part in chunks(len(torque), CHUNK):
            loads = {
                j: load[part, row[j]] for load in carried for j in self.load_references
            }
            q, dq, ddq = (np.ascontiguousarray(values[part].T) for values in state)
            for j, column, values in self.drive_entries(q, dq, ddq, loads):
                if j in row:
                    torque[part, row[j]] += x[column] * values
        for column, name in enumerate(self.biased_rows, start=-6):
            torque[:, self.torque_joints.index(name)] += x[column]
        return torque

    def rigid_torque(
        self,
        bodies: Vector,
        state: Sequence[Array | None],
        base: Array | None = None,
    ) -> Array:
        """Return torques of bodies alone, shape (samples, torque joints), [N m or N].

        With known bodies, Newton and Euler's forces take a fraction of the time that
        the coefficients of all parameters take.

        Parameters
        ----------
        bodies : ndarray, shape (10 links,)
        state : three ndarray, each shape (samples, joints)
            Positions and their two derivatives; derivatives are None for a robot at
            rest, which feels gravity alone.
        base : ndarray, shape (samples, 9), optional
            How the base moves, if it floats; see `BaseMotion.stacked`.
        """
        return self.rigid_torques([bodies], state, base)[0]

    def rigid_torques(
        self,
        bodies: Sequence[Vector],
        state: Sequence[Array | None],
        base: Array | None = None,
    ) -> list[Array]:
        """Return `rigid_torque` of several robots' bodies along one motion."""
        return body_torques(self.robot, self.rows, bodies, state, base, size=CHUNK)

    def drive_entries(
        self, q: Any, dq: Any, ddq: Any, loads: Mapping[int, Any]
    ) -> Iterator[tuple[int, int, Any]]:
        """Yield ``(joint, column, values)`` of drive terms and couplings.

        `loads` are the transmitted torques of joints whose friction depends on them; a
        joint that needs one and has none is one without a row, and is left out.
        """
        column = self.layout.inertial_size
        for j, terms in enumerate(self.terms):
            if terms.needs_load and j not in loads:
                column += len(terms.names)
                continue
            for values in terms.columns(q[j], dq[j], ddq[j], loads.get(j)):
                yield j, column, values
                column += 1
        for coupling, (i, j) in zip(self.couplings, self.coupled, strict=True):
            for first, second in coupling.columns((dq[i], dq[j]), (ddq[i], ddq[j])):
                yield i, column, first
                yield j, column, second
                column += 1

    def _fill(
        self,
        out: Array | KeptColumns,
        geometry: Sequence[JointGeometry],
        state: Array,
        base: Array | None,
        waves: Array,
    ) -> None:
        rooms = iter(waves)

        def both(x: Array) -> tuple[Array, Array]:
            sine, cosine = next(rooms)
            return np.sin(x, out=sine), np.cos(x, out=cosine)

        motion = link_motions(self.robot, [*state], both, base)
        gravity = floats(self.robot.gravity)
        row = self.rows
        q, dq, ddq = state
        for j, k, entries in regressor_entries(geometry, gravity, motion):
            if j in row:
                for i, entry in enumerate(entries, start=10 * k):
                    out[row[j], i] = entry
        loads = {}
        if not isinstance(out, KeptColumns):  # else no load is needed: `kept_chunks`
            loads = {
                j: np.tensordot(reference, out[row[j], : len(reference)], axes=1)
                for j, reference in self.load_references.items()
            }
        for j, column, values in self.drive_entries(q, dq, ddq, loads):
            if j in row:
                out[row[j], column] = values
        for column, name in enumerate(self.biased_rows, start=-6):
            out[self.torque_joints.index(name), column] = 1.0


@lru_cache(maxsize=32)
def _geometry(robot: RobotModel) -> str:
    """Return a robot's geometry and gravity as text: many models are of one robot."""
    return f"{joint_geometry(robot)!r}, {robot.gravity.tolist()!r}"


def joint_torque_regressor(
    robot: RobotModel, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
) -> Array:
    """Return the rigid-body regressor, shape (joints, 10 links, samples).

    See `TorqueModel.regressor`, which has drive terms besides.

    Parameters
    ----------
    robot : RobotModel
    q, dq, ddq : array_like, shape (samples, joints)
        Position [rad or m], velocity and acceleration.
    """
    return TorqueModel(robot).regressor(q, dq, ddq)
