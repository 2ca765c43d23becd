"""The motion of a base between the gaps of a log: derivatives bridge none of them."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.base_motion import BaseMotion

SHORTEST = 4
"""Samples from which a second derivative can be taken, ends and all."""

_GAP = 10.0  # usual steps without a sample


def stretches(time: Vector) -> list[slice]:
    """Return the samples between gaps: steps longer than ten usual ones.

    Examples
    --------
    >>> stretches(np.array([0.0, 0.1, 0.2, 5.0, 5.1]))
    [slice(0, 3, None), slice(3, 5, None)]
    """
    if len(time) < 2:
        return [slice(0, len(time))] if len(time) else []
    steps = np.diff(time)
    cuts = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    ends = [0, *cuts.tolist(), len(time)]
    return [slice(a, b) for a, b in pairwise(ends)]


def moved_by_stretch(
    motion: Callable[[slice], BaseMotion], time: Vector, where: str
) -> BaseMotion:
    """Return a base's motion, each stretch between gaps by itself.

    Parameters
    ----------
    motion : callable
        From samples of the log to how the base moves in them.
    time : ndarray, shape (samples,), [s]

    Raises
    ------
    RecordingError
        If a stretch is too short for derivatives.
    """
    parts = []
    for stretch in stretches(time):
        if stretch.stop - stretch.start < SHORTEST:
            raise RecordingError(
                f"{where}: rows {stretch.start + 1} to {stretch.stop} stand between "
                f"gaps, too few for the base's motion; leave them out: omit = "
                f"{list(range(stretch.start + 1, stretch.stop + 1))}"
            )
        parts.append(motion(stretch))
    if len(parts) == 1:
        return parts[0]
    w, dw, felt = np.split(np.vstack([part.stacked for part in parts]), 3, axis=1)
    turned = [part.rotation for part in parts if part.rotation is not None]
    return BaseMotion(w, dw, felt, np.concatenate(turned) if turned else None)
