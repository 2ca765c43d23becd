"""The cut-off of a draft: chosen on its training rows, where they suffice."""

from collections.abc import Sequence
from dataclasses import dataclass

from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.estimation.cutoff import CutoffChoice, best_cutoff
from consistent_id.problems.draft_rows import SHARE, Clock
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import resampled, split_at_gaps
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.regressor import TorqueModel

_CUTOFFS = (2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0)  # Hz
_FOLDS = 6
_USUAL = 10.0  # Hz
_STANDING = 30.0
"""Hz, of a robot on its feet: around joints that turn back a filter spreads friction's
jump, and the lower the cut-off, the fewer rows are left (see `rest_guard`)."""
_LOW = 5.0  # Hz; a choice among higher ones alone would be none


@dataclass(frozen=True, slots=True)
class DraftCutoff:
    """A cut-off [Hz], and why it is that."""

    frequency: float
    reason: str


def usual_cutoff(training: Sequence[Recording], *, standing: bool = False) -> float:
    """Return a cut-off [Hz] that no data have chosen."""
    top = SHARE * min(own_rate(part) for part in training)
    return float(f"{min(_STANDING if standing else _USUAL, top):.2g}")


def draft_cutoff(
    model: TorqueModel, training: Sequence[Recording], clock: Clock
) -> DraftCutoff:
    """Return the cut-off with which training rows predict each other best."""
    top = SHARE * min(own_rate(part) for part in training)
    fallback = usual_cutoff(training)
    try:
        chosen = _chosen(model, training, clock, top)
    except ConsistentIdError as cause:
        return DraftCutoff(
            fallback, f"{fallback:g} Hz, as none could be chosen ({cause})"
        )
    tried = ", ".join(f"{f:g}" for f in chosen.motion)
    return DraftCutoff(
        chosen.motion_cutoff,
        f"of {tried} Hz the one with which the training rows predict each other best",
    )


def _chosen(
    model: TorqueModel, training: Sequence[Recording], clock: Clock, top: float
) -> CutoffChoice:
    parts = list(training)
    if clock.max_gap is not None:
        shortest = sum(part.duration for part in parts) / _FOLDS
        parts = [
            piece
            for part in parts
            for piece in split_at_gaps(part, clock.max_gap, shortest=shortest)
        ]
    if clock.resample is not None:
        parts = [
            resampled(part, clock.resample, max_gap=clock.max_gap) for part in parts
        ]
    # A quarter of a fold may be lost at each end to the lowest cut-off.
    least = 4.0 * _FOLDS / sum(part.duration for part in parts)
    if least > _LOW:
        raise RecordingError(f"the motion is too short to try {_LOW:g} Hz and less")
    tried = [cutoff for cutoff in _CUTOFFS if 1.02 * least < cutoff <= top]
    return best_cutoff(model, parts, tried, folds=_FOLDS)
