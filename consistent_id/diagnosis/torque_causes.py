"""Causes in the torque: drift, springs, coupled joints, lost signs, a lag.

Drift, springs and couplings are sought in the residuals of least squares: they are
regressed on torques that the model may lack.  The part with the largest effect is
subtracted from the torque, and the log is fitted again.

A torque may be logged without its sign, as some drives report the size of a current.

A torque that is late by ``d`` is logged as ``tau(t - d)``, or behind a low-pass filter
of first order.  Filtered columns are compressed once with the torque at all delays as
right-hand sides, so that each delay costs one column.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id._support.singular import lstsq, svd
from consistent_id.diagnosis.channel_factors import (
    ChannelFactors,
    channel_factors,
    joint_factor,
)
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.diagnosis.torque_parts import nominal_parts
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import triangle

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
# Ratio for a drift: a filtered torque is slow too, and a line explains half of it.
_OF_DRIFT = 2.0
_SHARE = 0.5  # least share of the squared residual that a missing part explains
_BOTH = 0.25  # the same, in each of two coupled joints
_MATTERS = 0.1  # of the largest squared residual: smaller ones are skipped
_RANK = 1e-6  # of the largest singular value of unit columns
_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Residual of a joint's torque in least squares.

    Parameters
    ----------
    spanned : ndarray, shape (samples, columns)
        Orthonormal columns of the model.
    rest : ndarray, shape (samples,), [N m or N]
    size : float
        Norm of the torque.
    """

    spanned: Matrix
    rest: Vector
    size: float

    @property
    def energy(self) -> float:
        """Squared norm over the torque's."""
        return float(self.rest @ self.rest) / self.size**2

    def amount(self, columns: Matrix) -> Vector:
        """Return the factors of further columns that explain most."""
        beside = columns - self.spanned @ (self.spanned.T @ columns)
        return lstsq(beside, self.rest, 1e-6)

    def share(self, columns: Matrix) -> float:
        """Return the share of the squared residual that further columns explain."""
        part = columns @ self.amount(columns)
        left = self.rest - part + self.spanned @ (self.spanned.T @ part)
        return 1.0 - float(left @ left) / max(float(self.rest @ self.rest), 1e-300)


def residuals(log: FittedLog) -> list[Residual]:
    """Return the residual of each joint's row in least squares of its own."""
    rows = SampleRows.of(log.factors.model, log.recording)
    found = []
    for row, tau in zip(rows.regressor(), rows.torque, strict=True):
        columns = row[list(log.factors.base.independent)].T
        U, s, _ = svd(_unit(columns), full_matrices=False)
        spanned = U[:, s > _RANK * s.max(initial=0.0)]
        rest = tau - spanned @ (spanned.T @ tau)
        found.append(Residual(spanned, rest, max(float(np.linalg.norm(tau)), 1e-300)))
    return found


def _unit(columns: Matrix) -> Matrix:
    norms = np.linalg.norm(columns, axis=0)
    return np.asarray(columns[:, norms > 0.0] / norms[norms > 0.0])


def missing_parts(as_is: FittedLog) -> list[Candidate]:
    """Return the causes that explain most of the large residuals."""
    left = residuals(as_is)
    most = max(r.energy for r in left)
    matter = [j for j, r in enumerate(left) if r.energy >= _MATTERS * most]
    return [
        *_of_one_joint(as_is, left, matter),
        *_of_pairs(as_is, left, matter),
    ]


