"""Row maps that no contact force passes, and contacts that slip.

With contacts closed whose forces are not measured,
``[Y_b; Y_j] x = [0; tau] + J_c^T f_c`` is multiplied, sample by sample, by
``Z^T S^-1``: ``S`` holds the rows' noise levels, and the orthonormal columns of ``Z``
span all that is perpendicular to ``S^-1 J_c^T``.  White noise of these levels stays
white, of variance one.  ``n + 6 - rank J_c`` rows are left, as many as the contacts
leave.

These row maps ``L_t`` leave rows that have no names, and other ones at every sample.
`ContactMixing` turns them back, ``L_t^T L_t`` with all levels one: the part of each row
that no contact force enters.  There are as many rows as before, so noise, residuals and
weights keep their meaning row by row; together they hold what the fewer rows hold.

Of all points at rest on the ground ``J_i [v; w; dq] = 0``.  The rate ``w`` of the base
is measured, its velocity ``v`` is not; but it is the same for all of them, so that two
contacts or more show whether one slips.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    chunks,
)
from consistent_id._support.caches import kept_with
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.beside import ContactFlags
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import CONTACT_FREE, row_names
from consistent_id.regression.rows.generalised_forces import (
    contact_jacobian,
    joint_positions,
    measured_forces,
)
from consistent_id.robot.model import RobotModel

_DEPENDENT = 1e-8
"""Size of a Jacobian's row beyond those before it, relative to the largest, that is
none: two points of one foot on a line push alike along it, to rounding."""

CHUNK = 512
"""Samples per chunk: of 18 rows and 130 columns, 10 MB."""

_MOST = 2**27
"""Bytes of a recording's maps that are kept in memory: 50 000 samples of 18 rows."""


class RowMap(NamedTuple):
    """The row maps of samples that have equally many rows left.

    Attributes
    ----------
    samples : ndarray of int, shape (samples,)
        Places of the samples in the recording.
    maps : ndarray, shape (samples, rows, 6 + joints)
        ``L_t = Z_t^T S^-1``.
    """

    samples: IntArray
    maps: Array


def row_numbers(robot: RobotModel) -> IntArray:
    """Return the numbers of all `row_names`."""
    return np.arange(6 + len(robot))


def contact_pushes(
    robot: RobotModel,
    q: Matrix,
    contacts: Sequence[ContactFlags],
    rotation: Array | None = None,
) -> list[Array]:
    """Return ``J_c^T`` of each contact, shape (samples, 6 + joints, 3 or 6).

    Parameters
    ----------
    robot : RobotModel
        Robot with a floating base.
    q : ndarray, shape (samples, joints), [rad or m]
    rotation : ndarray, shape (samples, 3, 3), optional
        Rotation of the base in the world, for contacts with a radius.
    """
    down = _down(robot, contacts, rotation)
    return [_pushes(robot, q, flags, down) for flags in contacts]


def _down(
    robot: RobotModel, contacts: Sequence[ContactFlags], rotation: Array | None
) -> Matrix | None:
    """Return the direction of gravity in base axes, if a contact needs it."""
    round_feet = [flags.frame for flags in contacts if flags.radius]
    if not round_feet:
        return None
    size = float(np.linalg.norm(robot.gravity))
    if rotation is None or size == 0.0:
        raise RecordingError(
            f"contact at {round_feet[0]!r} has a radius, but the direction of gravity "
            "is not known; give BaseMotion(..., rotation=...), and a robot with gravity"
        )
    return np.asarray(np.swapaxes(rotation, 1, 2) @ (robot.gravity / size))


def _pushes(
    robot: RobotModel, q: Matrix, flags: ContactFlags, down: Matrix | None
) -> Array:
    """Return ``J_c^T`` of one contact, shape (samples, rows, 3 or 6)."""
    J = contact_jacobian(robot, q, frame=flags.frame, point=flags.point)
    if down is not None and flags.radius:
        arm = flags.radius * down
        J[:, :3] += np.cross(J[:, 3:], arm[:, :, None], axis=1)  # v + w x arm
    return np.swapaxes(J if flags.surface else J[:, :3], 1, 2)


