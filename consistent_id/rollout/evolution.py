"""The evolution strategy of [Hansen2016]_, for errors with steps and many minima."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector

POPULATION = 28
"""Points of a generation."""

_WIDEST = 0.3  # of the box: width of a search


class Evolved(NamedTuple):
    """The end of an evolution.

    Parameters
    ----------
    best : ndarray, shape (parameters,)
        Point of least error.
    mean : ndarray, shape (parameters,)
        Of the last distribution, `width` its size and `spread` its covariance's shape.
    """

    best: Vector
    mean: Vector
    width: float
    spread: Matrix


def evolved(
    error: Callable[[Matrix], Vector],
    start: Vector,
    width: float,
    generations: int,
    rng: np.random.Generator,
    spread: Matrix | None = None,
) -> Evolved:
    """Search the unit cube for the least error by an evolution strategy.

    Covariance matrix adaptation [Hansen2016]_.

    Parameters
    ----------
    error : callable
        From points, shape (sets, parameters), to their errors.
    width : float
        First standard deviation.
    spread : ndarray, shape (parameters, parameters), optional
        First covariance's shape.
    """
    n, count = len(start), POPULATION
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
    mean, C = start.copy(), np.eye(n) if spread is None else spread
    path, sizes = np.zeros(n), np.zeros(n)
    best, least = start, float(error(start[None])[0])
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
    return Evolved(best, np.clip(mean, 0.0, 1.0), width, C)
