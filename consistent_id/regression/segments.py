"""Recordings cut into consecutive segments, each compressed by itself.

What was recorded within a second belongs together: errors of neighbouring samples are
alike.  Segments are what cross-validation leaves out and the bootstrap draws.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.regression import Regression, compressed_pieces
from consistent_id.regression.regressor import TorqueModel

SEGMENTS = 24
"""Default number of segments of the data."""


def segment_regressions(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    count: int = SEGMENTS,
    sigma: ArrayLike | None = None,
) -> tuple[Regression, ...]:
    """Cut recordings into about `count` segments of like length; compress each.

    Parameters
    ----------
    model : TorqueModel
    recordings : Recording or sequence of Recording
        With velocity, acceleration and torque.
    count : int
        Number of segments in all; each recording is at least one, each segment at least
        two samples.  Neighbours are one where one of them has no row of a joint.
    sigma : array_like, shape (joints,), optional, [N m or N]
        Noise levels by which joints are weighted; see `joint_noise`.

    Returns
    -------
    tuple of Regression
        In the order of time; their sum is the regression of the whole.

    Raises
    ------
    ProblemError
        If fewer than two segments are requested.
    NotExcitedError
        If there is too little to cut.
    """
    recordings = several(recordings)
    if count < 2:
        raise ProblemError(f"count is {count}, expected 2 segments or more")
    pieces = segments_of(recordings, count=count)
    if len(pieces) < 2:
        raise NotExcitedError(
            f"{sum(len(r) for r in recordings)} samples are too few to be cut into "
            "segments"
        )
    segments = compressed_pieces(model, pieces, recordings)
    return segments if sigma is None else tuple(s.weighted(sigma) for s in segments)


def segments_of(recordings: Sequence[Recording], *, count: int) -> list[Recording]:
    """Return the segments themselves; see `segment_regressions`."""
    return [recordings[k].samples(run) for k, run in _runs(recordings, count)]


def segment_sources(
    recordings: Sequence[Recording], *, count: int = SEGMENTS
) -> tuple[int, ...]:
    """Return the recording, counted from 0, that each segment is cut from.

    Parameters
    ----------
    recordings : sequence of Recording
    count : int
        See `segment_regressions`.

    Examples
    --------
    >>> from consistent_id import Recording
    >>> logs = [Recording(["a"], [0, 1, 2, 3][:n], [[0]] * n) for n in (4, 2)]
    >>> segment_sources(logs, count=3)
    (0, 0, 1)
    """
    return tuple(k for k, _ in _runs(recordings, count))


def lengthened(
    segments: Sequence[Regression], sources: Sequence[int], least: Vector
) -> tuple[tuple[Regression, ...], tuple[int, ...]]:
    """Join neighbours of one recording until each joint has its least samples.

    Samples left over at a recording's end join the last segment.

    Parameters
    ----------
    segments : sequence of Regression
        In the order of time.
    sources : sequence of int
        The recording of each; those of one stand together.
    least : ndarray, shape (joints,), [samples]

    Returns
    -------
    tuple of Regression, tuple of int
        The longer segments, and their recordings.
    """
    found: list[tuple[Regression, int]] = []
    for source, members in groupby(
        zip(segments, sources, strict=True), key=itemgetter(1)
    ):
        whole: list[list[Regression]] = []
        rest: list[Regression] = []
        for segment, _ in members:
            rest.append(segment)
            if (np.sum([s.counts for s in rest], axis=0) >= least).all():
                whole.append(rest)
                rest = []
        if rest and whole:
            whole[-1] += rest
        elif rest:
            whole.append(rest)
        found += [(merged(group), source) for group in whole]
    return tuple(s for s, _ in found), tuple(k for _, k in found)


def merged(segments: Sequence[Regression]) -> Regression:
    """Return the regression of several segments together.

    Raises
    ------
    ProblemError
        If there is none, or their models or weights differ.
    """
    if not segments:
        raise ProblemError("there are no segments to merge")
    return segments[0].joined(segments[1:])


def _runs(recordings: Sequence[Recording], count: int) -> Iterator[tuple[int, slice]]:
    """Yield the samples of each segment, and the recording that they are of."""
    length = max(sum(len(r) for r in recordings) / count, 2.0)
    for k, recording in enumerate(recordings):
        for start, stop in _spans(recording, length):
            yield k, slice(start, stop)


def _spans(recording: Recording, length: float) -> list[tuple[int, int]]:
    """Return where segments begin and end, each with rows of every joint.

    Samples left over at the end join the last.
    """
    cuts = segment_cuts(len(recording), length)
    if recording.torque_known is None and not recording.contacts:
        return cuts
    known = known_torque(recording)
    seen = known[:, known.any(axis=0)]
    ends = [0]
    for _, stop in cuts:
        if seen[ends[-1] : stop].any(axis=0).all():
            ends.append(stop)
    return list(pairwise([*ends[: max(len(ends) - 1, 1)], len(recording)]))


def known_torque(recording: Recording) -> BoolArray:
    """Return where each joint's torque enters a row, shape (samples, joints)."""
    known = np.ones(recording.position.shape, dtype=np.bool_)
    if recording.torque_known is not None:
        known &= recording.torque_known
    for flags in recording.contacts:  # an uncertain one leaves a sample no row
        known &= flags.certain[:, None]
    return known


def segment_cuts(samples: int, length: float) -> list[tuple[int, int]]:
    """Return where segments of about a length begin and end."""
    number = max(min(round(samples / length), samples // 2), 1)
    ends = np.linspace(0, samples, number + 1).round().astype(int).tolist()
    return list(pairwise(ends))
