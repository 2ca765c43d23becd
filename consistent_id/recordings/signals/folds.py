"""Blocks of a recording, held out in turn: validation without a second recording."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """One block of a recording for validation, and the others for training.

    Parameters
    ----------
    training : tuple of Recording
        What lies before the block and what lies after it, without the guard.
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
    so alike that held-out samples between training samples would be no test.

    Parameters
    ----------
    recording : Recording
        Prepared.
    count : int
        Number of blocks, of like length.
    guard : float, [s]
        On either side of the held-out block samples so near to it do not train:
        a filter has mixed them with what is held out.  A zero-phase Butterworth filter
        of order 4 and cut-off ``f`` forgets as ``exp(-2.4 f t)``: after ``5 / f``, six
        parts in a million are left.

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
