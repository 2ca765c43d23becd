"""Smooth logs of a few joints."""

import numpy as np

from consistent_id.recordings.recording import Recording

NAMES = ("a", "b", "c")


def tones(rng, joints=3):
    """A motion of twelve tones below 3 Hz per joint: any derivative at any time."""
    f = rng.uniform(0.1, 3.0, (12, joints))
    size, phase = 0.3 * rng.normal(size=f.shape), rng.uniform(0, 6, f.shape)
    w = 2 * np.pi * f

    def at(time, order=0):
        angle = w * time[:, None, None] + phase + order * np.pi / 2
        return (size * w**order * np.sin(angle)).sum(axis=1)

    return at


def log(time, position, **channels):
    position = position if position.ndim == 2 else position[:, None]
    return Recording(NAMES[: position.shape[1]], time, position, name="log", **channels)
