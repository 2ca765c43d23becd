"""Robots of a fleet with other bodies, found by the misfit that sharing costs.

With the squared misfits of robot ``i`` alone, of all others, and of all together, each
row divided by its noise,

``T_i = S_all - S_i - S_others``

has a ``chi^2`` distribution if robot ``i`` has the bodies of the others, with as many
degrees of freedom as there are parameters that both determine [Chow1960]_.  No model is
exact, and robots of one type are not quite the same.  So the scale comes from the
fleet: the median of ``T_i`` over its degrees of freedom is the factor by which a
typical robot exceeds noise, and the ratio of a high quantile to the median, determines
the degrees of freedom of the scatter about it.  A robot's ratio to the median has an F
distribution with these.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.regression import triangle

LEVEL = 0.001
"""Nominal chance that a fleet without outliers has one named.  Measured it is 0 where
robots differ by noise alone, and some hundredths where they differ more, along a few
directions: ``benchmarks/fleet_outliers.py``."""

FEWEST = 5
"""Least number of robots for naming outliers: with fewer, the scatter is not known."""

_HIGH = 0.9  # quantile that shows how widely robots scatter; of fewer than _MANY, one
_HIGH_OF_FEW, _MANY = 0.75, 20  # that a single outlier does not move
_OF_MEDIAN = 2.0 / np.pi  # efficiency of a median beside a mean
_TINY = 1e-300
_NEAR = 0.5  # of the largest excess, from which outliers are named in one round


@brief
@dataclass(frozen=True, eq=False)
class Outliers:
    """The cost of sharing for each robot.

    Parameters
    ----------
    statistic : ndarray, shape (robots,)
        ``T_i``, against the robots that are no outliers.
    freedom : ndarray, shape (robots,)
        Its degrees of freedom.
    spread : float
        By which a typical robot's exceeds that of equal robots with known noise.
    p_values : ndarray, shape (robots,)
        Chance of so much among robots that scatter as this fleet does.
    named : ndarray of bool, shape (robots,)
    """

    statistic: Vector
    freedom: Vector
    spread: float
    p_values: Vector
    named: BoolArray


def find_outliers(factors: Sequence[Matrix]) -> Outliers:
    """Name the robots that do not share the bodies of the others.

    The largest outliers are set aside first, as they hide others; the cost grows with
    the number of robots times the number of rounds that takes.

    Parameters
    ----------
    factors : sequence of ndarray, each shape (rows, parameters + 1)
        Factors of the shared base parameters and torque, rows divided by the noise.
    """
    robots = len(factors)
    named = np.zeros(robots, dtype=np.bool_)
    while True:
        found = _tested(factors, named)
        p = found.p_values
        new = (p < LEVEL / robots) & ~named
        if not new.any() or robots < FEWEST or named.sum() + 1 > (robots - 1) // 2:
            return found
        excess = np.where(new, found.statistic / found.freedom, 0.0)
        largest = np.argsort(-excess)[: (robots - 1) // 2 - int(named.sum())]
        named = named.copy()
        named[[i for i in largest if excess[i] >= _NEAR * excess.max()]] = True


def _tested(factors: Sequence[Matrix], named: BoolArray) -> Outliers:
    from scipy.special import chdtri, fdtrc

    others = list(_without_each(factors, named))
    statistic, freedom = np.zeros(len(factors)), np.ones(len(factors))
    for i, (own, rest) in enumerate(zip(factors, others, strict=True)):
        together = triangle(np.asfortranarray(np.vstack([own, rest])))
        parts = [_least(R) for R in (together, own, rest)]
        (all_misfit, all_rank), (misfit, rank), (rest_misfit, rest_rank) = parts
        statistic[i] = max(all_misfit - misfit - rest_misfit, 0.0)
        freedom[i] = max(rank + rest_rank - all_rank, 1)
    alike = ~named
    ratio = np.maximum(statistic / freedom, _TINY)
    expected = np.median(chdtri(freedom[alike], 0.5) / freedom[alike])
    spread = max(1.0, float(np.median(ratio[alike]) / expected))
    effective = np.minimum(freedom, _freedom_of_scatter(ratio[alike]))
    behind = effective * _OF_MEDIAN * max(int(alike.sum()) - 1, 1)
    p_values = fdtrc(effective, behind, ratio / spread)
    return Outliers(statistic, freedom, spread, p_values, named)


def _freedom_of_scatter(ratio: Vector) -> float:
    """Return of which ``chi^2`` a high quantile and the median have the same ratio."""
    from scipy.special import chdtri

    high = _HIGH if len(ratio) >= _MANY else _HIGH_OF_FEW
    seen = np.quantile(ratio, high) / np.median(ratio)
    d = np.geomspace(0.1, 1e4, 200)
    known = chdtri(d, 1.0 - high) / chdtri(d, 0.5)
    return float(np.interp(-seen, -known, d))


def _without_each(factors: Sequence[Matrix], named: BoolArray) -> Iterator[Matrix]:
    """Yield, for each robot, the factor of all others that are not named."""
    none = np.zeros((0, factors[0].shape[1]))
    kept = [none if out else R for R, out in zip(factors, named, strict=True)]
    before = accumulate(kept[:-1], _joined, initial=none)
    after = list(accumulate(reversed(kept[1:]), _joined, initial=none))[::-1]
    for first, second in zip(before, after, strict=True):
        yield _joined(first, second)


def _joined(first: Matrix, second: Matrix) -> Matrix:
    return triangle(np.asfortranarray(np.vstack([first, second])))


def _least(R: Matrix) -> tuple[float, int]:
    """Return the least squared misfit of a factor, and its rank."""
    A, b = R[:, :-1], R[:, -1]
    norms = np.linalg.norm(A, axis=0)
    unit = A / np.where(norms > 0.0, norms, 1.0)
    x, _, rank, _ = np.linalg.lstsq(unit, b, rcond=DATA_RANK_TOLERANCE)
    return float(np.sum((unit @ x - b) ** 2)), int(rank)