def _of_one_joint(
    as_is: FittedLog, left: list[Residual], matter: list[int]
) -> Iterator[Candidate]:
    names = as_is.factors.model.torque_joints
    log = SampleRows.of(as_is.factors.model, as_is.recording)
    lapse = np.linspace(-1.0, 1.0, len(log.along.q))[:, None]
    for j in matter:
        q = log.place[j]
        spring = np.column_stack([q, q**2, q**3, np.sin(2 * q), np.cos(2 * q)])
        for columns, kind, statement, advice in (
            (
                lapse,
                "drift",
                "without a drift of the torque of {}",
                "warm up the sensor or the drive, or split the log (an offset each)",
            ),
            (
                spring,
                "spring",
                "with a torque at {} that depends on its position",
                "add spring = true to its drive terms, or an own term: it may have a "
                "counterbalance, a cable or a spring",
            ),
        ):
            seen = log.motion.through(columns, j)
            if left[j].share(seen) >= _SHARE:
                cause = Cause(
                    kind,
                    names[j],
                    statement.format(names[j]),
                    advice,
                    _OF_DRIFT if kind == "drift" else _THRESHOLD,
                    excuse=2 if kind == "spring" else 0,
                    of_residual=True,
                )
                parts = {names[j]: columns @ left[j].amount(seen)}
                yield _without(as_is, cause, parts)
                break


def _of_pairs(
    as_is: FittedLog, left: list[Residual], matter: list[int]
) -> Iterator[Candidate]:
    names = as_is.factors.model.torque_joints
    log = SampleRows.of(as_is.factors.model, as_is.recording)
    for i, j in combinations(matter, 2):
        both = np.tanh((log.speed[i] + log.speed[j]) / _CREEP)[:, None]
        seen = {k: log.motion.through(both, k) for k in (i, j)}
        if min(left[k].share(columns) for k, columns in seen.items()) < _BOTH:
            continue
        cause = Cause(
            "coupling",
            f"{names[i]}, {names[j]}",
            f"with friction of a motor that turns with {names[i]} and {names[j]}",
            "add a gear coupling of these joints (couplings)",
            _THRESHOLD,
            of_residual=True,
        )
        parts = {names[k]: both @ left[k].amount(seen[k]) for k in (i, j)}
        yield _without(as_is, cause, parts)


def _without(as_is: FittedLog, cause: Cause, parts: dict[str, Vector]) -> Candidate:
    """Return the log without the given parts of its torque before the filter."""

    def without(raw: Recording) -> Recording:
        torque = np.array(raw.torque)
        for name, part in parts.items():
            torque[:, raw.joints.index(name)] -= part
        return replace(raw, torque=torque)

    model, base = as_is.factors.model, as_is.factors.base
    (factors,) = channel_factors(model, base, [altered(as_is.recording, without)])
    return Candidate(cause, factors, as_is.constraints)


_OF_SIGN = 2.0  # ratio of misfits, as of a torque that is reversed
_EXPLAINED = 0.03  # of the torque: misfit below which no sign or long lag is missing
_BELOW = 0.05  # of the largest torque: filters leave values this far below zero
_TURNS = 0.02  # least share of samples in which a sign is missing
_PASSES = 5  # iterations of signs and fit


