"""A log's names of measurements beside the joints: base, contacts, wrenches.

Several columns are a sequence of names, or one name of an array with as many columns;
of a larger array, ``name[first:end]`` selects some, counted from 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    array_default,
    freeze_arrays,
)
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import (
    Axes,
    BaseMotion,
    ContactFlags,
    Wrench,
    away_from_changes,
)
from consistent_id.recordings.signals.base_signals import (
    QuaternionOrder,
    base_from_imu,
    base_from_pose,
    moved_by_stretch,
    rotations,
)
from consistent_id.recordings.time_stamps import SampleError

Names = str | Sequence[str]
"""One array's name, or a name for each column."""

_CLOSED = 0.5  # threshold of a flag that is 0 or 1


@brief
@dataclass(frozen=True, slots=True)
class BaseColumns:
    """Names of the measurements of a floating base.

    Either an inertial measurement unit, `angular_velocity` and `acceleration`, or a
    pose, `position` and `orientation`.  If both are given, the unit is used; the
    orientation transforms wrenches in world axes, and gives the direction of gravity.

    Parameters
    ----------
    angular_velocity : str or sequence of str, optional, [rad/s]
        Gyroscope, three columns.
    acceleration : str or sequence of str, optional, [m/s^2]
        Accelerometer, three columns: +9.81 along z at rest and upright.
    position : str or sequence of str, optional, [m]
        Position of the base frame's origin in the world, three columns.
    orientation : str or sequence of str, optional
        Orientation of the base frame in the world: a unit quaternion, four columns.
    order : {"xyzw", "wxyz"}
        Order of the quaternion.
    imu_position : array_like, shape (3,), [m]
        Position of the unit in the base frame.
    imu_orientation : array_like, shape (4,)
        Orientation of the unit in the base frame, a quaternion in the same order; by
        default it is aligned.
    """

    angular_velocity: Names | None = None
    acceleration: Names | None = None
    position: Names | None = None
    orientation: Names | None = None
    order: QuaternionOrder = "xyzw"
    imu_position: Vector = array_default((0.0, 0.0, 0.0))
    imu_orientation: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self, {"imu_position": (3,)}, "base columns", RecordingError)
        if not self._has_unit and not self._has_pose:
            raise RecordingError(
                "the motion of the base needs angular_velocity and acceleration (of an "
                "inertial measurement unit), or position and orientation"
            )

    @property
    def _has_unit(self) -> bool:
        return self.angular_velocity is not None and self.acceleration is not None

    @property
    def _has_pose(self) -> bool:
        return self.position is not None and self.orientation is not None

    @property
    def names(self) -> list[str]:
        """Every name."""
        place = None if self._has_unit else self.position
        every = self.angular_velocity, self.acceleration, place, self.orientation
        return [name for names in every for name in names_of(names)]

    def motion(self, arrays: "Arrays", time: Vector, where: str) -> BaseMotion:
        """Return the motion of the base, not filtered; across no gap of the clock."""

        def read(names: Names | None, width: int) -> Matrix:
            return columns(arrays, names or "", (width,), len(time), where)

        if not self._has_unit:
            position, quaternions = read(self.position, 3), read(self.orientation, 4)
            return moved_by_stretch(
                lambda part: base_from_pose(
                    time[part],
                    position[part],
                    quaternions[part],
                    order=self.order,
                    cutoff=None,
                ),
                time,
                where,
            )
        turned: Array | None = None
        if self.orientation is not None:
            turned = rotations(read(self.orientation, 4), self.order)
        gyroscope = read(self.angular_velocity, 3)
        accelerometer = read(self.acceleration, 3)
        mounting = None
        if self.imu_orientation is not None:
            mounting = rotations([self.imu_orientation], self.order)[0]
        return moved_by_stretch(
            lambda part: base_from_imu(
                time[part],
                gyroscope[part],
                accelerometer[part],
                cutoff=None,
                position=self.imu_position,
                mounting=mounting,
                rotation=None if turned is None else turned[part],
            ),
            time,
            where,
        )


