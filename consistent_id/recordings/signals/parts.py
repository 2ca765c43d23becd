"""Parts of a recording: between times or gaps, without masked samples, and folds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import IntArray
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import NotExcitedError, RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import counting, left_out
from consistent_id.recordings.signals.masks import as_mask, speed_share, standstill


def trimmed(
    recording: Recording, start: float = -np.inf, stop: float = np.inf
) -> Recording:
    """Keep the samples with ``start <= time <= stop`` [s].

    Trim after filtering: a filter needs the samples before and after.

    Parameters
    ----------
    recording : Recording
    start, stop : float, [s]
        On the recording's clock.

    Examples
    --------
    >>> import consistent_id as ci
    >>> time = np.arange(200) / 100
    >>> log = ci.Recording(("elbow",), time, np.sin(time)[:, None])
    >>> ci.trimmed(log, 0.5, 1.0).duration
    0.5
    """
    require_type(recording, Recording, "recording")
    if np.isnan(start) or np.isnan(stop):
        raise RecordingError(f"{recording.name}: trimmed from {start} s to {stop} s")
    first, last = np.searchsorted(recording.time, [start, np.nextafter(stop, np.inf)])
    last = max(first, last)
    if last - first < 2:
        raise RecordingError(
            f"{recording.name}: {last - first} samples between {start:g} s and "
            f"{stop:g} s; it runs from {recording.time[0]:g} s to "
            f"{recording.time[-1]:g} s"
        )
    return recording.samples(slice(int(first), int(last)))


def split_at_gaps(
    recording: Recording, max_gap: float, *, shortest: float = 0.0
) -> tuple[Recording, ...]:
    """Cut a recording wherever stamps are further apart than `max_gap`.

    The motion in a gap is not known: do not filter, interpolate or differentiate across
    it.

    Parameters
    ----------
    recording : Recording
    max_gap : float, [s]
        Longest step between stamps within a part.
    shortest : float, [s]
        Parts that last less, and single samples, are left out.

    Raises
    ------
    RecordingError
        If no part is left.

    Examples
    --------
    >>> time = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 9.0])
    >>> log = Recording(("elbow",), time, np.zeros((6, 1)), name="log")
    >>> [(part.name, len(part)) for part in split_at_gaps(log, 0.5)]
    [('log (part 1)', 3), ('log (part 2)', 2)]
    """
    if not max_gap > 0.0:
        raise RecordingError(f"max_gap is {max_gap} s, expected a positive number")
    cuts = np.flatnonzero(np.diff(recording.time) > max_gap) + 1
    return _parts(recording, np.split(np.arange(len(recording)), cuts), shortest)


def without(
    recording: Recording, mask: ArrayLike, *, shortest: float = 0.0
) -> tuple[Recording, ...]:
    """Return the runs of samples that are not masked, each as a separate recording.

    If only one joint's torque is unusable, `row_weights` keeps the others.

    Parameters
    ----------
    recording : Recording
    mask : array_like of bool, shape (samples,) or (samples, joints)
        Samples to leave out: those masked for any joint.
    shortest : float, [s]
        Runs that last less, and single samples, are left out.

    Raises
    ------
    RecordingError
        If no part is left.
    """
    masked = np.asarray(as_mask(recording, mask).any(axis=1))
    recording, keep = left_out(recording, masked), np.flatnonzero(~masked)
    cuts = np.flatnonzero(np.diff(keep) > 1) + 1
    return _parts(recording, np.split(keep, cuts), shortest)


def faster(recording: Recording, least_speed: float) -> Recording:
    """Leave out the rows in which the robot creeps or stands still.

    Filter first, because the result has gaps.

    Parameters
    ----------
    recording : Recording
        With velocity.
    least_speed : float
        Share of top speed; see `speed_share`.

    Raises
    ------
    RecordingError
        If fewer than two rows are left.
    """
    kept = speed_share(recording) >= least_speed
    if kept.sum() < 2:
        raise RecordingError(
            f"{recording.name}: {kept.sum()} rows are faster than {least_speed:g} of "
            "top speed, expected two or more"
        )
    return counting(recording, kept)


def trim_standstill(
    recording: Recording, velocity: float | None = None, *, margin: float = 0.0
) -> Recording:
    """Cut off the standstill of all joints at both ends.

    Parameters
    ----------
    recording : Recording
        Filtered, unless its velocity is clean.
    velocity : float, optional, [rad/s or m/s]
        Below which a joint stands still; see `standstill`.
    margin : float, [s]
        Standstill to keep at both ends.

    Raises
    ------
    RecordingError
        If no joint ever moves.
    """
    moving = np.flatnonzero(~standstill(recording, velocity).all(axis=1))
    if len(moving) < 2:
        raise RecordingError(f"{recording.name}: no joint ever moves")
    start, stop = recording.time[moving[0]], recording.time[moving[-1]]
    time = recording.time
    return counting(recording, (time >= start - margin) & (time <= stop + margin))


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """One block of a recording for validation, and the others for training.

    Parameters
    ----------
    training : tuple of Recording
        The samples before and after the block, without the guard.
    held_out : Recording
        The block.
    """

    training: tuple[Recording, ...]
    held_out: Recording


def blocked_folds(
    recording: Recording, count: int = 5, *, guard: float = 0.0
) -> tuple[Fold, ...]:
    """Return as many folds as there are blocks; each sample is held out once.

    Blocks are runs of consecutive samples, not samples drawn at random: neighbours are
    so similar that held-out samples between training samples would not be a test.

    Parameters
    ----------
    recording : Recording
        Prepared.
    count : int
        Number of blocks of about equal length.
    guard : float, [s]
        Samples within this time of the held-out block are not used for training,
        because a filter has mixed them with it.  The response of a zero-phase
        Butterworth filter of order 4 and cut-off ``f`` decays as ``exp(-2.4 f t)``:
        after ``5 / f``, six parts in a million are left.

    Raises
    ------
    RecordingError
        If a part would have fewer than two samples.

    Examples
    --------
    >>> time = np.arange(10) * 0.1
    >>> log = Recording(("elbow",), time, np.sin(time)[:, None], name="log")
    >>> fold = blocked_folds(log, 2, guard=0.15)[0]
    >>> fold.held_out.name, len(fold.held_out), [len(part) for part in fold.training]
    ('log (block 1 of 2)', 5, [4])
    """
    if count < 2:
        raise RecordingError(f"{count} blocks, expected 2 or more")
    if not guard >= 0.0:
        raise RecordingError(f"guard is {guard} s, expected zero or more")
    ends = np.linspace(0, len(recording), count + 1).round().astype(int).tolist()
    if min(np.diff(ends)) < 2:
        raise RecordingError(
            f"{recording.name}: {len(recording)} samples cannot be cut into {count} "
            "blocks of two or more"
        )
    return tuple(
        _fold(recording, slice(a, b), f"block {k} of {count}", guard)
        for k, (a, b) in enumerate(pairwise(ends), 1)
    )


def _fold(recording: Recording, block: slice, label: str, guard: float) -> Fold:
    held_out, time = recording.samples(block), recording.time
    stop = int(np.searchsorted(time, held_out.time[0] - guard))
    start = int(np.searchsorted(time, held_out.time[-1] + guard, "right"))
    sides = {"before": slice(0, stop), "after": slice(start, len(time))}
    training = tuple(
        replace(recording.samples(keep), name=f"{recording.name} ({side} {label})")
        for side, keep in sides.items()
        if keep.stop - keep.start >= 2
    )
    if not training:
        raise RecordingError(
            f"{recording.name}: nothing is left for training {guard:g} s away from "
            f"{label}; the recording lasts {recording.duration:.4g} s"
        )
    return Fold(training, replace(held_out, name=f"{recording.name} ({label})"))


def blocks_of(recordings: Sequence[Recording], count: int) -> list[Recording]:
    """Cut recordings into about `count` blocks of similar length, at least one each.

    Raises
    ------
    NotExcitedError
        If there is only one block.
    """
    total = sum(map(len, recordings))
    found = []
    for log in recordings:
        ends = np.linspace(0, len(log), max(round(count * len(log) / total), 1) + 1)
        found += [log.samples(slice(*ab)) for ab in pairwise(ends.astype(int).tolist())]
    if len(found) < 2:
        raise NotExcitedError("the motion is too short to be cut into blocks")
    return found


def _parts(
    recording: Recording, runs: list[IntArray], shortest: float
) -> tuple[Recording, ...]:
    kept = [
        run
        for run in runs
        if len(run) >= 2
        and recording.time[run[-1]] - recording.time[run[0]] >= shortest
    ]
    if not kept:
        raise RecordingError(
            f"{recording.name}: none of {len(runs)} parts has two samples and lasts "
            f"{shortest:g} s; record longer parts"
        )
    if len(kept) == 1 and len(kept[0]) == len(recording):
        return (recording,)
    return tuple(
        replace(
            recording.samples(slice(int(run[0]), int(run[-1]) + 1)),
            name=f"{recording.name} (part {number})",
        )
        for number, run in enumerate(kept, 1)
    )
