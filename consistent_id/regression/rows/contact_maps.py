"""Row maps that no contact force passes: null spaces of contact Jacobians.

With contacts closed whose forces are not measured,
``[Y_b; Y_j] x = [0; tau] + J_c^T f_c`` is multiplied, sample by sample, by
``Z^T S^-1``: ``S`` holds the rows' noise levels, and the orthonormal columns of ``Z``
span all that is perpendicular to ``S^-1 J_c^T``.  White noise of these levels stays
white, of variance one.  ``n + 6 - rank J_c`` rows are left, as many as the contacts
leave.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.contacts import ContactFlags
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import row_names
from consistent_id.regression.rows.generalised_forces import (
    contact_jacobian,
    measured_forces,
)
from consistent_id.robot.model import RobotModel

_DEPENDENT = 1e-8
"""Size of a Jacobian's row beyond those before it, relative to the largest, that is
none: two points of one foot on a line push alike along it, to rounding."""


class RowMap(NamedTuple):
    """The row maps of samples that have equally many rows left.

    Attributes
    ----------
    samples : ndarray of int, shape (samples,)
        Which samples of the recording.
    maps : ndarray, shape (samples, rows, 6 + joints)
        ``L_t = Z_t^T S^-1``.
    """

    samples: IntArray
    maps: Array


def contact_maps(
    robot: RobotModel,
    q: Matrix,
    contacts: Sequence[ContactFlags],
    sigma: Vector,
    rotation: Array | None = None,
    *,
    rows: IntArray | None = None,
    unknown: BoolArray | None = None,
) -> Iterator[RowMap]:
    """Yield row maps of samples, those with the same contacts together.

    Samples where a contact is not certain have none.

    Parameters
    ----------
    robot : RobotModel
        Whose base floats.
    q : ndarray, shape (samples, joints), [rad or m]
    sigma : ndarray, shape (rows,)
        Noise level of each row.
    rotation : ndarray, shape (samples, 3, 3), optional
        Of the base in the world, for contacts with a radius.
    rows : ndarray of int, shape (rows,), optional
        Which of `row_names` there are; by default all.
    unknown : ndarray of bool, shape (samples, rows), optional
        Rows of which contacts take nothing; their own part of a map means nothing.
    """
    there = np.arange(6 + len(robot)) if rows is None else rows
    down = _down(robot, contacts, rotation)
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
        pushes = np.concatenate([nothing, *held], axis=2)[:, there]
        if unknown is not None:
            pushes[unknown[samples]] = 0.0
        yield from _null_spaces(samples, pushes / sigma[:, None], sigma)


def contact_pushes(
    robot: RobotModel,
    q: Matrix,
    contacts: Sequence[ContactFlags],
    rotation: Array | None = None,
) -> list[Array]:
    """Return ``J_c^T`` of each contact, shape (samples, 6 + joints, 3 or 6).

    Parameters as of `contact_maps`.
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
            f"contact at {round_feet[0]!r} has a radius, but where down is is not "
            "known; give BaseMotion(..., rotation=...), and a robot with gravity"
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
    """Return what row maps leave of the measured wrenches: zero, if contacts are right.

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
            f"{recording.name}: no wrench was measured, so that nothing tells whether "
            "the contacts are right; give Recording(..., wrenches=...)"
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
    levels = np.ones(len(names))
    for found in contact_maps(robot, q, recording.contacts, levels, turned):
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
        Of the base rows: what errors of its measured acceleration make of the robot's
        whole mass.
    joints : float, [N m or N]
        Of the joints' torques.
    """
    if min(force, moment, joints) <= 0.0:
        raise ProblemError(
            f"noise levels are {force:g} N, {moment:g} N m and {joints:g} of joints, "
            "expected positive numbers"
        )
    return np.array([force] * 3 + [moment] * 3 + [joints] * len(robot))