@brief
@dataclass(frozen=True, slots=True)
class ContactColumns:
    """Name of a contact's flag, or of a contact force.

    Parameters
    ----------
    frame : str
        A link of the robot, or one that is fixed to it.
    closed : str or bool
        Column of a flag, or of a force; or whether there is contact all the time.
    threshold : float
        Least value of the column in contact.
    guard : float, [s]
        Time before and after each change of the flag in which samples are not certain.
    point, surface, radius
        See `ContactFlags`.
    """

    frame: str
    closed: str | bool
    threshold: float = _CLOSED
    guard: float = 0.0
    point: Vector = array_default((0.0, 0.0, 0.0))
    surface: bool = False
    radius: float = 0.0

    def flags(self, arrays: "Arrays", time: Vector, where: str) -> ContactFlags:
        """Return the contact flags."""
        if isinstance(self.closed, str):
            values = columns(arrays, self.closed, (1,), len(time), where)[:, 0]
            closed = values > self.threshold
        else:
            closed = np.full(len(time), self.closed)
        return ContactFlags(
            self.frame,
            closed,
            self.point,
            self.surface,
            away_from_changes(closed, time, self.guard),
            self.radius,
        )


@brief
@dataclass(frozen=True, slots=True)
class WrenchColumns:
    """Names of a measured force and moment.

    Parameters
    ----------
    frame : str
        A link of the robot, or one that is fixed to it.
    values : str or sequence of str, [N, N m]
        Six columns, the force first; or three of a force without a moment.
    on_robot : bool
        Whether they act on the robot; else on its surroundings.
    point, axes
        See `Wrench`.
    """

    frame: str
    values: Names
    on_robot: bool = True
    point: Vector = array_default((0.0, 0.0, 0.0))
    axes: Axes = "frame"

    def wrench(self, arrays: "Arrays", time: Vector, where: str) -> Wrench:
        """Return the wrench on the robot."""
        measured = columns(arrays, self.values, (3, 6), len(time), where)
        whole = np.zeros((len(time), 6))
        whole[:, : measured.shape[1]] = measured if self.on_robot else -measured
        return Wrench(self.frame, whole, self.point, self.axes)


Arrays = Mapping[str, NDArray[np.generic]]


@brief
@dataclass(frozen=True, slots=True)
class BesideColumns:
    """Names of all measurements beside the joints.

    Parameters
    ----------
    base : BaseColumns, optional
    contacts : sequence of ContactColumns
    wrenches : sequence of WrenchColumns
    """

    base: BaseColumns | None = None
    contacts: Sequence[ContactColumns] = ()
    wrenches: Sequence[WrenchColumns] = ()

    @property
    def names(self) -> list[str]:
        """Every name."""
        found = [] if self.base is None else self.base.names
        found += [c.closed for c in self.contacts if isinstance(c.closed, str)]
        return found + [n for wrench in self.wrenches for n in names_of(wrench.values)]

    def __bool__(self) -> bool:
        return bool(self.base or self.contacts or self.wrenches)


def columns(
    arrays: Arrays, names: Names, widths: tuple[int, ...], samples: int, where: str
) -> Matrix:
    """Return columns side by side, of the allowed number, shape (samples, any).

    Raises
    ------
    RecordingError
        If there are more or fewer, or they do not contain numbers.
    """
    parts = []
    for name in names_of(names):
        raw = np.asarray(arrays[name])
        if raw.dtype.kind not in "biuf":
            raise RecordingError(
                f"{where}: column {name!r} holds {raw.dtype}, expected numbers"
            )
        values: Matrix = raw.astype(np.float64)
        if values.ndim == 2 and len(values) != samples:
            values = values.T
        if values.ndim > 2 or len(values) != samples:
            raise RecordingError(
                f"{where}: {name!r} has shape {values.shape}, expected {samples} "
                "samples, as many as there are times"
            )
        parts.append(values.reshape(samples, -1))
    found = np.hstack(parts)
    if found.shape[1] not in widths:
        raise RecordingError(
            f"{where}: {', '.join(names_of(names))}: {found.shape[1]} columns, "
            f"expected {' or '.join(map(str, widths))}; select some columns of a "
            f"larger array with name[first:end]"
        )
    finite = np.isfinite(found).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise SampleError(
            f"{where}: {', '.join(names_of(names))}: {found[bad]} at sample {bad}; "
            "remove or repair those samples"
        )
    return found


def names_of(names: Names | None) -> list[str]:
    """Return every name."""
    if names is None:
        return []
    return [names] if isinstance(names, str) else list(names)
