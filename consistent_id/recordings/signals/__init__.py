"""From a raw log to motion and torque that belong together.

Each function takes a `Recording` and returns a new one, or a small value.
"""

from consistent_id.recordings.signals.alignment import aligned
from consistent_id.recordings.signals.clocks import resampled, uniform_rate
from consistent_id.recordings.signals.commanded import PDGains, commanded
from consistent_id.recordings.signals.cuts import (
    faster,
    split_at_gaps,
    trim_standstill,
    trimmed,
    without,
)
from consistent_id.recordings.signals.delay import Delay, estimate_delay
from consistent_id.recordings.signals.differences import differentiated
from consistent_id.recordings.signals.drive_calibration import (
    DriveCalibration,
    calibrated,
)
from consistent_id.recordings.signals.filters import decimated, low_passed
from consistent_id.recordings.signals.folds import Fold, blocked_folds
from consistent_id.recordings.signals.fourier import (
    FourierFit,
    fit_trajectory,
    fourier_differentiated,
    fourier_fit,
)
from consistent_id.recordings.signals.impacts import impact_guard, without_impacts
from consistent_id.recordings.signals.masks import (
    mask_onto,
    row_weights,
    saturated,
    speed_share,
    standstill,
)
from consistent_id.recordings.signals.period import estimated_period
from consistent_id.recordings.signals.resolution import encoder_resolution
from consistent_id.recordings.signals.rests import rest_guard, without_rests
from consistent_id.recordings.signals.savitzky_golay import (
    savitzky_golay_differentiated,
)
from consistent_id.recordings.signals.smoother import (
    MotionNoise,
    kalman_differentiated,
    motion_noise,
)
from consistent_id.recordings.signals.there_and_back import there_and_back
from consistent_id.recordings.signals.track import Track, track

__all__ = [
    "Delay",
    "DriveCalibration",
    "Fold",
    "FourierFit",
    "MotionNoise",
    "PDGains",
    "Track",
    "aligned",
    "blocked_folds",
    "calibrated",
    "commanded",
    "decimated",
    "differentiated",
    "encoder_resolution",
    "estimate_delay",
    "estimated_period",
    "faster",
    "fit_trajectory",
    "fourier_differentiated",
    "fourier_fit",
    "impact_guard",
    "kalman_differentiated",
    "low_passed",
    "mask_onto",
    "motion_noise",
    "resampled",
    "rest_guard",
    "row_weights",
    "saturated",
    "savitzky_golay_differentiated",
    "speed_share",
    "split_at_gaps",
    "standstill",
    "there_and_back",
    "track",
    "trim_standstill",
    "trimmed",
    "uniform_rate",
    "without",
    "without_impacts",
    "without_rests",
]
