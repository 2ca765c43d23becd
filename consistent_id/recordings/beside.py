"""Measurements beside the joints: motion of the base, wrenches and contacts."""

from dataclasses import dataclass, field, replace
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    array_default,
    checked,
    freeze,
    freeze_arrays,
)
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError

_BASE_CHANNELS = ("angular_velocity", "angular_acceleration", "specific_force")

Axes = Literal["frame", "base", "world"]


@brief
@dataclass(frozen=True, slots=True, eq=False)
class BaseMotion:
    """Motion of a base, in the axes of its own frame.

    Dynamics need nothing else: position and heading have no effect.

    Parameters
    ----------
    angular_velocity : array_like, shape (samples, 3), [rad/s]
    angular_acceleration : array_like, shape (samples, 3), [rad/s^2]
    specific_force : array_like, shape (samples, 3), [m/s^2]
        Acceleration of the frame's origin less gravity: what an accelerometer at the
        origin measures.  At rest and upright it is (0, 0, 9.81).
    rotation : array_like, shape (samples, 3, 3), optional
        Rotation of the base frame in the world: it transforms wrenches given in world
        axes.

    Raises
    ------
    RecordingError
        If shapes differ or a value is not finite.

    Examples
    --------
    >>> at_rest = BaseMotion.at_rest(2)
    >>> at_rest.specific_force[0].tolist(), len(at_rest)
    ([0.0, 0.0, 9.81], 2)
    """

    angular_velocity: Matrix
    angular_acceleration: Matrix
    specific_force: Matrix
    rotation: Array | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.angular_velocity))
        shapes: dict[str, tuple[int | None, ...]] = dict.fromkeys(
            _BASE_CHANNELS, (n, 3)
        )
        freeze_arrays(self, shapes, "base motion", RecordingError)
        if self.rotation is not None:
            freeze_arrays(self, {"rotation": (n, 3, 3)}, "base motion", RecordingError)

    def __len__(self) -> int:
        return len(self.angular_velocity)

    @classmethod
    def at_rest(cls, samples: int, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> Self:
        """Return the motion of a base that stands still, its axes those of gravity.

        Parameters
        ----------
        samples : int
        gravity : array_like, shape (3,), [m/s^2]
            In the base frame.
        """
        still = np.zeros((samples, 3))
        g = checked(gravity, (3,), "gravity")
        return cls(still, still, still - g, np.tile(np.eye(3), (samples, 1, 1)))

    @classmethod
    def from_world(
        cls,
        rotation: ArrayLike,
        angular_velocity: ArrayLike,
        angular_acceleration: ArrayLike,
        acceleration: ArrayLike,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
    ) -> Self:
        """Convert a motion that is given in world axes.

        Parameters
        ----------
        rotation : array_like, shape (samples, 3, 3)
            Rotation of the base frame in the world.
        angular_velocity, angular_acceleration : array_like, shape (samples, 3)
        acceleration : array_like, shape (samples, 3), [m/s^2]
            Acceleration of the base frame's origin, without gravity: zero at rest.
        gravity : array_like, shape (3,), [m/s^2]
        """
        R = checked(rotation, (None, 3, 3), "rotation")
        into = np.swapaxes(R, 1, 2)
        w, dw, a = (
            checked(x, (len(R), 3), "base motion")
            for x in (angular_velocity, angular_acceleration, acceleration)
        )
        felt = a - checked(gravity, (3,), "gravity")
        w, dw, felt = ((into @ x[..., None])[..., 0] for x in (w, dw, felt))
        return cls(w, dw, felt, R)

    def samples(self, keep: slice | IntArray) -> "BaseMotion":
        """Return a run of samples."""
        return BaseMotion(
            self.angular_velocity[keep],
            self.angular_acceleration[keep],
            self.specific_force[keep],
            None if self.rotation is None else self.rotation[keep],
        )

    @property
    def stacked(self) -> Matrix:
        """The three channels beside each other, shape (samples, 9)."""
        return np.hstack([getattr(self, channel) for channel in _BASE_CHANNELS])


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """Force and moment on the robot from outside, at a point of one of its frames.

    Parameters
    ----------
    frame : str
        A link of the robot, or one that is fixed to it.
    values : array_like, shape (samples, 6), [N, N m]
        Force, then moment about the point, both acting on the robot.  The wrench that a
        foot exerts on the ground has the opposite sign.
    point : array_like, shape (3,), [m]
        In the frame.
    axes : {"frame", "base", "world"}
        Axes of `values`.  World axes need `BaseMotion.rotation`.
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


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ContactFlags:
    """Contact of a point, or a flat face, of the robot with its surroundings.

    Parameters
    ----------
    frame : str
        A link of the robot, or one that is fixed to it.
    closed : array_like of bool, shape (samples,)
        Whether it touches.
    point : array_like, shape (3,), [m]
        Point of the contact, in the frame.
    radius : float, [m]
        Radius of a foot that is a ball about the point and rolls on level ground: the
        contact is below the point.  Needs `BaseMotion.rotation`.
    surface : bool
        Whether moments are transmitted too, as by the sole of a humanoid's foot.
    certain : array_like of bool, shape (samples,), optional
        Where this is false, for example around touch-down or while the point slips,
        samples have no rows.  By default true.
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
        """Return the contact flags of a measured force.

        Parameters
        ----------
        wrench : Wrench
        threshold : float, [N]
            Least force of a contact.
        guard : int
            Samples before and after touch-down and lift-off that are not certain.
        radius : float, [m]
        """
        closed = np.linalg.norm(wrench.values[:, :3], axis=1) > threshold
        certain = away_from_changes(closed, np.arange(float(len(closed))), guard)
        return cls(wrench.frame, closed, wrench.point, certain=certain, radius=radius)


def away_from_changes(closed: BoolArray, time: Vector, guard: float) -> BoolArray:
    """Return the samples that are further than a guard from any change of a flag.

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
