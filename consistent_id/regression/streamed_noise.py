"""Noise of recordings that were streamed: of them, only the middles are left."""

from collections.abc import Sequence
from dataclasses import replace

from consistent_id._support.threads import single_threaded
from consistent_id.recordings.recording import Recording
from consistent_id.regression.correlated_noise import joined_noise
from consistent_id.regression.joint_fit import joint_fit
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.recorded_noise import recorded_noise
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_filter import RowFilter


@single_threaded
def with_noise_of(
    model: TorqueModel,
    regression: Regression,
    middles: Sequence[Recording],
    samples: Sequence[int],
) -> Regression:
    """Return a regression with the noise that the middles of its recordings show.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
    middles : sequence of Recording
        The `SHOWN` samples in the middle of each recording, or all of a shorter one.
    samples : sequence of int
        Of each recording.
    """
    fit = joint_fit(regression.factors, regression.counts)
    parts = [
        recorded_noise(
            model, fit, motion_of(model, shown, None), range(len(shown)), RowFilter()
        ).share(total / len(shown))
        for shown, total in zip(middles, samples, strict=True)
    ]
    return replace(regression, noise=joined_noise(parts))
