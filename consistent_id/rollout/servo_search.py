"""Searches for the parameters of a servo: an evolution, then a descent.

The mean absolute error of simulated positions has steps and many minima, where friction
stops the joint or does not, so it is searched by the evolution strategy of
[Hansen2016]_ first.  With a dozen parameters, some of which nearly make up for each
other, that search needs very long to come to the bottom of a minimum; a descent by
Gauss and Newton needs some ten steps.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector

POPULATION = 28
"""Points of a generation."""

_WIDEST = 0.3  # of the box: width of a search


class SearchDistribution(NamedTuple):
    """The normal distribution that points of a generation are drawn from.

    Parameters
    ----------
    mean : ndarray, shape (parameters,)
    width : float
        Standard deviation along directions in which the shape has size one.
    spread : ndarray, shape (parameters, parameters), optional
        Shape of the covariance; by default that of a ball.
    """

    mean: Vector
    width: float
    spread: Matrix | None = None


class Evolved(NamedTuple):
    """The end of an evolution.

    Parameters
    ----------
    best : ndarray, shape (parameters,)
        Point of least error.
    last : SearchDistribution
        The last generation's.
    """

    best: Vector
    last: SearchDistribution


def evolved(
    error: Callable[[Matrix], Vector],
    start: SearchDistribution,
    generations: int,
    rng: np.random.Generator,
) -> Evolved:
    """Search the unit cube for the least error by an evolution strategy.

    Covariance matrix adaptation [Hansen2016]_.

    Parameters
    ----------
    error : callable
        From points, shape (sets, parameters), to their errors.
    start : SearchDistribution
        The first ones.
    """
    n, count = len(start.mean), POPULATION
    chosen = count // 2
    weights = np.log(chosen + 0.5) - np.log(np.arange(1, chosen + 1))
    weights /= weights.sum()
    mass = 1.0 / (weights**2).sum()
    c_s = (mass + 2.0) / (n + mass + 5.0)
    damping = 1.0 + c_s + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0)
    c_c = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
    c_1 = 2.0 / ((n + 1.3) ** 2 + mass)
    c_m = min(1.0 - c_1, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
    usual = np.sqrt(n) * (1.0 - 0.25 / n + 1.0 / (21.0 * n * n))
    mean, width = start.mean.copy(), start.width
    C = np.eye(n) if start.spread is None else start.spread
    path, sizes = np.zeros(n), np.zeros(n)
    best, least = start.mean, float(error(start.mean[None])[0])
    for generation in range(generations):
        squares, axes = np.linalg.eigh(C)
        lengths = np.sqrt(np.maximum(squares, 1e-20))
        steps = rng.normal(size=(count, n)) * lengths @ axes.T
        tried = mean + width * steps
        inside = np.clip(tried, 0.0, 1.0)
        errors = error(inside)
        if errors.min() < least:
            best, least = inside[errors.argmin()], float(errors.min())
        # Beyond the box the error is that of the border, and a little more.
        outside = ((tried - inside) ** 2).sum(axis=1)
        order = np.argsort(errors + least * outside)[:chosen]
        step = weights @ steps[order]
        mean = mean + width * step
        plain = axes / lengths @ (axes.T @ step)
        sizes = (1.0 - c_s) * sizes + np.sqrt(c_s * (2.0 - c_s) * mass) * plain
        size = np.linalg.norm(sizes)
        width *= float(np.exp(c_s / damping * (size / usual - 1.0)))
        width = min(width, _WIDEST)  # at the border it would grow for ever
        steady = np.sqrt(1.0 - (1.0 - c_s) ** (2 * generation + 2))
        grows = float(size / steady < (1.4 + 2.0 / (n + 1.0)) * usual)
        path = (1.0 - c_c) * path + grows * np.sqrt(c_c * (2.0 - c_c) * mass) * step
        among = (steps[order].T * weights) @ steps[order]
        C = (1.0 - c_1 - c_m) * C + c_1 * np.outer(path, path) + c_m * among
    return Evolved(best, SearchDistribution(np.clip(mean, 0.0, 1.0), width, C))


_DIFFERENCE = 2e-3  # of the box: for derivatives
_FIRST_DAMPING = 1e-2
_DAMPINGS = 10.0 ** np.arange(-3.0, 4.0)  # times the last one that was good
_FARTHEST = 0.2  # of the box: length of a step
_ENOUGH = 1e-4  # share of the error by which a step has to lessen it
_KINK = 1.0  # of the median residual: below, it counts by its square


class Descended(NamedTuple):
    """The ends of descents.

    Parameters
    ----------
    points : ndarray, shape (descents, parameters)
    errors : ndarray, shape (descents,)
    """

    points: Matrix
    errors: Vector


def descended(
    residuals: Callable[[Matrix], Matrix],
    points: Matrix,
    weights: Matrix,
    steps: int,
) -> Descended:
    """Lessen sums of weighted absolute residuals in the unit cube, side by side.

    Each step is that of Gauss and Newton for least squares whose weights are
    ``weights / max(abs(residual), kink)`` (iteratively reweighted least squares),
    damped as by Levenberg and Marquardt.  Several dampings are tried, and the point of
    least error is kept, so the error never grows.

    Parameters
    ----------
    residuals : callable
        From points, shape (sets, parameters), to residuals, shape (sets, samples).
    points : ndarray, shape (descents, parameters)
        The first ones.
    weights : ndarray, shape (descents, samples)
        Of each descent; zero where a residual does not count.
    steps : int
        At most.
    """
    points, count = points.copy(), points.shape[1]
    damping = np.full(len(points), _FIRST_DAMPING)
    errors = np.zeros(len(points))
    going = np.arange(len(points))
    for _ in range(steps):
        slopes = _slopes(residuals, points[going])
        tried = np.array(
            [
                _steps(points[k], slope, weights[k], damping[k] * _DAMPINGS)
                for k, slope in zip(going, slopes, strict=True)
            ]
        )
        sizes = abs(residuals(tried.reshape(-1, count))).reshape(*tried.shape[:2], -1)
        found = np.einsum("ktn,kn->kt", sizes, weights[going])
        still = []
        for k, slope, sets, each in zip(going, slopes, tried, found, strict=True):
            errors[k] = weights[k] @ abs(slope.at)
            least = int(each.argmin())
            if each[least] < errors[k]:
                if each[least] < (1.0 - _ENOUGH) * errors[k]:
                    still.append(k)
                points[k], errors[k] = sets[least], each[least]
                damping[k] = np.clip(damping[k] * _DAMPINGS[least], 1e-8, 1e3)
        going = np.array(still, np.intp)
        if not len(going):
            break
    return Descended(points, errors)


class _Slope(NamedTuple):
    """Residuals of a point, shape (samples,), and their derivatives."""

    at: Vector
    by: Matrix


def _slopes(residuals: Callable[[Matrix], Matrix], points: Matrix) -> list[_Slope]:
    """Return residuals and derivatives, shape (samples, parameters), by differences."""
    count = points.shape[1]
    sets = np.repeat(points[:, None], 2 * count + 1, axis=1)
    for k in range(count):
        sets[:, 1 + k, k] = np.minimum(points[:, k] + _DIFFERENCE, 1.0)
        sets[:, 1 + count + k, k] = np.maximum(points[:, k] - _DIFFERENCE, 0.0)
    found = residuals(sets.reshape(-1, count)).reshape(*sets.shape[:2], -1)
    made = []
    for tried, each in zip(sets, found, strict=True):
        up, down = each[1 : 1 + count], each[1 + count :]
        width = np.diagonal(tried[1 : 1 + count] - tried[1 + count :])
        made.append(_Slope(each[0], ((up - down) / width[:, None]).T))
    return made


def _steps(point: Vector, slope: _Slope, weights: Vector, dampings: Vector) -> Matrix:
    """Return points after a step, one for each damping, inside the unit cube."""
    sizes = abs(slope.at)
    kink = max(_KINK * float(np.median(sizes[weights > 0.0])), 1e-12)
    squares = weights / np.maximum(sizes, kink)
    A: Array = (slope.by.T * squares) @ slope.by
    scale = np.sqrt(np.diag(A))
    scale[scale <= 0.0] = 1.0  # a parameter without effect stays
    downhill = -(slope.by.T @ (squares * slope.at)) / scale
    A = A / np.outer(scale, scale)
    made = []
    for damping in dampings:
        step, free = np.zeros(len(point)), np.ones(len(point), np.bool_)
        while free.any():
            step[:] = 0.0
            own = np.flatnonzero(free)
            damped = A[np.ix_(own, own)] + damping * np.eye(len(own))
            step[own] = np.linalg.solve(damped, downhill[own]) / scale[own]
            leaves = (point <= 0.0) & (step < 0.0) | (point >= 1.0) & (step > 0.0)
            if not leaves.any():
                break
            free &= ~leaves  # at a border, the others move along it
        step *= min(1.0, _FARTHEST / max(float(abs(step).max()), 1e-12))
        made.append(np.clip(point + step, 0.0, 1.0))
    return np.array(made)
