from consistent_id.diagnosis.signal_faults import unwrapped
from consistent_id.recordings.signals.base_signals import (
    base_from_imu,
    base_from_pose,
    rotations,
)
from consistent_id.recordings.signals.clocks import resampled, uniform_rate
from consistent_id.recordings.signals.derivatives import (
    differentiated,
    savitzky_golay_differentiated,
)
from consistent_id.recordings.signals.drive_limits import beyond_speed, saturated
from consistent_id.recordings.signals.drive_torque import (
    DriveCalibration,
    PDGains,
    calibrated,
    commanded,
)
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.filters import decimated, low_passed
from consistent_id.recordings.signals.fourier import (
    FourierFit,
    fit_trajectory,
    fourier_differentiated,
    fourier_fit,
)
from consistent_id.recordings.signals.masks import (
    encoder_resolution,
    impact_guard,
    mask_onto,
    rest_guard,
    row_weights,
    speed_share,
    standstill,
    without_impacts,
    without_rests,
)
from consistent_id.recordings.signals.parts import (
    Fold,
    blocked_folds,
    faster,
    split_at_gaps,
    trim_standstill,
    trimmed,
    without,
)
from consistent_id.recordings.signals.repetitions import (
    estimated_period,
    there_and_back,
)
from consistent_id.recordings.signals.smoother import (
    MotionNoise,
    kalman_differentiated,
    motion_noise,
)
from consistent_id.recordings.signals.tracks import (
    Delay,
    Track,
    aligned,
    estimate_delay,
    track,
)

__all__ = [
    "Delay",
    "DriveCalibration",
    "Fold",
    "FourierFit",
    "MotionNoise",
    "PDGains",
    "Track",
    "aligned",
    "altered",
    "base_from_imu",
    "base_from_pose",
    "beyond_speed",
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
    "rotations",
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
    "unwrapped",
    "without",
    "without_impacts",
    "without_rests",
]
