"""The methods by which parameters are estimated, and what an estimate was fitted to.

It was fitted to rows, under constraints, with a prior and with weights.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from consistent_id._support.arrays import Vector, freeze_arrays
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
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


def fitted_to_others(
    method: str, given: Iterable[Recording], spans: Iterable[FittedSpan]
) -> ProblemError:
    """Return the error of recordings that an estimate was not fitted to.

    Parameters
    ----------
    spans : iterable of FittedSpan
        Those that it was fitted to, as far as they are known.
    """
    names = ", ".join(recording.name for recording in given)
    own = ", ".join(dict.fromkeys(span.recording for span in spans))
    return ProblemError(
        f"{method} was not fitted to {names} as given here; hand over the recordings "
        f"that it was fitted to, prepared alike{own and ': '}{own}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class FittedUnder:
    """The conditions of a constrained estimate's fit, besides its data.

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


class Method(StrEnum):
    """Names of methods, as estimates, tables and files have them.

    Examples
    --------
    >>> Method("constrained")
    'constrained'
    """

    AS_PUBLISHED = "least squares as published"
    AS_PUBLISHED_WITH_FRICTION = "least squares as published, with friction"
    LEAST_SQUARES = "least squares"
    WEIGHTED_LEAST_SQUARES = "weighted least squares"
    HUBER = "Huber"
    BOX_CONSTRAINED = "box-constrained QP"
    CONSTRAINED = "constrained"
    CONSTRAINED_WITH_FRICTION = "constrained, with friction"
    WEIGHTED_CONSTRAINED = "weighted constrained"
    CROSS_VALIDATED = "cross-validated"
    INSTRUMENTAL_VARIABLES = "instrumental variables"
    REFINED_BY_ROLLOUT = "refined by rollout"

    def __repr__(self) -> str:
        return repr(self.value)
