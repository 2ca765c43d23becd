"""Downsampling for plots: the extremes of every bucket are kept."""

import base64

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector

_LEVELS = 65535


def buckets(samples: int, most: int) -> IntArray:
    """Return the starts of buckets of samples that give at most so many points.

    Each bucket gives two points, see `extremes`; where there are few enough samples
    each is a bucket of its own and gives one.
    """
    size = 1 if samples <= most else int(np.ceil(2 * samples / most))
    return np.arange(0, samples, size)


def extremes(values: Vector, starts: IntArray) -> Vector:
    """Return the least and the largest value of every bucket, in the order of time.

    Parameters
    ----------
    values : ndarray, shape (samples,)
    starts : ndarray, shape (buckets,)
        See `buckets`.

    Returns
    -------
    ndarray, shape (2 buckets,), or (samples,) if each sample is a bucket

    Examples
    --------
    >>> extremes(np.array([1.0, 5.0, 2.0, 0.0, 3.0, 3.0]), np.array([0, 3]))
    array([1., 5., 0., 3.])
    """
    if len(starts) == len(values):
        return values
    low, high = (f.reduceat(values, starts) for f in (np.minimum, np.maximum))
    parts = np.split(values, starts[1:])
    falling = np.array([np.argmin(p) > np.argmax(p) for p in parts])
    pairs = np.column_stack([low, high])
    pairs[falling] = pairs[falling, ::-1]
    return np.asarray(pairs.ravel())


def instants(time: Vector, starts: IntArray) -> Vector:
    """Return when the points of `extremes` are drawn, shape as there, [s].

    A bucket's two points stand at its start and its middle.
    """
    if len(starts) == len(time):
        return time
    ends = np.append(starts[1:], len(time))
    places = np.empty(2 * len(starts), dtype=np.intp)
    places[0::2], places[1::2] = starts, (starts + ends) // 2
    return np.asarray(time[places])


def packed(values: Array) -> dict[str, object]:
    """Return numbers in 16 bits each, as text: ``low + step * unsigned``.

    What is lost is below a hundred thousandth of the range.
    """
    low, high = float(values.min()), float(values.max())
    step = (high - low) / _LEVELS
    counts = np.zeros(len(values)) if step == 0.0 else (values - low) / step
    data = np.rint(counts).astype("<u2").tobytes()
    return {"low": low, "step": step, "data": base64.b64encode(data).decode()}
