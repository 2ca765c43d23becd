"""Preparation of recordings: the steps that a problem file states."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np

from consistent_id.errors import ProblemError
from consistent_id.problems.file import (
    ColumnsTable,
    DataTable,
    PreparationTable,
    TrackTable,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    Track,
    aligned,
    decimated,
    differentiated,
    estimate_delay,
    estimated_period,
    faster,
    fourier_fit,
    kalman_differentiated,
    low_passed,
    motion_noise,
    resampled,
    rest_guard,
    savitzky_golay_differentiated,
    split_at_gaps,
    track,
    trim_standstill,
    trimmed,
    without_rests,
)
from consistent_id.recordings.signals.clocks import is_uniform, own_rate
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.filters import anti_aliased
from consistent_id.recordings.signals.fourier import on_series, require_repeating

# Keys of a single method; True: the method needs the key.
_KEYS = {
    "butterworth": {"motion_cutoff": False},
    "savitzky-golay": {"window": True, "degree": False},
    "smoother": {"order": False},
    "fourier": {"period": True, "harmonics": False},
}


def check_data(data: DataTable, *, floating: bool) -> None:
    """Refuse recordings that cannot be prepared as the file states.

    Raises
    ------
    ProblemError
        The message names the key.
    """
    check_preparation(data.preparation, data.columns or ColumnsTable())
    tracks = [track for entry in data.recordings for track in entry.tracks]
    check_tracks(tracks, data.preparation)
    check_base(data, floating=floating)


def check_tracks(tracks: Iterable[TrackTable], table: PreparationTable) -> None:
    """Refuse channels with files of their own that are unused, or unknown delays.

    Raises
    ------
    ProblemError
        The message names the channel.
    """
    for entry in tracks:
        where = f"[[data.recordings.tracks]]: {entry.channel} of {entry.file}"
        if entry.channel == "torque" and entry.delay == "estimated":
            raise ProblemError(
                f"{where}: the delay of torque cannot be found from motion alone; give "
                "a number of seconds"
            )
        if entry.channel != "torque" and table.method != "butterworth":
            raise ProblemError(
                f'{where}: method = "{table.method}" takes all motion from the '
                "position; leave it out"
            )


def check_preparation(table: PreparationTable, columns: ColumnsTable) -> None:
    """Refuse keys that contradict each other or have no effect.

    Raises
    ------
    ProblemError
        The message names the keys.
    """
    where = "[data.preparation]"
    for method, keys in _KEYS.items():
        for key, needed in keys.items():
            given = getattr(table, key) is not None
            if given and method != table.method:
                raise ProblemError(
                    f'{where}: {key} belongs to method = "{method}", but the method is '
                    f'"{table.method}"'
                )
            if needed and not given and method == table.method:
                raise ProblemError(f'{where}: method = "{method}" needs {key}')
    if table.method != "butterworth":
        for channel in ("velocity", "acceleration"):
            if getattr(columns, channel) is not None:
                raise ProblemError(
                    f'{where}: method = "{table.method}" takes all motion from the '
                    f"position; leave {channel} out of [data.columns]"
                )
    for channel in table.delays:
        if getattr(columns, channel) is None:
            raise ProblemError(
                f"{where}: a delay of {channel}, which [data.columns] does not name"
            )
    if table.delays.get("position") == "estimated":
        raise ProblemError(
            f"{where}: the delay of position cannot be found from motion alone; give a "
            "number of seconds"
        )
    if table.shortest_part is not None and table.max_gap is None:
        raise ProblemError(f"{where}: shortest_part is of use only with max_gap")
    if table.method == "fourier" and table.trim_standstill is not False:
        raise ProblemError(
            f"{where}: a series is fitted to the rows that are kept; give the rows of "
            "the recording instead of trim_standstill"
        )


def check_base(data: DataTable, *, floating: bool) -> None:
    """Refuse a floating base without motion, or motion of a base that is fixed.

    Raises
    ------
    ProblemError
        The message names the key.
    """
    if floating and data.base is None:
        raise ProblemError(
            "the robot's base floats, but no [data.base] says how it moves; name the "
            "columns of its inertial measurement unit or of its pose, or leave "
            'base = "floating" out of [model]'
        )
    if not floating and (data.base is not None or data.contacts):
        what = "[data.base]" if data.base is not None else "[[data.contacts]]"
        raise ProblemError(
            f"{what} is of a base that floats, but the robot's is fixed; [model] "
            'base = "floating" makes it float'
        )
    if data.preparation.most_slip is not None and not data.contacts:
        raise ProblemError(
            "[data.preparation]: most_slip is of contacts, but there is no "
            "[[data.contacts]]; leave it out"
        )
    if not floating and data.preparation.delays.get("torque") == "estimated":
        raise ProblemError(
            "[data.preparation]: the delay of torque is estimated only for a base that "
            "floats; give a number of seconds, or leave it to consistent-id select"
        )
    method = data.preparation.method
    if floating and method != "butterworth":
        raise ProblemError(
            f'[data.preparation]: method = "{method}" is of joints alone; a floating '
            'base needs method = "butterworth"'
        )


def joined(
    recording: Recording, late: Track, delay: float | Literal["estimated"]
) -> Recording:
    """Add a channel that was logged with another clock to a recording.

    Raises
    ------
    RecordingError
        If the recording has gaps, the two do not overlap, or no delay can be found.
    """
    if not is_uniform(recording):
        recording = resampled(recording, own_rate(recording))
    if delay == "estimated":
        delay = estimate_delay(track(recording, "position"), late).seconds
    return aligned(recording, late, delay=delay)


@dataclass(frozen=True, eq=False)
class Log:
    """A recording as it was read, with the steps of its preparation.

    It is filtered and differentiated once, even if several parts are cut from it.

    Parameters
    ----------
    raw : Recording
    table : PreparationTable
    then : callable, optional
        Function that is applied to each prepared part.
    """

    raw: Recording
    table: PreparationTable
    then: Callable[[Recording], Recording] | None = None

    def cut(self, start: float = -np.inf, stop: float = np.inf) -> Recording:
        """Return the rows ``start <= time <= stop`` [s], not prepared."""
        return trimmed(self.raw, start, stop) if np.isfinite(start) else self.raw

    def prepared(
        self, start: float = -np.inf, stop: float = np.inf
    ) -> tuple[Recording, ...]:
        """Return prepared parts of ``start <= time <= stop`` [s]; see `prepared`."""
        parts = self._parts
        inside = [p for p in parts if _samples(p.raw, start, stop) >= 2]
        # If there is none, trimming the first part raises the error.
        done = (part.prepared(start, stop) for part in inside or parts[:1])
        return tuple(done if self.then is None else map(self.then, done))

    @cached_property
    def _parts(self) -> tuple["_Part", ...]:
        raw, table = self.raw, self.table
        if table.max_gap is None:
            return (_Part(raw, table),)
        shortest = 1.0 if table.shortest_part is None else table.shortest_part
        parts = split_at_gaps(raw, table.max_gap, shortest=shortest)
        return tuple(_Part(part, table) for part in parts)


def prepared(
    recording: Recording,
    table: PreparationTable,
    start: float = -np.inf,
    stop: float = np.inf,
) -> tuple[Recording, ...]:
    """Prepare a recording and cut it to ``start <= time <= stop`` [s].

    The steps are: cut at gaps, resample, remove delays, filter, differentiate,
    decimate, cut off standstill.  The cut to `start` and `stop` comes last, because
    filters and differences need samples on either side.

    Parameters
    ----------
    recording : Recording
        As read.
    table : PreparationTable
    start, stop : float, [s]

    Returns
    -------
    tuple of Recording
        One, or one for each part between gaps.

    Raises
    ------
    RecordingError
        If a step cannot be done, or nothing is left.
    """
    return Log(recording, table).prepared(start, stop)


def filtered(part: Recording, table: PreparationTable) -> Recording:
    """Remove delays and filter, as a table states."""
    for channel, delay in table.delays.items():
        if channel == "torque" and delay == "estimated":  # which takes the robot
            continue
        late = track(part, channel)
        if delay == "estimated":
            delay = estimate_delay(track(part, "position"), late).seconds
        part = aligned(part, late, delay=delay)
    if table.motion_cutoff is None and table.torque_cutoff is None:
        return part
    return low_passed(
        part,
        motion_cutoff=table.motion_cutoff,
        torque_cutoff=table.torque_cutoff,
    )


def rest_reach(table: PreparationTable) -> float:
    """Return the time before and after a rest for which torque is unknown, [s].

    The filter of the motion spreads stops and starts to either side.  The filter of the
    torque filters rows, from which samples at rest were removed before.
    """
    return 0.0 if table.motion_cutoff is None else rest_guard(table.motion_cutoff)


def moving(part: Recording, table: PreparationTable) -> Recording:
    """Return a filtered recording with velocity and acceleration, as a table states."""
    if table.method == "savitzky-golay" and table.window is not None:
        degree = 4 if table.degree is None else table.degree
        return savitzky_golay_differentiated(part, table.window, degree=degree)
    if table.method == "smoother":
        return kalman_differentiated(part, motion_noise(part, order=table.order))
    return differentiated(part)


@dataclass(frozen=True, eq=False)
class _Part:
    """The part of a log between two gaps."""

    raw: Recording
    table: PreparationTable

    def prepared(self, start: float, stop: float) -> Recording:
        table = self.table
        if table.method == "fourier":
            whole = self._thinnable(self._as_series(start, stop))
        else:
            whole = self._whole
        part = trimmed(whole, start, stop)
        if table.trim_standstill is not False:
            speed = None if table.trim_standstill is True else table.trim_standstill
            part = trim_standstill(part, speed)
        if table.least_speed is not None:
            part = faster(part, table.least_speed)
        slowest = table.least_joint_speed
        if slowest is not None and slowest != "estimated":  # which takes the robot
            part = without_rests(part, slowest, reach=rest_reach(table))
        # Without torque it was decimated before.
        thin = part.torque_filter is None
        return part if thin else decimated(part, table.decimate)

    def _thinnable(self, whole: Recording) -> Recording:
        """Return it filtered against aliasing, with all samples."""
        factor = self.table.decimate
        if factor == 1:
            return whole
        if whole.torque is None and not whole.wrenches:
            return decimated(whole, factor)
        return anti_aliased(whole, factor)

    @cached_property
    def _filtered(self) -> Recording:
        part, table = self.raw, self.table
        if table.resample is not None:
            part = resampled(part, table.resample, max_gap=table.max_gap)
        return filtered(part, table)

    @cached_property
    def _whole(self) -> Recording:
        """All of it, with velocity and acceleration."""
        return self._thinnable(moving(self._filtered, self.table))

    def _as_series(self, start: float, stop: float) -> Recording:
        """Return it with the motion of a Fourier series, fitted to the kept samples."""
        part, period = self._filtered, self.table.period
        # The run-in of a periodic motion is not part of it.
        kept = trimmed(part, start, stop)
        if period is None or period == "estimated":
            period = estimated_period(kept)
        fit = fourier_fit(kept, period, self.table.harmonics)
        require_repeating(kept, fit)
        return altered(part, partial(on_series, fit=fit))


def _samples(recording: Recording, start: float, stop: float) -> int:
    return int(((recording.time >= start) & (recording.time <= stop)).sum())
