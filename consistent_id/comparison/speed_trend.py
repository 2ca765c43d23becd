"""How parameters go with the speed of motion, and what to expect of faster motion.

Where a model lacks friction, its parameters take it up: of slow motion, in which hardly
anything accelerates, most of all the rotor inertia.  So parameters of blocks go with
the blocks' speed, and no scatter between slow blocks says what fast ones have.  Here
each parameter is a line in the logarithm of speed, with a random effect of each block
beside its noise, as large as the blocks ask for [PauleMandel1982]_.  An interval is
that of a block of motion at a speed: it widens beyond the blocks' own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector, freeze_arrays
from consistent_id._support.tables import Table
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.uncertainties.block_scatter import BlockScatter
from consistent_id.recordings.recording import Recording

_BISECTIONS = 60  # of the random effect's variance
_LEVEL = 0.975  # quantile of intervals of 95 %
_RANGE = 1.05  # of speeds, fastest over slowest block, below which there is no line


@dataclass(frozen=True, slots=True, eq=False)
class SpeedTrend:
    """Parameters by the speed of motion.

    Parameters
    ----------
    speeds : array_like, shape (blocks,)
        Of the blocks, over their mean; see `speed_of`.
    lines : array_like, shape (parameters, 2)
        Value at the blocks' mean speed (of its logarithm), and slope.
    covariances : array_like, shape (parameters, 2, 2)
        Of the lines.
    between : array_like, shape (parameters,)
        Standard deviation of blocks about the line, beyond noise.
    """

    names: tuple[str, ...]
    speeds: Vector
    lines: Array
    covariances: Array
    between: Vector

    def __post_init__(self) -> None:
        n = len(self.names)
        shapes = {"speeds": (None,), "lines": (n, 2), "covariances": (n, 2, 2)}
        freeze_arrays(self, shapes | {"between": (n,)}, "trend with speed")

    @property
    def quantile(self) -> float:
        """Standard errors either way for 95 %."""
        from scipy.special import stdtrit

        return float(stdtrit(len(self.speeds) - 2, _LEVEL))

    def at(self, speed: float) -> Vector:
        """Return the parameters expected at a speed, shape (parameters,)."""
        return np.asarray(self.lines @ self._row(speed))

    def standard_errors(self, speed: float) -> Vector:
        """Return those of a block's parameters at a speed, beside its own noise."""
        row = self._row(speed)
        line = np.einsum("i,pij,j->p", row, self.covariances, row)
        return np.asarray(np.sqrt(line + self.between**2))

    def holds(self, other: BlockScatter, speed: float) -> BoolArray:
        """Return whether a block's values are within 95 % intervals for its speed."""
        errors = np.hypot(self.standard_errors(speed), other.noise)
        away = abs(other.values - self.at(speed))
        return np.asarray(away <= self.quantile * errors)

    def _row(self, speed: float) -> Vector:
        return np.array([1.0, np.log(speed) - np.log(self.speeds).mean()])


class TrendAt(NamedTuple):
    """Parameters that are expected at a speed.

    Parameters
    ----------
    speed : float
        As those of the trend's blocks are counted.
    """

    trend: SpeedTrend
    speed: float

    def _found(self) -> Iterator[tuple[str, float, float]]:
        """Yield names, values and half widths of 95 % intervals."""
        values = self.trend.at(self.speed)
        widths = self.trend.quantile * self.trend.standard_errors(self.speed)
        yield from zip(self.trend.names, values.tolist(), widths.tolist(), strict=True)

    def to_dict(self) -> dict[str, Any]:
        """Return what is expected by name, for JSON."""
        of_names = {name: {"value": x, "half_width": w} for name, x, w in self._found()}
        return {"speed": self.speed, "parameters": of_names}

    def table(self) -> Table:
        """Return what is expected, for people."""
        low, high = float(self.trend.speeds.min()), float(self.trend.speeds.max())
        where = "within" if low <= self.speed <= high else "beyond"
        return Table(
            f"Parameters of a block of motion {self.speed:.2f} times as fast as the "
            f"training motion, {where} its blocks' {low:.2f} to {high:.2f}",
            ("parameter", "expected", "95 % either way"),
            tuple((name, f"{x:.4g}", f"{w:.2g}") for name, x, w in self._found()),
            (
                "by a line in the logarithm of speed: what the model lacks of "
                "friction, parameters take up, in slow motion most",
            ),
        )


def speed_of(recordings: Sequence[Recording], scale: Vector | None = None) -> float:
    """Return the speed of motion: of each joint root mean square, then the mean.

    Parameters
    ----------
    recordings : sequence of Recording
        With velocity.
    scale : ndarray, shape (joints,), optional, [rad/s or m/s]
        Speed of each joint that counts as one; see `joint_speeds`.
    """
    speeds = joint_speeds(recordings)
    scale = speeds if scale is None else scale
    moved = scale > 0.0
    return float((speeds[moved] / scale[moved]).mean())


def joint_speeds(recordings: Sequence[Recording]) -> Vector:
    """Return each joint's root-mean-square speed, shape (joints,), [rad/s or m/s]."""
    velocity = np.vstack([np.asarray(log.velocity) for log in recordings])
    return np.asarray(np.sqrt((velocity**2).mean(axis=0)))


def speed_trend(blocks: Sequence[BlockScatter], speeds: Sequence[float]) -> SpeedTrend:
    """Find how parameters go with speed.

    Parameters
    ----------
    blocks : sequence of BlockScatter
        Each of one block; see `block_scatter`.
    speeds : sequence of float
        Of the blocks.

    Raises
    ------
    NotExcitedError
        If there are fewer than four blocks, one does not move, or all are of one speed.
    """
    fast = np.array(speeds, dtype=np.float64)
    still = len(fast) > 0 and fast.min() <= 0.0
    if len(fast) < 4 or still or fast.max() < _RANGE * fast.min():
        raise NotExcitedError(
            f"{len(fast)} blocks with speeds from {fast.min():.3g} to {fast.max():.3g} "
            "show no trend with speed; expected four or more that move at different "
            "speeds"
        )
    x = np.log(fast) - np.log(fast).mean()
    X = np.column_stack([np.ones_like(x), x])
    values = np.array([block.values for block in blocks]).T
    noise = np.array([block.noise for block in blocks]).T ** 2
    squares = _beyond_noise(X, values, noise)
    covariances = _covariances(X, noise + squares[:, None])
    lines = _lines(X, values, noise + squares[:, None])
    return SpeedTrend(blocks[0].names, fast, lines, covariances, np.sqrt(squares))


def _covariances(X: Array, variances: Array) -> Array:
    return np.linalg.inv(np.einsum("bi,pb,bj->pij", X, 1.0 / variances, X))


def _lines(X: Array, values: Array, variances: Array) -> Array:
    seen = np.einsum("bi,pb->pi", X, values / variances)
    return np.asarray(np.einsum("pij,pj->pi", _covariances(X, variances), seen))


def _beyond_noise(X: Array, values: Array, noise: Array) -> Vector:
    """Return the variance about lines, beyond noise, at which misfits are as expected.

    The weighted squared misfit falls with it; where it is below its expectation by
    noise alone, the variance is zero.
    """
    freedom = X.shape[0] - X.shape[1]

    def misfit(squares: Vector) -> Vector:
        variances = noise + squares[:, None]
        left = values - _lines(X, values, variances) @ X.T
        return np.asarray((left**2 / variances).sum(axis=1))

    low = np.zeros(len(values))
    high = ((values - values.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    needed = misfit(low) > freedom
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        more = misfit(middle) > freedom
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    return np.where(needed, 0.5 * (low + high), 0.0)
