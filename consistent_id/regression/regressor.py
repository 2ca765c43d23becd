"""The torque model: torques as a linear function of the parameters.

``tau = Y(q, dq, ddq) x``, where ``x`` holds ten inertial parameters per link and the
drive terms of each joint and of coupled joints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    IntArray,
    Matrix,
    Vector,
    checked,
    freeze,
    frozen,
)
from consistent_id.errors import ProblemError
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.regression.compiled.entries import fill_entries
from consistent_id.regression.compiled.sines import sine_and_cosine
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.drive_entries import coupled_joints, drive_entries
from consistent_id.regression.joint_geometry import (
    floats,
    joint_geometry,
    link_motions,
)
from consistent_id.regression.kept_columns import KeptColumns
from consistent_id.regression.loads import checked_reference, loaded
from consistent_id.regression.model_rows import biased_rows, in_order, rows_of
from consistent_id.regression.model_torque import model_torque
from consistent_id.regression.newton_euler import JointGeometry
from consistent_id.regression.row_names import (
    BASE_UNITS,
)
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout

CHUNK = 4072
"""Samples per chunk: keeps the recursion's arrays in the processor's cache.

An odd multiple of a line of the cache, which holds 8 numbers.  Columns that lie a power
of two apart share few places there: try ``benchmarks/compiled.py --chunk 4096``.
"""


_Room = TypeVar("_Room", Array, KeptColumns)


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
    layout : ParameterLayout
    fingerprint : str
        Of geometry, gravity, drive terms, couplings and rows: what belongs together
        has the same.

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
    layout: ParameterLayout = field(init=False)
    fingerprint: str = field(init=False)

    def __post_init__(self) -> None:
        robot, drive = self.robot, self.drive
        if isinstance(drive, DriveTerms):
            drive = (drive,) * len(robot)
        if len(drive) != len(robot):
            raise ProblemError(
                f"drive terms for {len(drive)} joints, but the robot has {len(robot)}"
            )
        couplings = tuple(self.couplings)
        rows = in_order(self.torque_joints, robot)
        columns = [
            (joint.name, joint, name)
            for joint, of_joint in zip(robot.driven, drive, strict=True)
            for name in of_joint.names
        ] + [
            (coupling.label, robot.driven[coupled_joints(robot, coupling)[0]], name)
            for coupling in couplings
            for name in coupling.names
        ]
        freeze(self, terms=drive, couplings=couplings, torque_joints=rows)
        biased = biased_rows(self)
        layout = ParameterLayout(
            links=robot.link_names,
            drive=(
                *((owner, name) for owner, _, name in columns),
                *((name, "bias") for name in biased),
            ),
            drive_units=(
                *(
                    term.unit[joint.kind == "prismatic"]
                    for (_, joint, _), term in zip(
                        columns, self.column_terms, strict=True
                    )
                ),
                *(BASE_UNITS[name] for name in biased),
            ),
        )
        freeze(self, layout=layout)
        load = checked_reference(self)
        freeze(self, load_reference=load)
        content = (
            f"({_geometry(robot)}, {drive!r}, {couplings!r}, {layout!r}, {rows!r})"
        )
        content += "" if load is None else repr(load.tolist())
        content += repr(robot.transmissions) if len(robot) < len(robot.joints) else ""
        digest = sha256(content.encode()).hexdigest()[:16]
        freeze(self, fingerprint=digest)

    @property
    def column_terms(self) -> tuple[DriveTerm, ...]:
        """The drive term of each column after the inertial ones."""
        terms = [term for joint in self.terms for term in joint.terms]
        terms += [term for coupling in self.couplings for term in coupling.terms]
        return tuple(term for term in terms for _ in term.names)

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
            How the base moves, if it floats.

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
            Of each torque joint the columns wanted, none of them zero for all motions.
        q, dq, ddq, size, base
            See `chunks`.

        Yields
        ------
        samples : slice
        rows : sequence of ndarray, each shape (samples, columns wanted + 1)
            In Fortran's order; the last column is left for the torque.  The arrays are
            reused, and may be destroyed.
        """
        columns = [tuple(c.tolist()) for c in kept]
        width, samples = len(self.layout), min(size, len(np.asarray(q)))
        some = KeptColumns.empty(columns, width, samples)
        if any(True for _ in loaded(self)):  # a load takes all columns of its row
            for part, block in self.chunks(q, dq, ddq, size, base=base):
                wanted = some[:, :, : block.shape[2]]
                for rows, row, chosen in zip(wanted.blocks, block, kept, strict=True):
                    rows[:, :-1] = row[chosen].T
                yield part, wanted.blocks
            return
        for part, filled in self._filled(some, q, dq, ddq, base):
            yield part, filled.blocks

    def _filled(
        self,
        out: _Room,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        base: BaseMotion | None,
    ) -> Iterator[tuple[slice, _Room]]:
        """Yield ``(samples, out)`` with the regressor of as many samples as fit in."""
        motion, moves = self._checked(q, dq, ddq, base)
        samples, joints = motion[0].shape
        geometry, size = joint_geometry(self.robot), out.shape[2]
        # Made once: what is freed after each piece goes back to the system and returns
        # page by page, which costs as much as the recursion.
        state = np.empty((3, joints, size))
        waves = np.empty((len(self.robot.joints), 2, size))
        for start in range(0, samples, max(size, 1)):
            part = slice(start, min(start + size, samples))
            block = out if part.stop - start == size else _shorter(out, part)
            few = slice(part.stop - start)
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
        """
        x = frozen(x, (len(self.layout),), "parameters")
        return model_torque(self, x, *self._checked(q, dq, ddq, base))

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
            sine, cosine = sine_and_cosine(x, next(rooms))
            return sine, cosine

        motion = link_motions(self.robot, [*state], both, base)
        gravity = floats(self.robot.gravity)
        row = rows_of(self)
        q, dq, ddq = state
        fill_entries(out, row, geometry, gravity, motion)
        loads = {}
        if not isinstance(out, KeptColumns):  # else no load is needed: `kept_chunks`
            loads = {
                j: np.tensordot(reference, out[row[j], : len(reference)], axes=1)
                for j, reference in loaded(self)
            }
        for j, column, values in drive_entries(self, q, dq, ddq, loads):
            if j in row:
                out[row[j], column] = values
        for column, name in enumerate(biased_rows(self), start=-6):
            out[self.torque_joints.index(name), column] = 1.0


def _shorter(out: _Room, part: slice) -> _Room:
    """Return room for fewer samples; an array of its own, for a view has gaps."""
    samples = part.stop - part.start
    if isinstance(out, KeptColumns):
        return out[:, :, :samples]
    return np.zeros((*out.shape[:2], samples))


@lru_cache(maxsize=32)
def _geometry(robot: RobotModel) -> str:
    """Return a robot's geometry and gravity as text: many models are of one robot."""
    return f"{joint_geometry(robot)!r}, {robot.gravity.tolist()!r}"


def joint_torque_regressor(
    robot: RobotModel, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
) -> Array:
    """Return the rigid-body regressor, shape (joints, 10 links, samples).

    See `TorqueModel.regressor`, which has drive terms besides.
    """
    return TorqueModel(robot).regressor(q, dq, ddq)
