"""What an estimate was fitted to, and under which constraints, prior and weights."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from consistent_id._support.arrays import Vector, freeze_arrays
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.recordings.recording import Recording


class FittedSpan(NamedTuple):
    """A recording that an estimate was fitted to: its name and its times.

    Parameters
    ----------
    recording : str
        The recording's name; parts of one log share it.
    start, stop : float, [s]
        Times of the first and the last sample.
    """

    recording: str
    start: float
    stop: float

    def overlaps(self, other: "FittedSpan") -> bool:
        """Return whether two spans share more than an instant of one recording."""
        same = self.recording == other.recording
        return same and self.start < other.stop and other.start < self.stop


def fitted_spans(recordings: Iterable[Recording]) -> tuple[FittedSpan, ...]:
    """Return the spans of recordings, in their order."""
    return tuple(
        FittedSpan(r.name, float(r.time[0]), float(r.time[-1])) for r in recordings
    )


@dataclass(frozen=True, slots=True, eq=False)
class FittedUnder:
    """What a constrained estimate was fitted under, besides its data.

    Parameters
    ----------
    constraints : tuple of Constraint
    prior : PointToSet or Penalty, optional
        None is the default `PointToSet`.
    weights : array_like, shape (torque joints,), [N m or N]
        `Regression.sigma`: the noise by which each joint's rows were divided.
    """

    constraints: tuple[Constraint, ...]
    prior: Prior | None
    weights: Vector

    def __post_init__(self) -> None:
        freeze_arrays(self, {"weights": (None,)})
