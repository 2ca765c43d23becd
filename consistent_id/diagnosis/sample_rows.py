"""Rows of a log at each of its samples, filtered like its torque.

The friction of a filtered speed is not the filtered friction.  So every column that a
diagnosis compares with a filtered torque is computed at all samples from before the
filter, and passes the same filter: ``F Y x = F tau`` holds exactly for a log without
noise.  Torque and motion are changed before the filter, too (`altered`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.caches import kept_with
from consistent_id.recordings.recording import Recording
from consistent_id.regression.motion_arrays import Motion, RowColumns
from consistent_id.regression.position_slopes import position_slopes
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel

_SPEEDS = (0.01, 0.05, 0.25)  # shares of top speed at which friction changes


@dataclass(frozen=True, slots=True, eq=False)
class SampleRows:
    """Rows at the samples of a log.

    Parameters
    ----------
    model : TorqueModel
        With a fixed base.
    motion : Motion
        With a row for each sample; its arrays are in the model's order of joints.
    """

    model: TorqueModel
    motion: Motion

    @classmethod
    def of(cls, model: TorqueModel, recording: Recording) -> "SampleRows":
        """Return the rows of a prepared recording.

        Raises
        ------
        RecordingError
            See `motion_of`.
        """
        return cls(model, _every_sample(model, recording))

    @property
    def torque(self) -> Matrix:
        """Measured torque, shape (torque joints, samples)."""
        return self.motion.torque.T

    @property
    def along(self) -> Motion:
        """The motion before the filter; the samples themselves, without one."""
        return self.motion.along

    @property
    def speed(self) -> Matrix:
        """Velocity of the torque joints along `along`, shape (joints, its samples)."""
        return self.along.dq[:, self._driven].T

    @property
    def change(self) -> Matrix:
        """Acceleration of the torque joints, as `speed`."""
        return self.along.ddq[:, self._driven].T

    @property
    def place(self) -> Matrix:
        """Position of the torque joints, as `speed`."""
        return self.along.q[:, self._driven].T

    @property
    def _driven(self) -> list[int]:
        names = self.model.robot.joint_names
        return [names.index(name) for name in self.model.torque_joints]

    def at_rest(self, bodies: Vector, gravity: Vector) -> Matrix:
        """Return the torque of bodies at the same positions, without motion.

        Parameters
        ----------
        bodies : ndarray, shape (10 links,)
        gravity : ndarray, shape (3,), [m/s^2]

        Returns
        -------
        ndarray, shape (torque joints, samples)
        """
        robot = replace(self.model.robot, gravity=gravity)
        bare = TorqueModel(robot, torque_joints=self.model.torque_joints)
        torque = bare.rigid_torque(bodies, (self.along.q, None, None))
        return self.filtered(torque.T[:, None])[:, 0]

    def regressor(self) -> Array:
        """Return all columns, shape (torque joints, parameters, samples)."""
        return self.motion.regressor(self.model)

    def own(self) -> list[RowColumns]:
        """Return the columns that each torque joint has, as `regressor`."""
        return self.motion.row_columns(self.model)

    def predicted(self, x: Vector) -> Matrix:
        """Return the torque of parameters, shape (torque joints, samples)."""
        return self.motion.predicted(self.model, x).T

    def filtered(self, columns: Array) -> Array:
        """Return other columns of each joint's own row, filtered like its torque.

        Parameters
        ----------
        columns : ndarray, shape (torque joints, columns, samples of `along`)

        Returns
        -------
        ndarray, shape (torque joints, columns, samples)
        """
        through = self.motion.through
        return np.stack([through(own.T, j).T for j, own in enumerate(columns)])

    def smooth_torque(self) -> Matrix:
        """Return the filtered torque along `along`, shape (torque joints, samples)."""
        rows = self.motion.filtered
        if rows is None:
            return self.torque
        every = np.arange(len(rows.along.q))
        return replace(rows, kept=every).through(rows.along.torque).T

    def frictions(self, torque: Matrix) -> Array:
        """Return shapes of friction that models may lack, (joints, shapes, samples).

        Parameters
        ----------
        torque : ndarray, shape (torque joints, samples of `along`)
            Transmitted torque, on which friction may depend.
        """
        return self.filtered(frictions(self.speed, torque))

    def slopes_by_position(self, x: Vector, joints: Sequence[int]) -> Array:
        """Return slopes of the torque over positions of some joints.

        Parameters
        ----------
        x : ndarray, shape (parameters,)
        joints : sequence of int

        Returns
        -------
        ndarray, shape (torque joints, joints given, samples)
        """
        return self.filtered(position_slopes(self.model, x, self.along[:3], joints))


@kept_with(1, most=4)
def _every_sample(model: TorqueModel, recording: Recording) -> Motion:
    """Return a row for each sample, the same ones each time: their columns are kept.

    A regression keeps few rows in a period of the cut-off.  A diagnosis shifts and
    differentiates them.
    """
    motion, behind = motion_of(model, recording, None), recording.torque_filter
    if motion.filtered is None or behind is None:
        return motion
    rows, along, at = motion.filtered, motion.along, behind.kept
    rows = replace(rows, kept=at)
    return Motion(
        along.q[at],
        along.dq[at],
        along.ddq[at],
        torque=rows.through(along.torque),
        weights=None,
        filtered=rows,
    )


def frictions(speed: Matrix, torque: Matrix) -> Array:
    """Return shapes of friction at samples, (joints, shapes, samples).

    These are friction at several velocity scales, whose differences are Stribeck
    friction, and friction that grows with the transmitted torque.
    """
    fastest = np.maximum(abs(speed).max(axis=1, keepdims=True), 1e-300)
    shapes = [np.tanh(speed / (share * fastest)) for share in _SPEEDS]
    return np.stack([*shapes, abs(torque) * shapes[0]], axis=1)


def of_own_row(columns: Array) -> Array:
    """Return columns that are zero in other joints' rows, (joints, all, samples)."""
    joints, shapes, samples = columns.shape
    rows = np.zeros((joints, joints, shapes, samples))
    rows[range(joints), range(joints)] = columns
    return rows.reshape(joints, joints * shapes, samples)