def lost_signs(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with restored signs of the torque, if a channel has none.

    Channels without a sign are never negative.  The first signs are those of the
    nominal bodies.
    """
    if as_is.misfit < _EXPLAINED:
        return
    model, log = as_is.factors.model, as_is.recording
    rows = SampleRows.of(model, log)
    logged = rows.along.torque  # before the filter, because a sign is lost before it
    size, smooth = abs(logged), rows.torque.T
    bare = smooth.min(axis=0) >= -_BELOW * abs(smooth).max(axis=0)
    if not bare.any():
        return
    expected, torque = sum(nominal_parts(rows)), logged
    for _ in range(_PASSES):
        before, torque = torque, np.where(bare, np.copysign(size, expected), logged)
        signed = _with_torque(log, model.torque_joints, torque)
        if (torque == before).all():
            break
        expected = _explained(as_is.factors, SampleRows.of(model, signed), bare)
    share = np.mean(torque * logged < 0.0, axis=0)
    turned = share > _TURNS
    if not turned.any():
        return
    names = ", ".join(n for n, t in zip(model.torque_joints, turned, strict=True) if t)
    advice = f"log the torque of {names} with its sign; only its size was logged"
    if share[turned].min() > 1.0 - _TURNS:  # then it may as well be reversed
        advice = (
            f"reverse the torque of {names} by a negative gain (--torque-gain, one "
            "number for each joint); if only its size was logged, log it with its sign"
        )
    cause = Cause(
        "torque sign",
        names,
        f"with the sign that the torque of {names} has lost",
        advice,
        _OF_SIGN,
    )
    (factors,) = channel_factors(model, as_is.factors.base, [signed])
    yield Candidate(cause, factors, as_is.constraints)


def _explained(factors: ChannelFactors, rows: SampleRows, joints: BoolArray) -> Matrix:
    """Return the torque of some joints' own least squares, before the filter.

    Parameters
    ----------
    joints : ndarray of bool, shape (torque joints,)

    Returns
    -------
    ndarray, shape (samples of `along`, torque joints)
        Zero for the other joints.
    """
    model, kept, Y = rows.model, list(factors.base.independent), rows.regressor()
    explained = np.zeros(rows.along.torque.shape)
    for j in np.flatnonzero(joints):
        x = np.zeros(len(model.layout))
        x[kept] = smallest_solution(Y[j, kept].T, rows.torque[j], _RANK)
        explained[:, j] = rows.along.predicted(model, x)[:, j]
    return explained


def _with_torque(log: Recording, joints: Sequence[str], torque: Matrix) -> Recording:
    """Return a log with another torque of some joints before the filter."""

    def signed(raw: Recording) -> Recording:
        every = np.array(raw.torque)
        every[:, [raw.joints.index(name) for name in joints]] = torque
        return replace(raw, torque=every)

    return altered(log, signed)


_LAGS = 1e-3 * np.arange(-60.0, 320.0, 20.0)  # s, of the torque behind the motion
_FINE = 1e-3 * np.arange(-15.0, 16.0, 5.0)  # s, about the best of these
_CONSTANTS = (0.08, 0.12, 0.16, 0.22, 0.3, 0.45)  # s, of the filters; less is a delay
_LEAST = 0.05  # s: linearisation finds shorter lags
_EARLY = 0.02  # s by which a filtered torque may seem early
# Ratio of misfits up to which a delay is preferred to a filter.  A filter rounds the
# edges of friction, which fits better whether the drive has a filter or not.
_SIMPLER = 2.0


def late_torque(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with the delay, or with the filter and delay, that fits best."""
    if as_is.misfit < _EXPLAINED:
        return
    log, model, base = as_is.recording, as_is.factors.model, as_is.factors.base
    rows = SampleRows.of(model, log)
    Y, torque = rows.regressor()[:, list(base.independent)], rows.torque.T
    tried: list[tuple[float, float, float]] = []
    for constant in (0.0, *_CONSTANTS):
        columns = low_pass(Y, constant * log.rate)
        for lags in (_LAGS, None):
            grid = tried[-1][1] + _FINE if lags is None else lags
            misfits = _misfits(columns, torque, grid * log.rate)
            k = int(np.argmin(misfits))
            tried.append((float(misfits[k]), float(grid[k]), constant))
    delay, best = min(t for t in tried if not t[2]), min(tried)
    _, lag, constant = delay if delay[0] <= _SIMPLER * best[0] else best
    if abs(lag) + constant < _LEAST or (constant and lag < -_EARLY):
        return
    columns = low_pass(Y, constant * log.rate)
    inner, moved = _moved(torque, np.array([lag * log.rate]))
    kept = columns[:, :, inner]
    factors = tuple(joint_factor(own, moved[0]) for own in kept)
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
            size=f"{lag:.3g}",
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
    """Return signals after a first-order filter from rest, along the last axis.

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
    """Return the misfit at each lag, joints relative to their torque."""
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
    """Return inner samples, and the torque there, delayed by lags [samples].

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
