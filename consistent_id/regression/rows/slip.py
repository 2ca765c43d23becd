"""Contacts that slip: how fast points that are held move against each other.

Of all points at rest on the ground ``J_i [v; w; dq] = 0``.  The rate ``w`` of the base
is measured, its velocity ``v`` is not; but it is the same for all of them, so that two
contacts or more show whether one slips.
"""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.rows.contact_maps import contact_pushes
from consistent_id.robot.model import RobotModel


def contact_slip(robot: RobotModel, recording: Recording) -> Matrix:
    """Return how fast each closed contact moves against the mean of all closed ones.

    Parameters
    ----------
    robot : RobotModel
        Whose base floats.
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
    slow = (contact_slip(robot, recording) < speed).all(axis=1)
    contacts = tuple(replace(c, certain=c.certain & slow) for c in recording.contacts)
    return replace(recording, contacts=contacts)
