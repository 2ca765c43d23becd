"""Where joints are and how they move, at one time."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, freeze, freeze_arrays, frozen
from consistent_id.recordings.paths import JointPath


@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """Where joints are and how they move, at one time.

    Parameters
    ----------
    joints : tuple of str
    values : array_like, shape (4, joints)
        Position [rad or m], velocity, acceleration and jerk.

    Examples
    --------
    >>> MotionState.at_rest(("elbow",), [0.3]).values[:, 0].tolist()
    [0.3, 0.0, 0.0, 0.0]
    """

    joints: tuple[str, ...]
    values: Matrix

    def __post_init__(self) -> None:
        freeze(self, joints=tuple(self.joints))
        freeze_arrays(self, {"values": (4, len(self.joints))}, "state")

    @classmethod
    def at_rest(cls, joints: tuple[str, ...], position: ArrayLike) -> Self:
        """Return a pose, shape (joints,), [rad or m], that is not left."""
        pose = frozen(position, (len(joints),), "pose")
        return cls(joints, np.vstack([pose, np.zeros((3, len(pose)))]))

    @classmethod
    def of(cls, path: JointPath, time: float) -> Self:
        """Return the state that a path has at a time [s]."""
        return cls(path.joints, path.evaluate([time], derivatives=3)[:, 0])
