"""The errors a user can meet.

Each message says what was seen (file, row, joint, value, unit), what was
expected, and what to do about it.
"""

from collections.abc import Callable
from functools import partial


class ConsistentIdError(Exception):
    """Root of every error that the package raises on purpose."""


class ModelError(ConsistentIdError):
    """The robot's description cannot be used as it is."""


class RecordingError(ConsistentIdError):
    """A recording cannot be read, or holds values that no robot wrote."""


class ProblemError(ConsistentIdError):
    """A problem file, or a call, asks for something that makes no sense."""


class PathError(ProblemError):
    """A robot cannot follow a path; the attributes say where.

    Parameters
    ----------
    reason : str
    arc_length : float, [m]
        From the path's start.
    time : float, [s]
    point : tuple of float, [m]
        Where the path is then, in the base frame.
    joint : str, optional
        Whose limit is in the way.
    value : float
        What was seen: of a joint's position or rate; of a condition number; of the
        distance [m] to the nearest point within reach.
    """

    def __init__(
        self,
        reason: str,
        *,
        arc_length: float,
        time: float,
        point: tuple[float, float, float],
        value: float,
        joint: str | None = None,
    ) -> None:
        x, y, z = point
        super().__init__(
            f"{arc_length:.4g} m along the path (t = {time:.4g} s, "
            f"x = {x:.4g}, y = {y:.4g}, z = {z:.4g} m): {reason}"
        )
        self.reason, self.joint, self.value = reason, joint, value
        self.arc_length, self.time, self.point = arc_length, time, point

    def __reduce__(self) -> tuple[Callable[..., "PathError"], tuple[str]]:
        """Let it come back from another process, which keywords alone would not."""
        place = {
            name: getattr(self, name)
            for name in ("arc_length", "time", "point", "value", "joint")
        }
        return partial(PathError, **place), (self.reason,)


class NotExcitedError(ConsistentIdError):
    """The motion carries no information on the required parameters."""


class InfeasibleError(ConsistentIdError):
    """No parameters satisfy the stated constraints.

    Parameters
    ----------
    reason : str
    members : tuple of int
        Constraints that contradict each other, counted as in `ConicSet.labels` of those
        stated; empty where they were not searched for.
    """

    def __init__(self, reason: str = "", members: tuple[int, ...] = ()) -> None:
        super().__init__(reason)
        self.members = members

    def __reduce__(self) -> tuple[Callable[..., "InfeasibleError"], tuple[object, ...]]:
        """Let it come back from another process with its members."""
        return InfeasibleError, (str(self), self.members)


class SolverError(ConsistentIdError):
    """A numerical solver ended without a usable answer."""
