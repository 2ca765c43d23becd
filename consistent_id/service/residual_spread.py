"""How far torque from outside moves while nothing touches the arm.

The difference of the torque from its mean a moment ago comes from errors of the model:
of friction, where a joint starts, stops or turns round; of rotors and bodies, where it
accelerates; of gains, where the load changes.  Its variance is a sum of squared changes
of these quantities with weights that are not negative, joint by joint.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    checked,
    freeze_arrays,
)
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording

SLOW = 0.05  # rad/s or m/s; below, a joint counts as slow
STATES = ("rest", "slow", "steady")  # slow all the time of the memory, sometimes, never
SLACK = 1e-9  # s; of differences of times
COVERED = 0.5  # share of the memory that is free, for a mean
_PARTS = 6  # quantities of a joint in a row of signals
_ROUNDS = 15  # of weighted least squares for the variances
_LARGEST = 0.999  # quantile of a squared change, above which it counts no more
_TOP = 20  # largest values at least, from which rare ones are extrapolated
_SHARE = 0.05  # of all values, where these are more
_DEPENDENT = 1e-9  # least eigenvalue of a correlation, over the sum of all
_FLOOR = 1e-12  # of the largest variance, which no joint's falls below


@dataclass(frozen=True, slots=True)
class Signals:
    """The channels that describe the motion.

    A row of signals has, for all joints: torque, direction ``s = tanh(dq / SLOW)``,
    nearness to rest ``1 - s^2``, velocity, acceleration, and the model's torque.
    """

    velocity: bool
    acceleration: bool
    expected: bool

    def shared(self, other: "Signals") -> "Signals":
        """Return the channels that both have."""
        return Signals(
            self.velocity and other.velocity,
            self.acceleration and other.acceleration,
            self.expected and other.expected,
        )

    def row(
        self,
        joints: int,
        torque: ArrayLike,
        velocity: ArrayLike | None,
        acceleration: ArrayLike | None,
        expected: ArrayLike | None,
    ) -> Vector:
        """Return the signals of one sample."""
        channels = {
            "velocity": velocity,
            "acceleration": acceleration,
            "expected": expected,
        }
        missing = [c for c, v in channels.items() if getattr(self, c) and v is None]
        if missing:
            raise ProblemError(
                f"no {' and no '.join(missing)}; the detector was fitted to logs that "
                "have them. Fit it to logs without, or give them"
            )
        used = [
            checked(values, (joints,), name)[None]
            if values is not None and getattr(self, name)
            else None
            for name, values in channels.items()
        ]
        row: Vector = _rows(checked(torque, (joints,), "torque")[None], *used)[0]
        return row

    def rows(self, log: Recording) -> Matrix:
        """Return the signals of a log, shape (samples, 6 joints)."""
        if log.torque is None:
            raise ProblemError(f"{log.name} has no torque")
        channels = {
            "velocity": log.velocity,
            "acceleration": log.acceleration,
            "expected": log.torque_command,
        }
        missing = [c for c, v in channels.items() if getattr(self, c) and v is None]
        if missing:
            raise ProblemError(
                f"{log.name} has no {' and no '.join(missing)}; the detector was "
                "fitted to logs that have them"
            )
        return _rows(
            log.torque,
            *(v if getattr(self, c) else None for c, v in channels.items()),
        )


def signals_of(log: Recording) -> Signals:
    """Return the channels that a log has."""
    return Signals(
        log.velocity is not None,
        log.acceleration is not None,
        log.torque_command is not None,
    )


@dataclass(frozen=True, slots=True, eq=False)
class FreePart:
    """Samples of a log, with means before them; to learn from, those without contact.

    Attributes
    ----------
    time : ndarray, shape (samples,), [s]
    rows, means : ndarray, shape (samples, 6 joints)
        Signals, and their means in the memory.
    states : ndarray of int, shape (samples, joints)
        Numbers in `STATES`.
    """

    time: Vector
    rows: Matrix
    means: Matrix
    states: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSpread:
    """Standard deviations of changes without a contact, by the state of the motion.

    Parameters
    ----------
    signals : Signals
    coefficients : ndarray, shape (joints, 9)
        Coefficients of the squared changes, see `_squares`; not negative.
    largest : ndarray, shape (joints, 9)
        Values above which squared changes count no more: a push that moves the arm must
        not hide itself.
    levels : ndarray, shape (joints, 3)
        Factor of each joint's standard deviation in each of `STATES`, so that large
        values are equally rare in all.
    weights : ndarray, shape (joints, joints)
        Inverse of the correlation of changes over their standard deviations.
    """

    signals: Signals
    coefficients: Matrix
    largest: Matrix
    levels: Matrix
    weights: Matrix

    def __post_init__(self) -> None:
        n = len(self.weights)
        freeze_arrays(
            self,
            {
                "coefficients": (n, None),
                "largest": (n, None),
                "levels": (n, len(STATES)),
                "weights": (n, n),
            },
        )

    @property
    def covariance(self) -> Matrix:
        """Covariance of the changes at rest, shape (joints, joints), [(N m)^2]."""
        # Levels are of rare values; ordinary ones have the variance itself.
        n = len(self.weights)
        still = np.zeros((1, _PARTS * n))
        still[:, 2 * n : 3 * n] = 1.0
        squares = np.minimum(
            _squares(still, still, np.zeros((1, n), dtype=np.intp)), self.largest
        )
        sigma = np.sqrt(np.einsum("kjf,jf->kj", squares, self.coefficients))[0]
        spread = np.linalg.inv(self.weights)
        scale = sigma / np.sqrt(np.diag(spread))
        return np.asarray(spread * np.outer(scale, scale))

    def deviations(self, rows: Matrix, means: Matrix, states: IntArray) -> Matrix:
        """Return standard deviations of changes, times the levels of the states."""
        squares = np.minimum(_squares(rows, means, states), self.largest)
        variance = np.einsum("kjf,jf->kj", squares, self.coefficients)
        return np.asarray(
            np.sqrt(variance) * np.take_along_axis(self.levels.T, states, axis=0)
        )

    def distances(self, part: FreePart) -> Vector:
        """Return the Mahalanobis distances of a part."""
        n = len(self.weights)
        change = (part.rows - part.means)[:, :n]
        scaled = change / self.deviations(part.rows, part.means, part.states)
        squares = np.einsum("ki,ij,kj->k", scaled, self.weights, scaled)
        return np.asarray(np.sqrt(squares))


def window_states(rows: Matrix, joints: int) -> IntArray:
    """Return the joints' states of one memory, shape (joints,)."""
    slow = abs(rows[:, 3 * joints : 4 * joints]) < SLOW
    return np.where(slow.all(axis=0), 0, np.where(slow.any(axis=0), 1, 2))