def _null_spaces(samples: IntArray, pushes: Array, sigma: Vector) -> Iterator[RowMap]:
    """Yield maps of samples whose contacts have equal ranks."""
    rows, columns = pushes.shape[1:]
    if not columns:
        free = np.broadcast_to(np.diag(1.0 / sigma), (len(samples), rows, rows))
        yield RowMap(samples, free)
        return
    Q, R = np.linalg.qr(pushes, mode="complete")
    sizes = abs(np.diagonal(R, axis1=1, axis2=2))
    full = sizes.min(axis=1) > _DEPENDENT * sizes.max(axis=1)
    full &= columns < rows
    if full.any():
        Z = Q[full][:, :, columns:]
        yield RowMap(samples[full], np.swapaxes(Z, 1, 2) / sigma)
    rest = np.flatnonzero(~full)
    if not len(rest):
        return
    U, s, _ = np.linalg.svd(pushes[rest])
    ranks = (s > _DEPENDENT * s[:, :1]).sum(axis=1)
    for rank in np.unique(ranks):
        if rank < rows:
            own = ranks == rank
            Z = U[own][:, :, rank:]
            yield RowMap(samples[rest[own]], np.swapaxes(Z, 1, 2) / sigma)


def contact_force_left(model: TorqueModel, recording: Recording) -> float:
    """Return the share of measured wrenches that row maps leave: zero, if all is right.

    ``sqrt(sum_t ||L_t J^T f||^2 / sum_t ||S^-1 J^T f||^2)`` over the samples that have
    rows, with unit noise levels: near one, if flags or places of contacts have nothing
    to do with the forces.

    Parameters
    ----------
    model : TorqueModel
    recording : Recording
        With `contacts` and the `wrenches` that were measured there.

    Raises
    ------
    RecordingError
        If no wrench was measured, or the base's motion is missing.
    """
    if not recording.wrenches:
        raise RecordingError(
            f"{recording.name}: no wrench was measured, so that the contacts cannot "
            "be checked; give Recording(..., wrenches=...)"
        )
    robot, names = model.robot, row_names(model.robot)
    quiet = Recording(
        recording.joints,
        recording.time,
        recording.position,
        torque=np.zeros_like(recording.position),
        base=recording.base,
        wrenches=recording.wrenches,
    )
    forces = measured_forces(TorqueModel(robot), quiet)
    if forces is None:
        raise RecordingError(f"{recording.name}: no wrench could be read")
    q = quiet.of(robot.joint_names).position
    left = whole = 0.0
    turned = None if recording.base is None else recording.base.rotation
    mixing = ContactMixing(robot, row_numbers(robot), q, recording.contacts, turned)
    for found in mixing.row_maps(np.ones(len(names))):
        acting = forces[found.samples]
        passed = np.einsum("nra,na->nr", found.maps, acting)
        left += float(np.sum(passed**2))
        whole += float(np.sum(acting**2))
    return float(np.sqrt(left / whole)) if whole > 0.0 else 0.0


def row_levels(
    robot: RobotModel, *, force: float = 1.0, moment: float = 1.0, joints: float = 1.0
) -> Vector:
    """Return noise levels of a floating robot's rows by their class.

    Parameters
    ----------
    robot : RobotModel
    force, moment : float, [N], [N m]
        Noise of the base rows: the effect of errors of the measured acceleration on the
        robot's whole mass.
    joints : float, [N m or N]
        Noise of the joints' torques.
    """
    if min(force, moment, joints) <= 0.0:
        raise ProblemError(
            f"noise levels are {force:g} N, {moment:g} N m and {joints:g} of joints, "
            "expected positive numbers"
        )
    return np.array([force] * 3 + [moment] * 3 + [joints] * len(robot))


