"""Where a robot touches its surroundings, and the wrenches that were measured there."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from consistent_id._support.arrays import (
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    array_default,
    freeze,
    freeze_arrays,
)
from consistent_id.errors import RecordingError

Axes = Literal["frame", "base", "world"]


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """Force and moment on the robot from outside, at a point of one of its frames.

    Parameters
    ----------
    frame : str
        A link of the robot, or one that is fixed to it.
    values : array_like, shape (samples, 6), [N, N m]
        Force, then moment about the point, both as they act on the robot.  A sensor
        under a foot measures that; one that measures what the foot does to the ground
        has the opposite sign.
    point : array_like, shape (3,), [m]
        In the frame.
    axes : {"frame", "base", "world"}
        Whose axes `values` are given in.  World axes need `BaseMotion.rotation`.
    """

    frame: str
    values: Matrix
    point: Vector = array_default((0.0, 0.0, 0.0))
    axes: Axes = "frame"

    def __post_init__(self) -> None:
        where = f"wrench at {self.frame!r}"
        shapes: dict[str, tuple[int | None, ...]] = {"values": (None, 6), "point": (3,)}
        freeze_arrays(self, shapes, where, RecordingError)
        if self.axes not in get_args(Axes):
            known = ", ".join(get_args(Axes))
            raise RecordingError(
                f"{where}: axes {self.axes!r}, expected one of {known}"
            )

    def __len__(self) -> int:
        return len(self.values)

    def samples(self, keep: slice | IntArray) -> "Wrench":
        """Return a run of samples."""
        return replace(self, values=self.values[keep])


@dataclass(frozen=True, slots=True, eq=False)
class ContactFlags:
    """When a point, or a flat face, of the robot is held by its surroundings.

    Parameters
    ----------
    frame : str
        A link of the robot, or one that is fixed to it.
    closed : array_like of bool, shape (samples,)
        Whether it touches.
    point : array_like, shape (3,), [m]
        Of the contact, in the frame.
    radius : float, [m]
        Of a foot that is a ball about the point and rolls on level ground: the contact
        is below the point.  Needs `BaseMotion.rotation`.
    surface : bool
        Whether moments are transmitted too, as by the sole of a humanoid's foot.
    certain : array_like of bool, shape (samples,), optional
        Where this is false, as around touch-down or where the point slips by more than
        it should, samples have no rows.  By default true.
    """

    frame: str
    closed: BoolArray
    point: Vector = array_default((0.0, 0.0, 0.0))
    surface: bool = False
    certain: BoolArray = field(default_factory=lambda: np.ones(0, dtype=bool))
    radius: float = 0.0

    def __post_init__(self) -> None:
        where = f"contact at {self.frame!r}"
        freeze_arrays(self, {"point": (3,)}, where, RecordingError)
        closed = _flags(self.closed, where)
        certain = np.asarray(self.certain)
        certain = _flags(certain, where) if certain.size else np.ones(len(closed), bool)
        if len(certain) != len(closed):
            raise RecordingError(
                f"{where}: certain has {len(certain)} samples, closed has {len(closed)}"
            )
        freeze(self, closed=closed, certain=certain)

    def __len__(self) -> int:
        return len(self.closed)

    def samples(self, keep: slice | IntArray) -> "ContactFlags":
        """Return a run of samples."""
        return replace(self, closed=self.closed[keep], certain=self.certain[keep])

    @classmethod
    def from_wrench(
        cls, wrench: Wrench, *, threshold: float, guard: int = 0, radius: float = 0.0
    ) -> "ContactFlags":
        """Return when a measured force says that there is contact.

        Parameters
        ----------
        wrench : Wrench
        threshold : float, [N]
            Force from which on there is contact.
        guard : int
            Samples before and after touch-down and lift-off that are not certain.
        radius : float, [m]
        """
        closed = np.linalg.norm(wrench.values[:, :3], axis=1) > threshold
        certain = away_from_changes(closed, np.arange(float(len(closed))), guard)
        return cls(wrench.frame, closed, wrench.point, certain=certain, radius=radius)


def away_from_changes(closed: BoolArray, time: Vector, guard: float) -> BoolArray:
    """Return which samples are further than a guard from any change of a flag.

    A change is halfway between two samples.
    """
    before = np.flatnonzero(np.diff(closed))
    away = np.ones(len(closed), dtype=bool)
    for change in 0.5 * (time[before] + time[before + 1]):
        away &= abs(time - change) > guard
    return away


def _flags(values: BoolArray, where: str) -> BoolArray:
    flags = np.array(values)
    if flags.ndim != 1 or flags.dtype != np.bool_:
        raise RecordingError(
            f"{where}: flags have shape {flags.shape} and type {flags.dtype}, expected "
            "one true or false per sample"
        )
    flags.setflags(write=False)
    return flags
