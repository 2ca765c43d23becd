"""Recordings cut into consecutive segments, each compressed by itself.

What was recorded within a second belongs together: errors of neighbouring samples are
alike.  Segments are what cross-validation leaves out and the bootstrap draws.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regression import Regression, compressed_pieces
from consistent_id.regression.regressor import TorqueModel

SEGMENTS = 24
"""Segments made of the data, if nothing else is asked for."""


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
        Of segments in all; each recording is at least one, each segment at least two
        samples.
    sigma : array_like, shape (joints,), optional, [N m or N]
        Noise levels by which joints are weighted; see `joint_noise`.

    Returns
    -------
    tuple of Regression
        In the order of time; their sum is the regression of the whole.

    Raises
    ------
    ProblemError
        If fewer than two segments are asked for.
    NotExcitedError
        If there is too little to cut.
    """
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if count < 2:
        raise ProblemError(f"count is {count}, expected 2 segments or more")
    length = max(sum(len(r) for r in recordings) / count, 2.0)
    pieces = [
        recording.samples(slice(start, stop))
        for recording in recordings
        for start, stop in _cuts(len(recording), length)
    ]
    if len(pieces) < 2:
        raise NotExcitedError(
            f"{sum(len(r) for r in recordings)} samples are too few to be cut into "
            "segments"
        )
    segments = compressed_pieces(model, pieces, recordings)
    return segments if sigma is None else tuple(s.weighted(sigma) for s in segments)


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


def _cuts(samples: int, length: float) -> list[tuple[int, int]]:
    number = max(min(round(samples / length), samples // 2), 1)
    ends = np.linspace(0, samples, number + 1).round().astype(int).tolist()
    return list(pairwise(ends))
