"""Samples at or beyond the limits of drives: largest torque, rated speed."""

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import BoolArray, Vector, frozen
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals.masks import (
    held_samples,
    quantum,
    standstill,
    unknown_where,
)

SPEED_ROUNDING = 1.05
"""Times a model's speed limit beyond which a joint is too fast: limits are rounded."""

_AT_LIMIT = 1e-3  # share of the limit within which a torque is at it
_NEAR_PEAK = 0.95  # of a joint's largest |torque|: a limit is as far out
_FLAT = 1e-3  # of the largest |torque|: a plateau is as flat, or within half a quantum
_PLATEAU = 0.03  # s; the tops of smooth curves and single held readings are shorter
_PASSAGES = 2  # plateaus at one limit; a single one may be a rest or a gap in the log
_READINGS = 3  # of a plateau, at least
_FILLED = 0.5  # least share of a plateau at the limit (noise leaves it), and in motion
# Flatness of a plateau within which the torque before and after a smooth top stays, as
# its median over the plateau's length: a parabola falls by 4 there, and the slope at
# which a torque runs into a limit by far more.
_SLOPE = 10.0
_EVEN = 0.1  # of the same, from one sample to the next, where a torque is held
# Readings at the largest value, per reading at the next three values: the top of a
# parabola, rounded, has at most 2.4 times as many as the next value.
_TIES = 5.0
_TIED_PASSAGES = 5  # of readings that noise separates
_TIED_READINGS = 2  # in half of these passages at most: longer ones are steps


def saturated(recording: Recording, limit: ArrayLike | None = None) -> BoolArray:
    """Return where each joint's torque is at its limit, shape (samples, joints).

    Parameters
    ----------
    recording : Recording
        With torque, as recorded: filters round a plateau off.
    limit : array_like, shape () or (joints,), optional, [N m or N]
        Largest torque either way.  By default the largest or the smallest torque of a
        joint is a limit if the torque runs into it with a slope and stays there for
        0.03 s, at least twice, while the robot moves.  It is within 5 % of the joint's
        largest absolute torque.  A torque that stays at lower values as often is held
        or computed in steps.  A reading that a slower channel holds for several samples
        is counted once.  Where noise cuts the plateaus short, equal readings show the
        limit: the largest value is read 5 times as often as each of the next three.

    Raises
    ------
    RecordingError
        If there is no torque, or a limit is not positive.
    """
    torque = recording.torque
    if torque is None:
        raise RecordingError(f"{recording.name} has no torque")
    if limit is not None:
        shape = (len(recording.joints),) if np.ndim(limit) else ()
        bounds = frozen(limit, shape, "limit", RecordingError)
        if not (bounds > 0.0).all():
            raise RecordingError(f"limit is {bounds}, expected positive numbers")
        return np.asarray(abs(torque) >= (1.0 - _AT_LIMIT) * bounds)
    step = float(np.median(np.diff(recording.time)))
    moves = _robot_moves(recording)
    return np.column_stack([_limited(tau, step, moves) for tau in torque.T])


def cut_off(recording: Recording) -> BoolArray:
    """Return where a channel ends at a value of one sign, shape (samples, joints).

    Drives have limits of both signs, near a joint's largest torque (`saturated`). A
    channel may also lose all torque beyond a value of one sign, however small: this
    value is then read 5 times as often as each of the next three.  A torque of zero is
    that of a drive that is off.
    """
    step = float(np.median(np.diff(recording.time)))
    moves, found = _robot_moves(recording), []
    for tau in np.asarray(recording.torque).T:
        least = max(round(_PLATEAU / step), _READINGS * held_samples(tau))
        found.append(_tied(tau, moves, least, nearest=-1.0))
    return np.column_stack(found)


def beyond_speed(recording: Recording, limit: ArrayLike) -> BoolArray:
    """Return where each joint is faster than a limit, shape (samples, joints).

    Beyond their rated speed drives lack voltage: the torque that is commanded, or
    computed from currents, is then not the torque that acts.

    Parameters
    ----------
    recording : Recording
        Without a velocity, differences of position are used: filter first.
    limit : array_like, shape () or (joints,), [rad/s or m/s]
        Rated speed either way; infinite or zero where it is not known.

    Raises
    ------
    RecordingError
        If a limit is negative or not a number.

    Examples
    --------
    >>> time = np.arange(5) / 10.0
    >>> log = Recording(("elbow",), time, time[:, None] ** 2)
    >>> beyond_speed(log, 0.5)[:, 0].tolist()
    [False, False, False, True, True]
    """
    bounds = np.broadcast_to(np.asarray(limit, dtype=float), (len(recording.joints),))
    if not (bounds >= 0.0).all():
        raise RecordingError(f"limit is {bounds}, expected positive numbers")
    speed = abs(velocities(recording))
    return np.asarray(speed > np.where(bounds > 0.0, bounds, np.inf))


