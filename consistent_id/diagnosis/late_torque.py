"""Torque that lags by much: a delay, or the low-pass filter of a drive.

The torque that is logged is ``tau(t - d)`` behind a low-pass filter of first order.
Filtered columns are compressed once with the torque at all delays as right-hand sides,
so that a delay costs a column.
"""

from collections.abc import Iterator

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id.diagnosis.channel_factors import ChannelFactors, joint_factor
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog
from consistent_id.regression.motion_arrays import motion_of
from consistent_id.regression.regression import triangle

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
_EXPLAINED = 0.03  # of the torque: misfit below which no lag of this size is in it
_LAGS = 1e-3 * np.arange(-60.0, 320.0, 20.0)  # s, of the torque behind the motion
_FINE = 1e-3 * np.arange(-15.0, 16.0, 5.0)  # s, about the best of these
_CONSTANTS = (0.08, 0.12, 0.16, 0.22, 0.3, 0.45)  # s, of the filters; less is a delay
_LEAST = 0.05  # s, below which linearisation finds it
_EARLY = 0.02  # s, that a filtered torque may seem to be early
# Ratio of misfits up to which a delay stands for a filter: smoothing rounds the edges
# of friction, which fits them better, filter or not.
_SIMPLER = 2.0


def late_torque(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with the delay, or with the filter and delay, that fits best."""
    if as_is.misfit < _EXPLAINED:
        return
    log, model, base = as_is.recording, as_is.factors.model, as_is.factors.base
    motion = motion_of(model, log, None)
    Y = model.regressor(motion.q, motion.dq, motion.ddq)[:, list(base.independent)]
    tried: list[tuple[float, float, float]] = []
    for constant in (0.0, *_CONSTANTS):
        columns = low_pass(Y, constant * log.rate)
        for lags in (_LAGS, None):
            grid = tried[-1][1] + _FINE if lags is None else lags
            misfits = _misfits(columns, motion.torque, grid * log.rate)
            k = int(np.argmin(misfits))
            tried.append((float(misfits[k]), float(grid[k]), constant))
    delay, best = min(t for t in tried if not t[2]), min(tried)
    _, lag, constant = delay if delay[0] <= _SIMPLER * best[0] else best
    if abs(lag) + constant < _LEAST or (constant and lag < -_EARLY):
        return
    columns = low_pass(Y, constant * log.rate)
    inner, moved = _moved(motion.torque, np.array([lag * log.rate]))
    kept = columns[:, :, inner]
    factors = tuple(joint_factor(rows, moved[0]) for rows in kept)
    other = ChannelFactors(model, base, factors, kept.shape[2])
    yield Candidate(_cause(lag, constant), other, as_is.constraints)


def _cause(lag: float, constant: float) -> Cause:
    undone = "earlier" if lag > 0.0 else "later"
    is_now = "later" if lag > 0.0 else "earlier"
    if not constant:
        return Cause(
            "lag",
            "all joints",
            f"the torque is {is_now} than the motion: with it {1e3 * abs(lag):.3g} ms "
            f"{undone}",
            "shift torque or motion in time before filtering",
            _THRESHOLD,
        )
    return Cause(
        "drive filter",
        "all joints",
        f"with a torque that passed a low-pass filter of "
        f"{1.0 / (2.0 * np.pi * constant):.2g} Hz, {1e3 * abs(lag):.3g} ms {is_now}",
        "log the torque unfiltered, or the motion through the same filter",
        _THRESHOLD,
    )


def low_pass(values: Array, samples: float) -> Array:
    """Return signals behind a filter of first order, from rest, along the last axis.

    `samples` is its time constant; zero filters nothing.
    """
    if samples == 0.0:
        return values
    from scipy.linalg.lapack import dtbtrs  # scipy.signal takes a second to import

    # y[k] - keep y[k - 1] = (1 - keep) x[k], with x less its first value.
    keep, first = float(np.exp(-1.0 / samples)), values[..., :1]
    series = (1.0 - keep) * (values - first).reshape(-1, values.shape[-1])
    band = np.repeat([[1.0], [-keep]], values.shape[-1], axis=1)
    filtered, _ = dtbtrs(band, series.T, uplo="L", diag="U", overwrite_b=1)
    return np.asarray(filtered.T.reshape(values.shape) + first)


def _misfits(columns: Array, torque: Matrix, lags: Array) -> Array:
    """Return what least squares leaves at each lag, joints relative to their torque."""
    inner, moved = _moved(torque, lags)
    count, rows = columns.shape[1], []
    for j, own in enumerate(columns[:, :, inner]):
        right = moved[:, :, j].T
        size = max(float(np.linalg.norm(right, axis=0).mean()), 1e-300)
        rows.append(joint_factor(own, right) / size)
    R = triangle(np.asfortranarray(np.vstack(rows)))
    left: Array = np.linalg.norm(R[count:, count:], axis=0) / np.sqrt(len(rows))
    return left


def _moved(torque: Matrix, lags: Array) -> tuple[slice, Array]:
    """Return inner samples, and the torque there, later by lags [samples].

    The torque's shape is (lags, inner samples, joints).
    """
    reach = int(np.ceil(abs(lags).max())) + 1
    inner = slice(reach, len(torque) - reach)
    whole = np.floor(lags).astype(int)
    moved = []
    for first, part in zip(whole, lags - whole, strict=True):
        low = torque[inner.start + first : inner.stop + first]
        high = torque[inner.start + first + 1 : inner.stop + first + 1]
        moved.append((1.0 - part) * low + part * high)
    return inner, np.array(moved)
