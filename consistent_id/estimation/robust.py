"""Iteratively reweighted least squares with Huber's loss."""

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.least_squares import least_squares
from consistent_id.estimation.method import Method
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

HUBER_K = 1.345
"""Residuals beyond this many standard deviations count linearly; 95 % efficient for
Gaussian noise [Huber1981]_."""

_MAD = 1.4826  # standard deviation of a Gaussian over its median absolute deviation


@single_threaded
def huber(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    k: float = HUBER_K,
    base: BaseParameters | None = None,
    iterations: int = 30,
    tolerance: float = 1e-4,
) -> Estimate:
    """Estimate with Huber's loss: outliers pull with bounded force.

    Each joint's scale is the normalised median absolute residual; samples are weighted
    by ``min(1, k scale / |residual|)``.  The recordings are streamed once per
    iteration, and no regressor is kept.

    Parameters
    ----------
    model : TorqueModel
    recordings : Recording or sequence of Recording
    k : float
    base : BaseParameters, optional
    iterations : int
    tolerance : float
        Change of predicted torque, relative to each joint's scale, at which to stop.

    Returns
    -------
    Estimate
        Certified when the iteration has settled.
    """
    started = perf_counter()
    if not 0.0 < k < np.inf:
        raise ProblemError(f"k is {k}, expected a positive number of deviations")
    if iterations < 1:
        raise ProblemError(f"iterations is {iterations}, expected 1 or more")
    if isinstance(recordings, Recording):
        recordings = [recordings]
    base = base_parameters(model) if base is None else base
    regression = plain = build_regression(model, recordings)
    sigma = joint_noise(model, regression, base=base)
    floor = 1e-6 * np.maximum(regression.torque_rms, 1e-12)
    estimate = least_squares(model, regression.weighted(sigma), base=base)
    residuals = _residuals(estimate, recordings)
    change = np.inf
    for _ in range(iterations):
        scale = np.maximum(_MAD * np.median(abs(np.vstack(residuals)), axis=0), floor)
        weights = [
            np.sqrt(np.minimum(1.0, k * scale / np.maximum(abs(r), 1e-300)))
            for r in residuals
        ]
        regression = build_regression(model, recordings, row_weights=weights)
        estimate = least_squares(
            model, regression.weighted(scale), base=base, method=Method.HUBER
        )
        updated = _residuals(estimate, recordings)
        change = max(
            float((abs(new - old) / scale).max())
            for new, old in zip(updated, residuals, strict=True)
        )
        residuals = updated
        if change <= tolerance:
            break
    return replace(
        estimate,
        sigma=scale,
        base_covariance=None,  # the weights depend on the data
        certificate=_certificate(change, tolerance),
        notes=(f"Huber's loss, k = {k:g}; no standard errors are computed",),
        seconds=perf_counter() - started,
        fit=fit_of(model, plain, estimate.parameters, base),
    )


def _residuals(estimate: Estimate, recordings: Sequence[Recording]) -> list[Array]:
    joints = estimate.model.torque_joints
    residuals = []
    for recording in recordings:
        torque = recording.of(joints).torque
        if torque is None:
            raise ProblemError(f"{recording.name} has no torque")
        residuals.append(torque - estimate.predict(recording))
    return residuals


def _certificate(change: float, tolerance: float) -> Certificate:
    figures = {"last change": change}
    if change <= tolerance:
        return Certificate("certified", "the reweighting has settled", figures)
    return Certificate(
        "uncertified", "the reweighting has not settled; allow more iterations", figures
    )
