"""A recording: the data of a robot's log, checked once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from consistent_id._support.arrays import (
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    freeze,
    frozen,
)
from consistent_id._support.extras import pandas, xarray
from consistent_id._support.given_values import require_type, require_types
from consistent_id._support.tables import Table, brief
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion, ContactFlags, Wrench
from consistent_id.recordings.time_stamps import SampleError, require_stamps
from consistent_id.robot.parameters import did_you_mean

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


_MEASURED = ("position", "velocity", "acceleration", "torque")
COMMANDS = ("position_command", "velocity_command", "torque_command")
"""Commands of the controller to the joints, constant from one sample to the next."""

_CHANNELS = (*_MEASURED, *COMMANDS, "torque_shift")

Severity = Literal["fault", "warning", "note"]


def instant(at: float, time: Vector) -> str:
    """Return an instant of a log [s] as text, to less than a hundredth of its duration.

    Clocks of many logs count from 1970.

    Examples
    --------
    >>> instant(2.5, np.array([0.0, 10.0])), instant(1.7e9 + 2.5, 1.7e9 + np.arange(11))
    ('2.5', '1700000002.5')
    """
    duration = float(np.ptp(time)) or 1.0
    beyond = int(np.log10(max(float(abs(time).max()) / duration, 1.0)))
    return f"{at:.{max(4 + beyond, len(f'{abs(at):.0f}'))}g}"


@brief
@dataclass(frozen=True, slots=True, eq=False)
class TorqueFilter:
    """The low-pass filter of a recording's torque, and the samples before the filter.

    The regressor's rows have to pass the same filter as the torque:
    ``F M Y x = F M tau`` holds exactly for every friction law, while the rows of
    filtered motion hold only nearly.  ``M`` sets samples to zero that do not count.

    Parameters
    ----------
    cutoff : float, [Hz]
        At which the zero-phase filter attenuates by 6 dB.
    order : int
        Order of the one-way Butterworth filter.
    source : Recording
        All samples on a uniform clock: motion as it is used, torque before the filter.
    kept : ndarray of int, shape (samples,)
        The sample of `source` behind each sample of the recording.
    left_out : ndarray of bool, shape (samples of source,), optional
        Samples that do not count in any row; by default all count.
    first : int
        Number of the source's first sample on the clock of the whole log, of which it
        may be a window.
    thinned : int, optional
        Steps of the source between samples that thinning left; others may be missing
        besides.  By default the largest number that all distances are multiples of.
    """

    cutoff: float
    order: int
    source: "Recording"
    kept: IntArray
    left_out: BoolArray | None = None
    first: int = 0
    thinned: int | None = None

    @property
    def step(self) -> int:
        """Steps of the source between neighbouring samples of the recording."""
        if self.thinned is not None:
            return self.thinned
        return int(np.gcd.reduce(np.diff(self.kept))) if len(self.kept) > 1 else 1


@brief
@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Recording:
    """Motion and torque of named joints on one clock.

    Parameters
    ----------
    joints : tuple of str
    time : array_like, shape (samples,), [s]
        Strictly increasing.
    position : array_like, shape (samples, joints), [rad or m]
    velocity, acceleration : array_like, shape (samples, joints), optional
    torque : array_like, shape (samples, joints), optional, [N m or N]
    base : BaseMotion, optional
        Motion of the base, if it floats.
    wrenches : tuple of Wrench
        Measured forces on the robot from outside.
    contacts : tuple of ContactFlags
        Contacts of the robot with its surroundings.
    torque_known : array_like of bool, shape (samples, joints), optional
        Where a joint's torque is that of the model; elsewhere there is no row, for
        example while the joint rests and friction has any value that balances it.  By
        default true.
    name : str
        Name of the source; used in messages.
    position_command, velocity_command : array_like, shape (samples, joints), optional
        Commands of the drives, each constant from its sample to the next.
    torque_command : array_like, shape (samples, joints), optional, [N m or N]
        Feed-forward torque; `commanded` computes the torque from commands.
    torque_shift : array_like, shape (samples, joints), optional, [N m or N]
        Change of the torque by one standard error of what all samples share, such as
        the delay of commands; filtered as the torque is.
    torque_filter : TorqueFilter, optional
        If torque and wrenches are low-passed: the filter, and their values before. Set
        by `low_passed` and `decimated`; `build_regression` filters its rows alike.

    Raises
    ------
    RecordingError
        If shapes do not fit, a value is not finite or time does not increase; the
        message names channel, joint and sample.

    Examples
    --------
    >>> time = np.arange(4) * 0.001
    >>> log = Recording(("elbow",), time, np.sin(time)[:, None])
    >>> log.rate, log.velocity is None
    (1000.0, True)
    """

    joints: tuple[str, ...]
    time: Vector
    position: Matrix
    velocity: Matrix | None = None
    acceleration: Matrix | None = None
    torque: Matrix | None = None
    name: str = "recording"
    position_command: Matrix | None = None
    velocity_command: Matrix | None = None
    torque_command: Matrix | None = None
    base: BaseMotion | None = None
    wrenches: tuple[Wrench, ...] = ()
    contacts: tuple[ContactFlags, ...] = ()
    torque_known: BoolArray | None = None
    torque_filter: TorqueFilter | None = None
    torque_shift: Matrix | None = None

    def __post_init__(self) -> None:
        joints = () if isinstance(self.joints, str) else tuple(self.joints)
        if not joints or len(set(joints)) != len(joints):
            raise RecordingError(
                f"{self.name}: joints are {self.joints!r}, expected distinct names"
            )
        freeze(self, joints=joints)
        if self.position is None:
            raise RecordingError(f"{self.name}: position is missing")
        time = frozen(
            self.time, (None,), f"{self.name}: time", RecordingError, finite=False
        )
        if len(time) < 2:
            raise RecordingError(
                f"{self.name}: {len(time)} samples, expected 2 or more"
            )
        require_stamps(time, self.position, self.name)
        freeze(self, time=time)
        for channel in _CHANNELS:
            values = getattr(self, channel)
            if values is not None:
                array = self._checked(channel, values, len(time))
                freeze(self, **{channel: array})
        freeze(self, wrenches=tuple(self.wrenches), contacts=tuple(self.contacts))
        if self.torque_known is not None:
            freeze(self, torque_known=self._checked_flags(self.torque_known, len(time)))
        for what, value in self._beside:
            if len(value) != len(time):
                raise RecordingError(
                    f"{self.name}: {what} has {len(value)} samples, expected "
                    f"{len(time)}, as many as there are times; a change of the "
                    f"joints' clock does not change that of the base"
                )

    @property
    def _beside(self) -> list[tuple[str, BaseMotion | Wrench | ContactFlags]]:
        """Channels recorded beside the joints, and their names."""
        base = [] if self.base is None else [self.base]
        return [
            *(("base motion", value) for value in base),
            *((f"wrench at {value.frame}", value) for value in self.wrenches),
            *((f"contact at {value.frame}", value) for value in self.contacts),
        ]

    def _checked(self, channel: str, values: Matrix, samples: int) -> Matrix:
        shape = (samples, len(self.joints))
        what = f"{self.name}: {channel}"
        array = frozen(values, shape, what, RecordingError, finite=False)
        if not np.isfinite(array).all():
            sample, joint = (int(i) for i in np.argwhere(~np.isfinite(array))[0])
            count = int((~np.isfinite(array)).sum())
            at = instant(self.time[sample], self.time)
            raise SampleError(
                f"{what} of joint {self.joints[joint]!r} is {array[sample, joint]} at "
                f"sample {sample} (t = {at} s), the first "
                f"of {count}. Remove or repair those samples"
            )
        return array

    def _checked_flags(self, values: BoolArray, samples: int) -> BoolArray:
        known = np.array(values)
        wanted = (samples, len(self.joints))
        if known.shape != wanted or known.dtype != np.bool_:
            raise RecordingError(
                f"{self.name}: torque_known has shape {known.shape} and type "
                f"{known.dtype}, expected true or false of shape {wanted}"
            )
        known.setflags(write=False)
        return known

    def __repr__(self) -> str:
        return (
            f"Recording({self.name!r}: {len(self)} samples of {len(self.joints)} "
            f"joints, {self.duration:.4g} s at {self.rate:.4g} Hz; "
            f"{', '.join(self.channels)})"
        )

    def _repr_html_(self) -> str:
        return self.table().html()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that were recorded, position first."""
        return tuple(name for name in _CHANNELS if getattr(self, name) is not None)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def rate(self) -> float:
        """Mean sampling rate [Hz]."""
        return (len(self) - 1) / self.duration

    def of(self, joints: Sequence[str]) -> Self:
        """Return the named joints' channels, in the given order.

        Raises
        ------
        RecordingError
            If a joint was not recorded.
        """
        missing = [name for name in joints if name not in self.joints]
        if missing:
            near = did_you_mean(missing[0], self.joints)
            raise RecordingError(f"{self.name} has no joint {missing[0]!r}; {near}")
        if tuple(joints) == self.joints:
            return self
        columns = [self.joints.index(name) for name in joints]
        channels = {
            channel: values[:, columns]
            for channel in _CHANNELS
            if (values := getattr(self, channel)) is not None
        }
        known = None if self.torque_known is None else self.torque_known[:, columns]
        behind = self.torque_filter
        if behind is not None:
            behind = replace(behind, source=behind.source.of(joints))
        return replace(
            self,
            joints=tuple(joints),
            torque_known=known,
            torque_filter=behind,
            **channels,
        )

    def table(self) -> Table:
        """Return each joint's ranges of motion and torque, for people."""
        channels = {name: getattr(self, name) for name in self.channels}
        return Table(
            f"{self.name}: {len(self)} samples, {self.duration:.4g} s at "
            f"{self.rate:.4g} Hz",
            ("joint", *channels),
            tuple(
                (
                    joint,
                    *(
                        f"{values[:, k].min():.4g} to {values[:, k].max():.4g}"
                        for values in channels.values()
                    ),
                )
                for k, joint in enumerate(self.joints)
            ),
            ("least and largest, in rad, m, s, N m and N",),
        )

    def to_frame(self) -> "DataFrame":
        """Return all channels as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            Indexed by ``time`` [s]; columns ``(channel, joint)``.

        Raises
        ------
        ProblemError
            If pandas is not installed.
        """
        columns = pandas().MultiIndex.from_product(
            (self.channels, self.joints), names=("channel", "joint")
        )
        values = np.hstack([getattr(self, name) for name in self.channels])
        index = pandas().Index(self.time, name="time")
        return pandas().DataFrame(values, index=index, columns=columns)

    def to_xarray(self) -> "Dataset":
        """Return all channels as an xarray data set with axes ``time`` and ``joint``.

        Raises
        ------
        ProblemError
            If xarray is not installed.
        """
        axes = ("time", "joint")
        return xarray().Dataset(
            {name: (axes, getattr(self, name)) for name in self.channels},
            coords={"time": self.time, "joint": list(self.joints)},
            attrs={"name": self.name},
        )

    def samples(self, keep: slice | IntArray) -> Self:
        """Return some samples: a run, every ``keep.step``-th of them, or by index."""
        channels = {
            channel: values[keep]
            for channel in _CHANNELS
            if (values := getattr(self, channel)) is not None
        }
        behind = self.torque_filter
        if behind is not None:
            behind = replace(behind, kept=behind.kept[keep])
        return replace(
            self,
            time=self.time[keep],
            torque_filter=behind,
            torque_known=None if self.torque_known is None else self.torque_known[keep],
            base=None if self.base is None else self.base.samples(keep),
            wrenches=tuple(wrench.samples(keep) for wrench in self.wrenches),
            contacts=tuple(flags.samples(keep) for flags in self.contacts),
            **channels,
        )


