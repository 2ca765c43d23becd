"""Intervals of a servo's parameters: from fits without a log, and from copies.

Fits without one of the logs show what differs from log to log: noise, and a form of
friction that is not the true one.  Errors that all logs share are shown by copies of
the logs, which are simulated with the parameters that were found and fitted again.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.rollout.servo_bounds import LATENCY, SearchBox
from consistent_id.rollout.servo_log import encoded
from consistent_id.rollout.servo_motion import (
    STEP,
    Pieces,
    position_residuals,
    sampled_motion,
)
from consistent_id.rollout.servo_search import descended

FINE_STEP = 0.2 * STEP
"""Time step of copies [s]."""

_COPIES = 4
_DESCENT = 8  # steps at most


class JointLogs(NamedTuple):
    """One joint's training logs, and the box of its parameters.

    Parameters
    ----------
    short, whole, fine : Pieces
        In windows, whole, and whole with steps of `FINE_STEP`.
    box : SearchBox
    again : callable
        From other positions at the same samples to windows.
    """

    short: Pieces
    whole: Pieces
    fine: Pieces
    box: SearchBox
    again: Callable[[Sequence[Vector]], Pieces]


def sample_weights(pieces: Pieces) -> Vector:
    """Return the weight of each sample in a mean over pieces of means over samples."""
    counts = np.array([len(times) for times in pieces.times])
    return np.repeat(1.0 / (counts * len(counts)), counts)


class Copies(NamedTuple):
    """Fits to copies of the logs.

    Parameters
    ----------
    errors : ndarray, shape (copies, parameters)
        Of the parameters that were found.
    misfit : float, [rad]
        Mean error of their positions.
    """

    errors: Matrix
    misfit: float


def half_intervals(
    point: Vector, spread: Matrix, misfit: float, copies: Copies
) -> Vector:
    """Return half of 95 % intervals.

    The variance of the error of a copy less the mean of m copies, ``(1 + 1 / m)
    var(copies)`` of m - 1 degrees of freedom, is that of a form of friction that is
    right.  What is wrong with the form is in the jackknife's ``(n - 1) / n sum((spread
    - point)^2)`` of n - 1 degrees; of it, the share of the squared misfit counts that
    the copies do not have, ``1 - (misfit of copies / misfit)^2``, because the rest is
    in the copies.  The sum of both has the degrees of freedom of Welch and
    Satterthwaite [JCGM100]_.  The mean error b of copies is a bias: with Student's
    distribution F and the standard deviation s, the half width h solves ``F((h - b) /
    s) - F((-h - b) / s) = 0.95``.

    Parameters
    ----------
    point : ndarray, shape (parameters,)
        Fitted to all logs.
    spread : ndarray, shape (fits, parameters)
        Each fitted without one part of the logs.
    misfit : float, [rad]
        Mean error of positions by `point`.
    """
    n, m = len(spread), len(copies.errors)
    unexplained = max(1.0 - (copies.misfit / max(misfit, 1e-12)) ** 2, 0.0)
    files = unexplained * (n - 1) / n * ((spread - point) ** 2).sum(axis=0)
    shared = (1.0 + 1.0 / m) * copies.errors.var(axis=0, ddof=1)
    total = np.maximum(files + shared, 1e-30)
    parts = (files / total) ** 2 / (n - 1) + (shared / total) ** 2 / (m - 1)
    freedom = 1.0 / np.maximum(parts, 1e-12)
    cases = zip(abs(copies.errors.mean(axis=0)), np.sqrt(total), freedom, strict=True)
    return np.array([_half(*case) for case in cases])


def _half(bias: float, deviation: float, freedom: float) -> float:
    """Return the half width that contains 95 % of errors with a bias."""
    from scipy.optimize import brentq
    from scipy.special import stdtr, stdtrit

    def short(half: float) -> float:
        inside = stdtr(freedom, (half - bias) / deviation)
        return float(inside - stdtr(freedom, (-half - bias) / deviation)) - 0.95

    # The bias alone holds at most half of the errors; as many fall on either side.
    most = bias + deviation * float(stdtrit(freedom, 0.976))
    return float(brentq(short, bias, most, xtol=1e-6 * most))


def errors_of_copies(
    names: Sequence[str], joint: JointLogs, found: Vector, rng: np.random.Generator
) -> Copies:
    """Return errors of fits to copies of the logs.

    Copies are simulated in fine steps.  What logs do not say is drawn for each copy:
    where the encoder's steps are, and up to `LATENCY` each how late the firmware
    answers a position, how late it has a goal, and how old a position is.

    Parameters
    ----------
    found : ndarray, shape (parameters,)
        In the unit cube.
    """
    box = joint.box
    truth = box.values(names, found[None])
    latency, goals, age = rng.uniform(0.0, LATENCY, (3, _COPIES))
    sets = {name: np.repeat(value, _COPIES) for name, value in truth.items()}
    sets |= {"latency": latency, "delay": truth["delay"] + goals}
    motion = sampled_motion(sets, joint.fine, age)
    fits = []
    for copy in range(_COPIES):
        windows = joint.again(
            [
                encoded(q[copy], measured, rng)
                for q, measured in zip(motion, joint.fine.measured, strict=True)
            ]
        )

        def residuals(sets: Matrix, windows: Pieces = windows) -> Matrix:
            return position_residuals(box.values(names, sets), windows)

        weights = sample_weights(windows)[None]
        fits.append(descended(residuals, found[None], weights, _DESCENT))
    fitted = box.values(names, np.concatenate([fit.points for fit in fits]))
    errors = np.column_stack([fitted[name] - truth[name] for name in names])
    return Copies(errors, float(np.mean([fit.errors for fit in fits])))
