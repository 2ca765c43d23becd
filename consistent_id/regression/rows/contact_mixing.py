"""Rows of which unmeasured contact forces are taken out, each under its own name.

The row maps ``L_t`` of `contact_maps` leave rows that have no names, and other ones at
every sample.  Here they are turned back, ``L_t^T L_t`` with all levels one: the part of
each row that no contact force enters.  There are as many rows as before, so noise,
residuals and weights keep their meaning row by row; together they hold what the fewer
rows hold.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix
from consistent_id.errors import ProblemError
from consistent_id.recordings.contacts import ContactFlags
from consistent_id.recordings.recording import Recording
from consistent_id.regression.row_names import CONTACT_FREE, row_names
from consistent_id.regression.rows.contact_maps import contact_maps
from consistent_id.regression.rows.generalised_forces import joint_positions
from consistent_id.robot.model import RobotModel

_CHUNK = 512
"""Samples per chunk: of 18 rows and 130 columns, 10 MB."""

_MOST = 2**27
"""Bytes of maps that are held of a recording: 50 000 samples of 18 rows."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactMixing:
    """How rows are mixed so that no contact force is left in them.

    Parameters
    ----------
    rows : ndarray of int
        Which of `row_names` there are.
    q : ndarray, shape (samples, joints), [rad or m]
    contacts : tuple of ContactFlags
        Those whose forces are not measured.
    rotation : ndarray, shape (samples, 3, 3), optional
        Of the base in the world.
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
        state = self.robot, self.q, self.contacts, levels, self.rotation
        for group in contact_maps(*state, rows=self.rows, unknown=self.unknown):
            maps = group.maps
            found[group.samples] = np.swapaxes(maps, 1, 2) @ maps
        if self.unknown is not None:
            found *= ~self.unknown[:, :, None] & ~self.unknown[:, None]
        return found

    def chunks(self) -> Iterator[tuple[slice, Array]]:
        """Yield samples and their `maps`, in constant memory."""
        for start in range(0, len(self.q), _CHUNK):
            part = slice(start, start + _CHUNK)
            yield part, self.samples(part).maps

    def mixed(self, values: Matrix) -> Matrix:
        """Return what is left of torques, shape (samples, rows)."""
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
    """Return how a recording's rows are mixed; None if no contact force is unknown.

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