@brief
@dataclass(frozen=True, slots=True)
class LogFinding:
    """One fault, warning or note on a log.

    Parameters
    ----------
    kind : str
        Class of the fault, such as ``"torque sign"``.
    severity : {"fault", "warning", "note"}
        A fault makes estimates wrong; a warning makes them worse; a note explains.
    where : str
        Joint, pair of joints, or recording; ``"all joints"``.
    statement : str
        The finding, with figures and units.
    advice : str
        Advice on what to do.
    score : float
        Strength of the evidence: one at the threshold, larger beyond it.
    recording : str
        Recording in which it was found.
    size : str
        The factor that was found, with its standard error, if it is one; of a lag,
        the seconds by which torque is later than motion; of a torque that is held, the
        seconds from one update to the next.
    """

    kind: str
    severity: Severity
    where: str
    statement: str
    advice: str
    score: float = 1.0
    recording: str = ""
    size: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "score", float(self.score)
        )  # NumPy's cannot be written


def several(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """Return one recording, or any number, as a list; refuse all else."""
    if isinstance(recordings, str | Path):
        require_type(recordings, Recording, "recordings")
    found = [recordings] if isinstance(recordings, Recording) else list(recordings)
    require_types(found, Recording, "recordings")
    return found


def states(recording: Recording) -> tuple[Matrix, Matrix, Matrix]:
    """Return position, velocity and acceleration, of which none may be missing."""
    if recording.velocity is None or recording.acceleration is None:
        raise RecordingError(
            f"{recording.name} has no velocity or no acceleration; sample a path, or "
            "call signals.differentiated first"
        )
    return recording.position, recording.velocity, recording.acceleration


def velocities(recording: Recording) -> Matrix:
    """Return measured velocities, or else differences of position."""
    if recording.velocity is not None:
        return recording.velocity
    return np.gradient(recording.position, recording.time, axis=0)


def positions_at(recording: Recording, times: Vector) -> Matrix:
    """Return positions at other times, by linear interpolation."""
    joints = recording.position.T
    return np.column_stack([np.interp(times, recording.time, q) for q in joints])
