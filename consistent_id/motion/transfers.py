"""The shortest polynomial from one state of motion to another, within limits.

It is quintic: position, velocity and acceleration are given at both ends. Bernstein
coefficients prove that a duration is long enough.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    IntArray,
    Matrix,
    Vector,
    freeze,
    freeze_arrays,
    frozen,
)
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.motion import bernstein
from consistent_id.motion.bernstein import PolynomialPath
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.robot.parameters import did_you_mean

MATCHED = 3  # position, velocity and acceleration are met at both ends
_ORDERS = ("position", "velocity", "acceleration", "jerk")
_RATIO = 1.03  # ratio of durations that are tried
# Shortest and longest of them, relative to an estimate from the limits
_REACH = (1e-4, 1e3)
_SHORTEST = 1e-3  # least duration, relative to that of crossing a joint's range
_TOLERANCE = 1e-6  # relative, of the shortest duration
_INSIDE = 1e-9  # reserve, as a share of a limit, for rounding

# Durations (t,) -> Bernstein coefficients (degree + 1, t, joints).
Family = Callable[[Vector], Array]


@brief
@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """Positions and derivatives of joints at one time.

    Parameters
    ----------
    joints : tuple of str
    values : array_like, shape (4, joints)
        Position [rad or m], velocity, acceleration and jerk.

    Examples
    --------
    >>> MotionState.at_rest(("elbow",), [0.3]).values[:, 0].tolist()
    [0.3, 0.0, 0.0, 0.0]
    """

    joints: tuple[str, ...]
    values: Matrix

    def __post_init__(self) -> None:
        freeze(self, joints=tuple(self.joints))
        freeze_arrays(self, {"values": (4, len(self.joints))}, "state")

    @classmethod
    def at_rest(cls, joints: tuple[str, ...], position: ArrayLike) -> Self:
        """Return a pose, shape (joints,), [rad or m], that is not left.

        Parameters
        ----------
        joints : sequence of str
        position : array_like, shape (joints,), [rad or m]
        """
        pose = frozen(position, (len(joints),), "pose")
        return cls(joints, np.vstack([pose, np.zeros((3, len(pose)))]))

    @classmethod
    def of(cls, path: JointPath, time: float) -> Self:
        """Return the state that a path has at a time [s].

        Parameters
        ----------
        path : JointPath
        time : float, [s]
        """
        return cls(path.joints, path.evaluate([time], derivatives=3)[:, 0])


def transfer(
    begin: MotionState,
    end: MotionState,
    limits: MotionLimits,
    *,
    matched: int = MATCHED,
) -> PolynomialPath:
    """Return the shortest polynomial path from one state to another within limits.

    All joints take the same time.  Durations 3 % apart are tried from short to long,
    and the first that is proven to keep position, velocity, acceleration and jerk
    within their limits is refined to a millionth.  None is shorter than a thousandth of
    the time to cross a joint's range at its limits.

    Parameters
    ----------
    begin, end : MotionState
    limits : MotionLimits
        Limits of these joints; others are ignored.
    matched : int
        Number of derivatives, from the position, that are matched at both ends: 4 for a
        polynomial of degree 7 with continuous jerk.

    Raises
    ------
    ProblemError
        If a state is outside the limits, or no duration keeps them; with joint and
        limit.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh, motion_limits
    >>> from consistent_id.robot import JointLimits
    >>> arm = from_modified_dh("arm", [DHRow(0, 0, limits=JointLimits(-1, 2))])
    >>> limits = motion_limits(arm, velocity=1.875)
    >>> here, there = (MotionState.at_rest(arm.joint_names, [q]) for q in (0.0, 1.0))
    >>> round(transfer(here, there, limits).duration, 2)
    1.0
    """
    require_type(begin, MotionState, "begin")
    require_type(end, MotionState, "end")
    require_type(limits, MotionLimits, "limits")

    def family(duration: Vector) -> Array:
        return bernstein.hermite(begin.values[:matched], end.values[:matched], duration)

    return shortest(family, (begin, end), limits_of(limits, begin.joints))


def limits_of(limits: MotionLimits, joints: tuple[str, ...]) -> MotionLimits:
    """Return the limits of these joints, in this order."""
    for name in joints:
        if name not in limits.joints:
            near = did_you_mean(name, limits.joints)
            raise ProblemError(f"limits of joint {name!r} are missing; {near}")
    at: IntArray = np.array([limits.joints.index(name) for name in joints])
    names = [field.name for field in fields(limits) if field.name != "joints"]
    chosen = {name: getattr(limits, name)[at] for name in names}
    return replace(limits, joints=joints, **chosen)


def shortest(
    family: Family,
    states: tuple[MotionState, ...],
    limits: MotionLimits,
) -> PolynomialPath:
    """Return the shortest member of a family that is proven to be within limits.

    Parameters
    ----------
    family : function
        From durations to Bernstein coefficients.
    states : tuple of MotionState
        States at the ends of the family.
    """
    if any(state.joints != limits.joints for state in states):
        raise ProblemError("states are of different joints; expected the same")
    for state in states:
        _check_state(state, limits)
    allowed = allowed_by(states, limits)

    def excess(duration: Vector) -> Array:
        control = family(duration)
        return _reached(control, duration, limits) / allowed[:, None]

    tried = _durations(states, limits)
    over = excess(tried)
    good = np.flatnonzero((over <= 1.0).all(axis=(0, 2)))
    if not len(good):
        raise _impossible(tried, over, limits)
    long = float(tried[good[0]])
    short = float(tried[good[0] - 1]) if good[0] else long
    while long - short > _TOLERANCE * long:
        middle = (short + long) / 2.0
        if (excess(np.array([middle])) <= 1.0).all():
            long = middle
        else:
            short = middle
    return PolynomialPath(limits.joints, family(np.array([long]))[:, 0], long)


def _reached(control: Array, duration: Vector, limits: MotionLimits) -> Array:
    """Return bounds of position (from the middle of its range) and its derivatives.

    Shape (4, durations, joints).
    """
    centred = control - limits.middle
    return np.array(
        [
            abs(bernstein.finer(bernstein.derivative(centred, duration, k))).max(axis=0)
            for k in range(4)
        ]
    )


def allowed_by(states: tuple[MotionState, ...], limits: MotionLimits) -> Matrix:
    """Return the allowed values: the limits less rounding, and the states."""
    allowed = np.array([limits.derivative(k) for k in range(4)]) * (1.0 - _INSIDE)
    for state in states:
        own = abs(_centred(state, limits)) * (1.0 + _INSIDE)
        allowed[:MATCHED] = np.maximum(allowed[:MATCHED], own[:MATCHED])
    return allowed


def _centred(state: MotionState, limits: MotionLimits) -> Matrix:
    return np.vstack([state.values[:1] - limits.middle, state.values[1:]])


def _check_state(state: MotionState, limits: MotionLimits) -> None:
    most = np.array([limits.derivative(k) for k in range(4)])
    over = abs(_centred(state, limits)) > most * (1.0 + _INSIDE)
    # The jerk of a state belongs to its path, not to the transfer.
    if over[:MATCHED].any():
        k, j = (int(i) for i in np.argwhere(over[:MATCHED])[0])
        raise ProblemError(
            f"transfer: {_ORDERS[k]} of joint {limits.joints[j]!r} is "
            f"{state.values[k, j]:.6g}, expected {_range(limits, k, j)}; choose "
            "another pose or trajectory, or correct the limit"
        )


def _durations(states: tuple[MotionState, ...], limits: MotionLimits) -> Vector:
    """Return the durations to try [s], around what states and limits suggest."""
    apart = np.max([abs(state.values) for state in states], axis=0)
    apart[0] = abs(states[-1].values[0] - states[0].values[0])
    most = [limits.derivative(k) for k in range(4)]
    needed = [
        (apart[low] / most[high]) ** (1.0 / (high - low))
        for low in range(3)
        for high in range(low + 1, 4)
    ]
    crossing = [(2.0 * most[0] / most[k]) ** (1.0 / k) for k in range(1, 4)]
    shortest = _SHORTEST * float(np.max(crossing))
    suggested = max(shortest, float(np.max(needed)))
    low, high = max(shortest, _REACH[0] * suggested), _REACH[1] * suggested
    return np.exp(np.arange(np.log(low), np.log(high), np.log(_RATIO)))


def _range(limits: MotionLimits, k: int, j: int) -> str:
    if k == 0:
        return f"between {limits.lower[j]:.6g} and {limits.upper[j]:.6g}"
    return f"at most {limits.derivative(k)[j]:.6g}"


def _impossible(tried: Vector, over: Array, limits: MotionLimits) -> ProblemError:
    """Return the error that names the limit nearest to being kept."""
    t = int(np.argmin(over.max(axis=(0, 2))))
    k, j = np.unravel_index(int(np.argmax(over[:, t])), over[:, t].shape)
    limit = _range(limits, int(k), int(j))
    return ProblemError(
        f"transfer: no duration from {tried[0]:.2g} to {tried[-1]:.2g} s is within all "
        f"limits; at best, in {tried[t]:.4g} s, {_ORDERS[k]} of joint "
        f"{limits.joints[j]!r} is {over[k, t, j]:.4g} times its limit ({limit}). "
        "Leave more margin between trajectory and limits, or begin and end it at rest, "
        "or where it moves more slowly"
    )
