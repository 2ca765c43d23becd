"""What joints' motion tells linearly: rows of a sensor, or of the joints' torque."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, IntArray, Matrix
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout


class RowModel(Protocol):
    """Rows of measurements, ``y = Y(q, dq, ddq) x``, such as a `TorqueModel`'s.

    Attributes
    ----------
    robot : RobotModel
        Whose joints move.
    terms : tuple of DriveTerms
        Of each of its joints.
    layout : ParameterLayout
        Of ``x``.
    torque_joints : tuple of str
        Names of the rows.
    fingerprint : str
        What belongs together has the same.
    """

    def __hash__(self) -> int:
        """Tell one from another: a `RowModel` is a value that never changes."""

    @property
    def robot(self) -> RobotModel:
        """Whose joints move."""

    @property
    def terms(self) -> tuple[DriveTerms, ...]:
        """Drive terms of each of its joints."""

    @property
    def layout(self) -> ParameterLayout:
        """Of the parameters."""

    @property
    def torque_joints(self) -> tuple[str, ...]:
        """Names of the rows."""

    @property
    def fingerprint(self) -> str:
        """What belongs together has the same."""

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        base: BaseMotion | None = None,
    ) -> Array:
        """Return ``Y``, shape (rows, parameters, samples)."""

    def chunks(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = ...,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Array]]:
        """Yield ``(samples, Y)`` piece by piece."""

    def kept_chunks(
        self,
        kept: Sequence[IntArray],
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = ...,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield ``(samples, rows)`` of some columns, piece by piece."""