def compared(
    log: Recording,
    signals: Signals,
    memory: tuple[float, float],
    free: BoolArray | None = None,
) -> tuple[FreePart, BoolArray]:
    """Return a log's samples with their means, and which have one to compare with.

    A mean is of free samples (by default all), of which the memory has enough.
    """
    newest, oldest = memory
    rows, time = signals.rows(log), log.time
    n = len(log.joints)
    counts_in = np.ones(len(time), dtype=bool) if free is None else free
    first = np.searchsorted(time, time - oldest - SLACK)
    last = np.searchsorted(time, time - newest + SLACK, side="right")
    # Sums of differences from the first sample: fewer digits are lost.
    kept = (rows - rows[0]) * counts_in[:, None]
    sums = np.vstack([np.zeros(rows.shape[1]), np.cumsum(kept, axis=0)])
    counts = np.concatenate([[0], np.cumsum(counts_in)])
    number = counts[last] - counts[first]
    means = (sums[last] - sums[first]) / np.maximum(number, 1)[:, None] + rows[0]
    slow = abs(rows[:, 3 * n : 4 * n]) < SLOW
    counted = np.vstack([np.zeros(n, dtype=np.intp), np.cumsum(slow, axis=0)])
    here = np.arange(1, len(time) + 1)
    among = counted[here] - counted[first]
    states = np.where(among == (here - first)[:, None], 0, np.where(among > 0, 1, 2))
    enough = number >= np.maximum(COVERED * (last - first), 1)
    return FreePart(time, rows, means, states), enough & (time >= time[0] + oldest)