def within_speed(
    recording: Recording, limit: ArrayLike, *, reach: float = 0.0
) -> Recording:
    """Return a recording in which the torque of joints beyond a speed is unknown.

    Parameters
    ----------
    recording : Recording
        With velocity.
    limit : array_like, shape () or (joints,), [rad/s or m/s]
        See `beyond_speed`.
    reach : float, [s]
        Time before and after for which torque is not known, either.

    Raises
    ------
    RecordingError
        As `beyond_speed`.

    Examples
    --------
    >>> time = np.arange(5) / 10.0
    >>> log = Recording(("elbow",), time, time[:, None] ** 2)
    >>> within_speed(log, 0.5).torque_known[:, 0].tolist()
    [True, True, True, False, False]
    """
    return unknown_where(
        recording, lambda whole: beyond_speed(whole, limit), reach=reach
    )


def _robot_moves(recording: Recording) -> BoolArray:
    """Return where some joint moves, shape (samples,): a torque at rest may stay."""
    return np.asarray(~standstill(recording).all(axis=1))


def _limited(tau: Vector, step: float, moves: BoolArray) -> BoolArray:
    """Return where a torque, sampled every `step` seconds, is at a limit."""
    none, peak = np.zeros(len(tau), dtype=np.bool_), float(abs(tau).max())
    if not float(np.ptp(tau)) > 0.0:
        return none
    flat = max(_FLAT * peak, 0.5 * quantum(tau))
    least = max(round(_PLATEAU / step), _READINGS * held_samples(tau))
    found = none
    lengths: list[int] = []
    for side in (tau, -tau):
        if side.max() < _NEAR_PEAK * peak:
            continue
        at = side >= side.max() - flat
        passages = [
            run.stop - run.start
            for run in _filled_runs(at, least)
            if moves[run].mean() > _FILLED and _runs_into(side, run, flat)
        ]
        if passages:
            found, lengths = found | at, lengths + passages
    if len(lengths) >= _PASSAGES and len(lengths) > _stays(
        tau, peak, flat, int(np.median(lengths))
    ):
        return found
    return _tied(tau, moves, least)


def _tied(
    tau: Vector, moves: BoolArray, least: int, nearest: float = _NEAR_PEAK
) -> BoolArray:
    """Return where a torque has its largest value, if that value is a limit.

    Readings of a torque that no limit cuts off are as rare at the largest value as at
    the next ones.  Passages at the limit that noise interrupts need not be long; of
    passages as long as `least` samples, one is enough beside others.  It is at least
    `nearest` times the largest |torque|.
    """
    peak, rounding = float(abs(tau).max()), 0.5 * quantum(tau)
    found, lengths = np.zeros(len(tau), dtype=np.bool_), []
    for side in (tau, -tau):
        top = float(side.max())
        if top < nearest * peak or top == 0.0:
            continue
        at = side >= top - max(rounding, _FLAT**3 * peak)
        _, next_ones = np.unique(side[~at], return_counts=True)
        tied = at & moves
        if tied.sum() < _TIES * max(next_ones[-3:], default=1):
            continue
        flat = max(_FLAT * peak, rounding)
        passages = [run for run in _runs(tied) if _runs_into(side, run, flat)]
        found |= at
        lengths += [run.stop - run.start for run in passages]
    held = held_samples(tau)
    noisy = len(lengths) >= _TIED_PASSAGES and (
        np.median(lengths) <= _TIED_READINGS * held
    )
    long = len(lengths) >= _PASSAGES and max(lengths) >= least
    return found if noisy or long else np.zeros_like(found)


def _filled_runs(at: BoolArray, least: int) -> list[slice]:
    """Return runs of at least `least` samples of which most are marked."""
    first = np.arange(len(at)) - least // 2
    low, high = np.clip([first, first + least], 0, len(at))
    before = np.concatenate([[0], np.cumsum(at)])
    near = (before[high] - before[low]) / least > _FILLED
    found = []
    for run in _runs(near | at):
        marked = np.flatnonzero(at[run]) + run.start
        if len(marked) and marked[-1] - marked[0] + 1 >= least:
            whole = slice(int(marked[0]), int(marked[-1]) + 1)
            if at[whole].mean() > _FILLED:
                found.append(whole)
    return found


def _runs(mask: BoolArray) -> list[slice]:
    ends = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in ends.reshape(-1, 2)]


def _runs_into(tau: Vector, run: slice, flat: float) -> bool:
    """Return whether the torque comes to a plateau, or leaves it, with a slope."""
    length, level = run.stop - run.start, tau[run].max()
    sides = tau[max(run.start - length, 0) : run.start], tau[run.stop :][:length]
    away = [abs(level - float(np.median(side))) for side in sides if len(side)]
    return any(rise > _SLOPE * flat for rise in away)


def _stays(tau: Vector, peak: float, flat: float, least: int) -> int:
    """Return the number of equally long stays above half of a torque's peak."""
    still = abs(np.diff(tau)) <= _EVEN * flat
    between = (abs(tau) > 0.5 * peak) & (abs(tau) < _NEAR_PEAK * peak)
    return sum(
        run.stop - run.start + 1 >= least
        and _runs_into(abs(tau), slice(run.start, run.stop + 1), flat)
        for run in _runs(still & between[1:])
    )