@dataclass(frozen=True, slots=True, eq=False)
class ContactMixing:
    """Maps that mix rows so that no contact force is left in them.

    Parameters
    ----------
    rows : ndarray of int
        Which of `row_names` there are.
    q : ndarray, shape (samples, joints), [rad or m]
    contacts : tuple of ContactFlags
        Those whose forces are not measured.
    rotation : ndarray, shape (samples, 3, 3), optional
        Rotation of the base in the world.
    unknown : ndarray of bool, shape (samples, rows), optional
        Rows that hold something else that is not known, such as the friction of a joint
        at rest: nothing of them gets into the others.
    held : ndarray, shape (samples, rows, rows), optional
        The `maps`, if they are found already; see `holding`.
    """

    robot: RobotModel
    rows: IntArray
    q: Matrix
    contacts: tuple[ContactFlags, ...]
    rotation: Array | None
    unknown: BoolArray | None = None
    held: Array | None = None

    def samples(self, part: slice) -> "ContactMixing":
        """Return a run of samples."""
        return replace(
            self,
            q=self.q[part],
            contacts=tuple(flags.samples(part) for flags in self.contacts),
            rotation=None if self.rotation is None else self.rotation[part],
            unknown=None if self.unknown is None else self.unknown[part],
            held=None if self.held is None else self.held[part],
        )

    def holding(self) -> "ContactMixing":
        """Return the mixing with its maps found, for work that takes many passes.

        Unless they take more than `_MOST` bytes: then each pass finds them anew.
        """
        if 8 * len(self.q) * len(self.rows) ** 2 > _MOST:
            return self
        parts = [maps for _, maps in self.chunks()]
        return replace(self, held=np.concatenate(parts)) if parts else self

    @property
    def maps(self) -> Array:
        """Projections onto what is free of contact forces, (samples, rows, rows).

        Zero where a contact is not certain.
        """
        if self.held is not None:
            return self.held
        n = len(self.rows)
        found = np.zeros((len(self.q), n, n))
        levels = np.ones(n)
        for group in self.row_maps(levels):
            maps = group.maps
            found[group.samples] = np.swapaxes(maps, 1, 2) @ maps
        if self.unknown is not None:
            found *= ~self.unknown[:, :, None] & ~self.unknown[:, None]
        return found

    def row_maps(self, sigma: Vector) -> Iterator[RowMap]:
        """Yield row maps of samples, those with the same contacts together.

        Samples where a contact is not certain have none.  An unknown row's own part of
        a map means nothing.

        Parameters
        ----------
        sigma : ndarray, shape (rows,)
            Noise level of each row.
        """
        robot, q, contacts = self.robot, self.q, self.contacts
        down = _down(robot, contacts, self.rotation)
        certain = np.ones(len(q), dtype=bool)
        for flags in contacts:
            certain &= flags.certain
        closed = np.array([flags.closed for flags in contacts]).reshape(-1, len(q)).T
        patterns, which = np.unique(closed, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            samples = np.flatnonzero(certain & (which.ravel() == number))
            if not len(samples):
                continue
            pairs = zip(contacts, pattern, strict=True)
            touching = [flags for flags, touches in pairs if touches]
            below = None if down is None else down[samples]
            held = [_pushes(robot, q[samples], flags, below) for flags in touching]
            nothing = np.zeros((len(samples), 6 + len(robot), 0))
            pushes = np.concatenate([nothing, *held], axis=2)[:, self.rows]
            if self.unknown is not None:
                pushes[self.unknown[samples]] = 0.0
            yield from _null_spaces(samples, pushes / sigma[:, None], sigma)

    def chunks(self) -> Iterator[tuple[slice, Array]]:
        """Yield samples and their `maps`, in constant memory."""
        for part in chunks(len(self.q), CHUNK):
            yield part, self.samples(part).maps

    @property
    def shares(self) -> Matrix:
        """Remaining share of each row's squared noise, shape (samples, rows)."""
        parts = [np.diagonal(maps, axis1=1, axis2=2) for _, maps in self.chunks()]
        return np.concatenate(parts)

    def mixed(self, values: Matrix) -> Matrix:
        """Return torques without contact forces, shape (samples, rows)."""
        parts = [(M @ values[part, :, None])[:, :, 0] for part, M in self.chunks()]
        return np.concatenate(parts)


def unmeasured_contacts(recording: Recording) -> tuple[ContactFlags, ...]:
    """Return the contacts at whose frames no wrench was measured."""
    measured = {wrench.frame for wrench in recording.wrenches}
    return tuple(c for c in recording.contacts if c.frame not in measured)


def contact_mixing(
    robot: RobotModel,
    rows: tuple[str, ...],
    recording: Recording,
    unknown: BoolArray | None = None,
) -> ContactMixing | None:
    """Return the mixing of a recording's rows; None if no contact force is unknown.

    See `ContactMixing.unknown`.
    """
    contacts = unmeasured_contacts(recording) if robot.floating else ()
    if not contacts:
        return None
    if rows == (CONTACT_FREE,):
        raise ProblemError(
            f"rows {CONTACT_FREE!r} have no residuals of their own; use the robot's "
            "model with all its rows, of which build_regression takes contact forces"
        )
    every = row_names(robot)
    return ContactMixing(
        robot,
        np.array([every.index(name) for name in rows]),
        joint_positions(robot, recording),
        contacts,
        None if recording.base is None else recording.base.rotation,
        unknown,
    )


def contact_slip(robot: RobotModel, recording: Recording) -> Matrix:
    """Return the speed of each closed contact against the mean of all closed ones.

    Parameters
    ----------
    robot : RobotModel
        Robot with a floating base.
    recording : Recording
        With velocity, base motion and contacts.

    Returns
    -------
    ndarray, shape (samples, contacts), [m/s]
        Zero for open contacts, and where one alone is closed.

    Raises
    ------
    RecordingError
        If velocity, base motion or contacts are missing.
    """
    log, base, contacts = (
        recording.of(robot.joint_names),
        recording.base,
        recording.contacts,
    )
    if log.velocity is None or base is None or not contacts:
        raise RecordingError(
            f"{recording.name}: slip shows in velocity, base motion and contacts, of "
            "which one is missing"
        )
    moving = np.hstack([base.angular_velocity, log.velocity])
    pushes = contact_pushes(robot, log.position, contacts, base.rotation)
    speeds = np.stack(
        [np.einsum("nri,nr->ni", P[:, 3:, :3], moving) for P in pushes], 1
    )
    closed = np.stack([flags.closed for flags in contacts], axis=1)[..., None]
    mean = (speeds * closed).sum(axis=1) / np.maximum(closed.sum(axis=1), 1)
    return np.asarray(np.linalg.norm((speeds - mean[:, None]) * closed, axis=2))


def without_slip(robot: RobotModel, recording: Recording, speed: float) -> Recording:
    """Return a recording whose contacts are not certain while one of them slips.

    Parameters
    ----------
    robot, recording
        See `contact_slip`.
    speed : float, [m/s]
        From which on a contact slips; noise of velocities should be well below.
    """
    if not speed > 0.0:
        raise ProblemError(f"speed of slip is {speed} m/s, expected a positive number")

    def change(whole: Recording) -> Recording:
        slow = (contact_slip(robot, whole) < speed).all(axis=1)
        contacts = tuple(replace(c, certain=c.certain & slow) for c in whole.contacts)
        return replace(whole, contacts=contacts)

    return altered(recording, change)


@kept_with(1, most=4)
def mixing_of(model: TorqueModel, recording: Recording) -> ContactMixing | None:
    """Return the mixing of a recording's rows, with its maps kept in memory.

    A study goes along the same few recordings again and again, and finding maps takes
    longer than all other work with them.
    """
    unknown = unknown_rows(model, recording)
    found = contact_mixing(model.robot, model.torque_joints, recording, unknown)
    return None if found is None else found.holding()


def unknown_rows(model: TorqueModel, recording: Recording) -> BoolArray | None:
    """Return where a row contains unknown torque, shape (samples, rows)."""
    known, joints = recording.torque_known, recording.joints
    if known is None or known.all():
        return None
    rows = [
        ~known[:, joints.index(name)] if name in joints else np.zeros(len(known), bool)
        for name in model.torque_joints
    ]
    return np.column_stack(rows)