def free_part(
    log: Recording, free: BoolArray, signals: Signals, memory: tuple[float, float]
) -> FreePart:
    """Return the free samples of a log that have a mean to compare with."""
    part, known = compared(log, signals, memory, free)
    use = free & known
    return FreePart(part.time[use], part.rows[use], part.means[use], part.states[use])


def least_of_row(values: Array, in_a_row: int) -> Array:
    """Return the least size of each value and of those before it, in a row.

    Values of both signs in a row have none, and neither have the first ones.
    """
    if in_a_row > len(values):
        return np.zeros_like(values)
    rows = np.lib.stride_tricks.sliding_window_view(values, in_a_row, axis=0)
    same = (rows > 0.0).all(axis=-1) | (rows < 0.0).all(axis=-1)
    out = np.zeros_like(values)
    out[in_a_row - 1 :] = abs(rows).min(axis=-1) * same
    return out


def fitted_spread(
    parts: Sequence[FreePart],
    rate: float,
    signals: Signals,
    oldest: float,
    in_a_row: int,
) -> tuple[ResidualSpread, float, float]:
    """Return the spread, the distance that is exceeded `rate` times an hour, and hours.

    Parameters
    ----------
    parts : sequence of FreePart
    rate : float, [1/h]
    signals : Signals
    oldest : float, [s]
        Time in which exceedances count once.
    in_a_row : int
        Samples that have to exceed together.
    """
    rows, means, states = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("rows", "means", "states")
    )
    n = rows.shape[1] // _PARTS
    # A gap, such as a touch that was left out, counts as the memory at most.
    steps = [np.minimum(np.diff(part.time), oldest).sum() for part in parts]
    hours = float(sum(steps)) / 3600.0
    if hours * 3600.0 < 2 * _TOP * oldest:
        raise ProblemError(
            f"nothing touched the arm for {hours * 3600:.3g} s of the logs, expected "
            f"{2 * _TOP * oldest:.3g} s or more to learn from"
        )
    change = (rows - means)[:, :n]
    squares = _squares(rows, means, states)
    largest = np.quantile(squares, _LARGEST, axis=0)
    coefficients = _coefficients(change**2, np.minimum(squares, largest))
    plain = ResidualSpread(
        signals, coefficients, largest, np.ones((n, len(STATES))), np.eye(n)
    )
    scaled = [_scaled(part, plain) for part in parts]
    lasting = [least_of_row(z, in_a_row) for z in scaled]
    levels = _levels(parts, lasting, rate, hours, oldest)
    z = np.concatenate(scaled) / np.take_along_axis(levels.T, states, axis=0)
    correlation = z.T @ z / len(z)
    if not np.linalg.eigvalsh(correlation)[0] > _DEPENDENT * np.trace(correlation):
        raise ProblemError(
            "a joint's torque from outside never changes, or is a sum of those of "
            "other joints: leave such joints out of the logs"
        )
    weights: Matrix = np.linalg.inv(correlation).astype(np.float64)
    found = ResidualSpread(signals, coefficients, largest, levels, weights)
    tops = [
        interval_maxima(
            part.time, least_of_row(found.distances(part), in_a_row), oldest
        )
        for part in parts
    ]
    return found, rare_level(np.concatenate(tops), rate * hours), hours


def _rows(
    torque: Matrix,
    velocity: Matrix | None = None,
    acceleration: Matrix | None = None,
    expected: Matrix | None = None,
) -> Matrix:
    none = np.zeros_like(torque)
    rate = none if velocity is None else velocity
    direction = np.tanh(rate / SLOW)
    push, model = (none if x is None else x for x in (acceleration, expected))
    return np.hstack([torque, direction, 1.0 - direction**2, rate, push, model])


