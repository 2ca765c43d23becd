"""A target for every cycle of a controller, whose rates are its own."""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.recordings.paths import JointPath

CYCLES: dict[str, tuple[float, ...]] = {
    "urscript": (125.0, 500.0),
    "rsi": (250.0, 1000.0 / 12.0),
    "franka": (1000.0,),
}
"""Rates of formats [Hz]: of CB and e-Series, of RSI in 4 and in 12 ms, of libfranka."""

_EQUAL = 1e-3  # of a rate, such as 83.3 for 1000 / 12


class Targets(NamedTuple):
    """Positions, shape (targets, joints), and seconds since the start."""

    since: Vector
    position: Matrix


def cycle_of(format: str, rate: float) -> float | None:
    """Return the controller's rate that is meant, or None if it has no such."""
    near = (own for own in CYCLES[format] if abs(rate - own) <= _EQUAL * own)
    return next(near, None)


def targets_of(path: JointPath, rate: float) -> Targets:
    """Return one target for each cycle.

    The last one is the end of the path, at most a cycle after the one before.
    """
    cycles = int(np.ceil(path.duration * rate * (1.0 - 1e-12)))
    since = np.minimum(np.arange(cycles + 1) / rate, path.duration)
    (position,) = path.evaluate(path.start + since, derivatives=0)
    return Targets(since, position)
