"""From rest to a state of motion, and back to rest, in a pose that suits.

For a given duration, the coefficients of the polynomial are linear in the pose at
rest; so each limit leaves an interval of poses, known without a search.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, checked
from consistent_id.motion import bernstein
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.polynomial_path import PolynomialPath
from consistent_id.motion.transfers import (
    MATCHED,
    MotionState,
    allowed_by,
    limits_of,
    shortest,
)

_ROUNDING = 1e-10  # share of a limit that is left when a pose is chosen


def approach(
    end: MotionState,
    limits: MotionLimits,
    *,
    near: ArrayLike | None = None,
) -> PolynomialPath:
    """Return the shortest polynomial path within limits from rest to a state.

    Parameters
    ----------
    near : array_like, shape (joints,), optional, [rad or m]
        Of the poses at rest from which it can be done in this time, the nearest to this
        one is taken; by default the middle one.

    Raises
    ------
    ProblemError
        As `transfer`.
    """
    limits = limits_of(limits, end.joints)
    allowed = allowed_by((end,), limits) * (1.0 - _ROUNDING)
    wanted = None if near is None else checked(near, (len(end.joints),), "near")

    def family(duration: Vector) -> Array:
        still = np.zeros((MATCHED, len(end.joints)))
        control = bernstein.hermite(still, end.values[:MATCHED], duration)
        low, high = _poses(control, duration, limits, allowed)
        pose = (low + high) / 2.0
        if wanted is not None:
            pose = np.where(low <= high, np.clip(wanted, low, high), pose)
        control[:MATCHED] += pose
        return control

    return shortest(family, (end,), limits)


def departure(
    begin: MotionState,
    limits: MotionLimits,
    *,
    near: ArrayLike | None = None,
) -> PolynomialPath:
    """Return the shortest polynomial path within limits from a state to rest.

    It is the `approach` of the same state, seen in a mirror of time.
    """
    mirror = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    mirrored = replace(begin, values=mirror * begin.values)
    path = approach(mirrored, limits, near=near)
    return replace(path, control=path.control[::-1])


def _poses(
    control: Array, duration: Vector, limits: MotionLimits, allowed: Array
) -> Array:
    """Return the least and the greatest pose that limits leave, (2, durations, joints).

    Parameters
    ----------
    control : ndarray, shape (degree + 1, durations, joints)
        Coefficients of the path from pose 0.
    allowed : ndarray, shape (4, joints)
    """
    unit = np.zeros((len(control), len(duration), 1))
    unit[:MATCHED] = 1.0
    low = np.full(control.shape[1:], -np.inf)
    high = np.full(control.shape[1:], np.inf)
    for k in range(4):
        fixed = control - limits.middle if k == 0 else control
        a = bernstein.finer(bernstein.derivative(fixed, duration, k))
        b = bernstein.finer(bernstein.derivative(unit, duration, k))
        # |a + b pose| <= allowed; where b is 0 it is no matter of the pose.
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (-allowed[k] - a) / b, (allowed[k] - a) / b
        counts = b != 0.0
        least = np.where(counts, np.minimum(one, other), -np.inf)
        most = np.where(counts, np.maximum(one, other), np.inf)
        low, high = np.fmax(low, least.max(axis=0)), np.fmin(high, most.min(axis=0))
    return np.array([low, high])