def _squares(rows: Matrix, means: Matrix, states: IntArray) -> Array:
    """Return squared changes of the causes of errors, shape (samples, joints, 9).

    A joint that rests has none: a push that moves it a little must not hide itself.
    """
    shape = len(rows), _PARTS, -1
    now, before = rows.reshape(shape), means.reshape(shape)
    moves = (states > 0).astype(np.float64)
    changes = ((now - before) ** 2)[:, 1:] * moves[:, None]
    direction, nearness, velocity, acceleration, expected = np.moveaxis(changes, 1, 0)
    everywhere = acceleration.sum(axis=1)[:, None]
    return np.stack(
        [
            np.ones_like(moves),
            direction,
            nearness,
            velocity,
            acceleration,
            np.broadcast_to(everywhere, moves.shape),
            expected,
            np.where(states > 0, now[:, 2], 1.0),  # near rest
            now[:, 3] ** 2 * moves,  # ripple grows with velocity
        ],
        axis=2,
    )


def _coefficients(target: Matrix, squares: Array) -> Matrix:
    """Return weights of a sum that is the expected square, joint by joint.

    Weighted least squares with the sum itself as weight: the score equations of
    a gamma distribution.
    """
    from scipy.optimize import nnls

    joints, terms = squares.shape[1:]
    mean = target.mean(axis=0)
    floor = np.maximum(_FLOOR * mean.max(), 1e-300)
    out = np.zeros((joints, terms))
    out[:, 0] = np.maximum(mean, floor)
    for j in range(joints):
        of_joint = squares[:, j]
        scale = np.sqrt((of_joint**2).mean(axis=0))
        scale[scale == 0.0] = np.inf  # never changes
        for _ in range(_ROUNDS):
            total = of_joint @ out[j]
            found, _ = nnls(of_joint / scale / total[:, None], target[:, j] / total)
            out[j] = 0.5 * (out[j] + found / scale)
            out[j, 0] = max(out[j, 0], floor)
    return out


def _scaled(part: FreePart, spread: ResidualSpread) -> Matrix:
    n = len(spread.weights)
    change = (part.rows - part.means)[:, :n]
    return np.asarray(change / spread.deviations(part.rows, part.means, part.states))


def _levels(
    parts: Sequence[FreePart],
    lasting: Sequence[Matrix],
    rate: float,
    hours: float,
    oldest: float,
) -> Matrix:
    """Return each joint's rare value in each state, in standard deviations."""
    n = lasting[0].shape[1]
    out = np.full((n, len(STATES)), np.nan)
    budget = rate * hours / (n * len(STATES))
    for j in range(n):
        for state in range(len(STATES)):
            tops = np.concatenate(
                [
                    interval_maxima(
                        part.time,
                        np.where(part.states[:, j] == state, z[:, j], 0.0),
                        oldest,
                    )
                    for part, z in zip(parts, lasting, strict=True)
                ]
            )
            if (tops > 0.0).sum() >= 2 * _TOP:
                out[j, state] = rare_level(tops[tops > 0.0], budget)
    if np.isnan(out).all():
        raise ProblemError(
            f"no joint rests, or moves, for {2 * _TOP} times {oldest:g} s of the logs; "
            "expected longer logs in which nothing touches the arm"
        )
    # A state that the logs do not have is as bad as the joint's worst, or any joint's.
    worst = np.where(np.isnan(out).all(axis=1), np.nanmax(out), _worst(out))
    return np.where(np.isnan(out), worst[:, None], out)


def _worst(levels: Matrix) -> Vector:
    return np.asarray(np.where(np.isnan(levels), 0.0, levels).max(axis=1))


def interval_maxima(time: Vector, values: Vector, length: float) -> Vector:
    """Return the largest value in each interval of the given length."""
    if not len(time):
        return np.zeros(0)
    block = np.floor((time - time[0]) / length)
    starts = np.flatnonzero(np.diff(block, prepend=-1.0))
    return np.asarray(np.maximum.reduceat(values, starts))


def rare_level(values: Vector, expected: float) -> float:
    """Return the level that `expected` of so many new values exceed.

    The largest values fall off exponentially; the mean of `n` excesses is known from
    themselves alone, so that the tail is ``(1 + x / (n mean))^-n`` for a new value.
    """
    ordered = np.sort(values)[::-1]
    n = max(_TOP, round(_SHARE * len(ordered)))
    n = min(n, len(ordered) - 1)
    if expected >= n:
        return float(ordered[min(round(expected), len(ordered) - 1)])
    excess = float((ordered[:n] - ordered[n]).mean())
    return float(ordered[n] + n * excess * np.expm1(np.log(n / expected) / n))
