"""Changes of the load, found in half a second of unexplained torque.

A load adds the torque of one body to the link that carries it.  Its static part is
linear in its mass and first moment, ``r = Y_c (m, h)``.  The window's mean of ``Y_c^T W
Y_c`` and ``Y_c^T W r`` show how much better the residual is explained by a plausible
load than by none.  The size of that number while nothing changes is learned from logs
without a change, with the same estimate that follows.

Dry friction of a joint that rests has any value up to its level.  So the covariance of
the residual, ``W^-1``, has this level's square in addition where a joint is near rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.service.residual_spread import SLOW, interval_maxima, rare_level

WINDOW = 0.3
"""Length of the window, [s]: a change is announced within half a second."""

PARTS = 4  # mass and first moment; the inertia hardly changes the torque
_SHORTEST = 60.0  # s of logs, with less of which no rate of alarms can be stated
_ALL = 1e-3  # weight of a sample in which a joint rests
_RIDGE = 1e-6  # of the variances, so that the covariance is regular
_TINY = 1e-12
_LEAST = 1e-3  # uncertainty of the carried body, relative to a usual load, at least
_GAP = 5.0  # of the shortest step: a longer one may be a gap
_FULL = 0.8  # share of the window that samples have to cover


class WatchedBlock(NamedTuple):
    """The evidence of a block for a change of load.

    Attributes
    ----------
    first, last : float, [s]
        First sample, or the one after a gap of more than a window, and last sample.
    samples : int
    information : ndarray, shape (4, 4)
        Sum of ``Y_c^T W Y_c``.
    of_change, of_free : ndarray, shape (4,)
        Sums of ``Y_c^T W r``; `r` is what the estimate does not explain, and what the
        robot without a load does not.
    """

    first: float
    last: float
    samples: int
    information: Matrix
    of_change: Vector
    of_free: Vector


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LoadWatch:
    """Test for changes of the load; made by `learned_watch`.

    Parameters
    ----------
    covariance : ndarray, shape (torque joints, torque joints), [(N m)^2]
        Covariance of the residuals while joints move.
    held : ndarray, shape (torque joints,), [N m or N]
        Friction that may balance a joint at rest.
    widths : ndarray, shape (4,)
        Mass [kg] and first moments [kg m] of a usual load.
    limit : float
        Score at which a change is announced.
    false_alarms : float, [1/h]
        Stated rate.
    hours : float
        Duration in hours of the logs that it was learned from.
    window : float, [s]
    """

    covariance: Matrix
    held: Vector
    widths: Vector
    limit: float
    false_alarms: float = 1.0
    hours: float = 0.0
    window: float = WINDOW

    def __post_init__(self) -> None:
        n = len(self.covariance)
        shapes = {"covariance": (n, n), "held": (n,), "widths": (PARTS,)}
        freeze_arrays(self, shapes, "load watch")
        if not 0.0 < self.window < np.inf:
            raise ProblemError(f"the window is {self.window} s, expected more than 0")

    def __repr__(self) -> str:
        return (
            f"LoadWatch({self.false_alarms:g} false alarms an hour, from "
            f"{self.hours * 60:.1f} min, limit {self.limit:.3g})"
        )

    def block(self, rows: "WatchedRows", free: Matrix | None = None) -> WatchedBlock:
        """Return the evidence of a block's residuals.

        Parameters
        ----------
        rows : WatchedRows
        free : ndarray, shape (samples, torque joints), [N m or N], optional
            Residual of the robot without a load; by default the residual.
        """
        near = 1.0 - np.tanh(rows.velocity / SLOW) ** 2
        covariance = self.covariance + _diagonals(near * self.held**2)
        weighted = np.linalg.solve(covariance, rows.columns)
        change = rows.residual
        return WatchedBlock(
            _begin(rows.time, self.window),
            float(rows.time[-1]),
            len(rows.time),
            np.einsum("kip,kiq->pq", weighted, rows.columns),
            np.einsum("kip,ki->p", weighted, change),
            np.einsum("kip,ki->p", weighted, change if free is None else free),
        )

    def recent(
        self, blocks: Sequence[WatchedBlock], time: float
    ) -> tuple[WatchedBlock, ...]:
        """Return the blocks that have samples in the window before a time."""
        return tuple(b for b in blocks if b.last > time - self.window)

    def score(self, blocks: Sequence[WatchedBlock], covariance: Matrix) -> float:
        """Return how much better a plausible change explains the window than none.

        The root of the decrease of the weighted square, a distance; zero until the
        window is full.

        Parameters
        ----------
        covariance : ndarray, shape (4, 4)
            Covariance of the carried mass and first moment as they are known.
        """
        if not blocks or blocks[-1].last - blocks[0].first < _FULL * self.window:
            return 0.0
        samples = sum(b.samples for b in blocks)
        # Errors of the model hardly change in a window: it counts as one sample.
        information = np.sum([b.information for b in blocks], axis=0) / samples
        residual = np.sum([b.of_change for b in blocks], axis=0) / samples
        return self._better(information, residual, covariance)

    def is_free(self, block: WatchedBlock, covariance: Matrix) -> bool:
        """Return whether a block fits better without a load than with the known one."""
        information, n = block.information / block.samples, block.samples
        none = np.zeros((PARTS, PARTS))
        as_free = self._better(information, block.of_free / n, none)
        as_known = self._better(information, block.of_change / n, covariance)
        return as_free < min(as_known, self.limit)

    def _better(
        self, information: Matrix, residual: Vector, covariance: Matrix
    ) -> float:
        known = covariance + np.diag((_LEAST * self.widths) ** 2)
        changed = known + np.diag(self.widths**2)
        more, less = (
            float(residual @ np.linalg.solve(information + inverse, residual))
            for inverse in (np.linalg.inv(changed), np.linalg.inv(known))
        )
        return float(np.sqrt(max(more - less, 0.0)))


class WatchedRows(NamedTuple):
    """Samples as the watch needs them.

    Attributes
    ----------
    time : ndarray, shape (samples,), [s]
    columns : ndarray, shape (samples, torque joints, 4)
        Torque per mass and first moment of the link that carries loads.
    residual : ndarray, shape (samples, torque joints), [N m or N]
        The residual of the estimate.
    velocity : ndarray, shape (samples, torque joints), [rad/s or m/s]
    """

    time: Vector
    columns: Array
    residual: Matrix
    velocity: Matrix


class Quiet(NamedTuple):
    """A log without a change of load, as an estimate has followed it.

    Attributes
    ----------
    blocks : sequence of WatchedRows
    covariance : ndarray, shape (4, 4)
        The largest one of the carried mass and first moment.
    """

    blocks: Sequence[WatchedRows]
    covariance: Matrix

    @property
    def seconds(self) -> float:
        """Length of the log; a gap counts as a window at most."""
        if not self.blocks:
            return 0.0
        time = np.concatenate([block.time for block in self.blocks])
        return float(np.minimum(np.diff(time), WINDOW).sum())


def learned_watch(
    logs: Sequence[Quiet],
    held: Vector,
    widths: Vector,
    false_alarms: float,
    window: float = WINDOW,
) -> LoadWatch:
    """Return the test whose limit is exceeded at the stated rate without a change.

    The largest scores are taken to fall off as a power, their logarithms exponentially
    (`rare_level`): they come from errors of the model, and some logs have more of them.

    Raises
    ------
    ProblemError
        If the logs are shorter than a minute together, or the rate is not positive.
    """
    if not 0.0 < false_alarms < np.inf:
        raise ProblemError(
            f"{false_alarms} false alarms an hour, expected a number above 0"
        )
    seconds = sum(log.seconds for log in logs)
    if seconds < _SHORTEST:
        raise ProblemError(
            f"the logs without a change of load have {seconds:.3g} s, expected "
            f"{_SHORTEST:g} s or more to learn a rate of false alarms from"
        )
    plain = LoadWatch(_moving_covariance(logs), held, widths, np.inf, window=window)
    tops = [
        interval_maxima(*scores_along(plain, log.blocks, log.covariance), window)
        for log in logs
    ]
    highest = np.log(np.maximum(np.concatenate(tops), _TINY))
    limit = float(np.exp(rare_level(highest, false_alarms * seconds / 3600.0)))
    return replace(
        plain, limit=limit, false_alarms=false_alarms, hours=seconds / 3600.0
    )


def scores_along(
    watch: LoadWatch, rows: Sequence[WatchedRows], covariance: Matrix
) -> tuple[Vector, Vector]:
    """Return the times of a log's blocks, and the scores at them."""
    times, scores = [], []
    blocks: tuple[WatchedBlock, ...] = ()
    for part in rows:
        new = watch.block(part)
        blocks = watch.recent((*blocks, new), new.last)
        times.append(new.last)
        scores.append(watch.score(blocks, covariance))
    return np.array(times), np.array(scores)


def _moving_covariance(logs: Sequence[Quiet]) -> Matrix:
    """Return the residual's covariance in samples in which joints move.

    A sample is weighted by the speed of its slowest joint; all have a least weight, so
    that joints which never move together have a covariance, too.
    """
    total, count = 0.0, 0.0
    for rows in (rows for log in logs for rows in log.blocks):
        moving = np.tanh(rows.velocity / SLOW) ** 2
        weight = np.maximum(moving.min(axis=1), _ALL)
        total = total + (rows.residual * weight[:, None]).T @ rows.residual
        count += float(weight.sum())
    found = np.asarray(total) / count
    return np.asarray(found + np.diag(_RIDGE * np.diag(found) + _TINY))


def _begin(time: Vector, window: float) -> float:
    """Return the first time, or that after the last gap in a block."""
    steps = np.diff(time)
    least = max(window, _GAP * steps.min(initial=np.inf))
    gaps = np.flatnonzero(steps > least)
    return float(time[gaps[-1] + 1] if len(gaps) else time[0])


def _diagonals(values: Matrix) -> Array:
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))
