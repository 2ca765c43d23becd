"""The trend of parameters with the speed of motion, and predictions for other speeds.

If a model lacks friction terms, its parameters compensate for them: in slow motion,
with little acceleration, mostly the rotor inertia. So parameters of blocks depend on
the blocks' speed, and the scatter between slow blocks does not predict those of fast
ones.  Here each parameter is a line in the logarithm of speed, with a random effect of
each block in addition to its noise; the blocks determine its size [PauleMandel1982]_.
An interval is that of a block of motion at a speed: it widens beyond the blocks' own.
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
_RANGE = 1.05  # least ratio of speeds, fastest over slowest block, for a line


@dataclass(frozen=True, slots=True, eq=False)
class SpeedTrend:
    """Parameters as a function of the speed of motion.

    Parameters
    ----------
    speeds : array_like, shape (blocks,)
        Speeds of the blocks, relative to their mean; see `speed_of`.
    lines : array_like, shape (parameters, 2)
        Value at the blocks' mean speed (of its logarithm), and slope.
    covariances : array_like, shape (parameters, 2, 2)
        Covariances of the lines.
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
        """Return errors of a block's parameters at a speed, without its own noise."""
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
    """Expected parameters at a speed.

    Parameters
    ----------
    speed : float
        In the units of the trend's speeds.
    """

    trend: SpeedTrend
    speed: float

    def _found(self) -> Iterator[tuple[str, float, float]]:
        """Yield names, values and half widths of 95 % intervals."""
        values = self.trend.at(self.speed)
        widths = self.trend.quantile * self.trend.standard_errors(self.speed)
        yield from zip(self.trend.names, values.tolist(), widths.tolist(), strict=True)

    def to_dict(self) -> dict[str, Any]:
        """Return the expected parameters by name, for JSON."""
        of_names = {name: {"value": x, "half_width": w} for name, x, w in self._found()}
        return {"speed": self.speed, "parameters": of_names}

    def table(self) -> Table:
        """Return the expected parameters, for people."""
        low, high = float(self.trend.speeds.min()), float(self.trend.speeds.max())
        where = "within" if low <= self.speed <= high else "beyond"
        return Table(
            f"Parameters of a block of motion {self.speed:.2f} times as fast as the "
            f"training motion, {where} its blocks' {low:.2f} to {high:.2f}",
            ("parameter", "expected", "95 % either way"),
            tuple((name, f"{x:.4g}", f"{w:.2g}") for name, x, w in self._found()),
            (
                "by a line in the logarithm of speed: parameters compensate for "
                "missing friction terms, mostly in slow motion",
            ),
        )


def speed_of(recordings: Sequence[Recording], scale: Vector | None = None) -> float:
    """Return the speed of motion: the mean over joints of root mean squares.

    Parameters
    ----------
    recordings : sequence of Recording
        With velocity.
    scale : ndarray, shape (joints,), optional, [rad/s or m/s]
        Unit of speed of each joint; see `joint_speeds`.
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
    """Return the trend of parameters with speed.

    Parameters
    ----------
    blocks : sequence of BlockScatter
        Regressions of one block each; see `block_scatter`.
    speeds : sequence of float
        Speeds of the blocks.

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
    """Return the variance about lines, beyond noise, for which misfits are as expected.

    The weighted squared misfit decreases with it; if it is below its expectation for
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
