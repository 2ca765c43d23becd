"""A motion that a robot can play: from rest, through a trajectory, to rest.

Run-in and run-out lead from rest, in a suitable pose, to a state of motion, or back.
For a given duration, the coefficients of their polynomial are linear in the pose at
rest; so each limit gives an interval of poses, without a search.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, BoolArray, Vector, checked, freeze
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.motion import bernstein
from consistent_id.motion.bernstein import PolynomialPath
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.transfers import (
    MATCHED,
    MotionState,
    allowed_by,
    limits_of,
    shortest,
    transfer,
)
from consistent_id.recordings.joint_paths import FourierTrajectory, sampled
from consistent_id.recordings.recording import Recording
from consistent_id.robot.parameters import did_you_mean

_ORDERS = ("position", "velocity", "acceleration")
_SAME_TIME = 1e-9  # share of the duration by which two times may differ
_SAME_STATE = 1e-9  # jump of any joint, or of its derivatives, that is rounding
_JUMP = 1e-6  # share of its bound by which a derivative may jump
_SAME = 1e-9  # difference, relative to the trajectory's bound, that counts as rounding

# Factors on the trajectory's own bounds, where no limit is given
_FACTORS = (1.0, 2.0, 8.0)

_ROUNDING = 1e-10  # reserve, as a share of a limit, when a pose is chosen

Pose = ArrayLike | Mapping[str, float]


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """A run-in from rest, a trajectory, a run-out to rest; a joint path itself.

    Position, velocity and acceleration are continuous; the jerk and higher derivatives
    may jump between pieces, so their bounds are valid piece by piece.

    Parameters
    ----------
    run_in : tuple of PolynomialPath
        None, if the trajectory begins at rest in the required pose.
    trajectory : FourierTrajectory
        The part that excites.
    run_out : tuple of PolynomialPath

    Raises
    ------
    ProblemError
        If pieces do not follow each other, or the motion does not begin or end at rest.

    Examples
    --------
    >>> there_and_back = [[0.4], [-0.1]]  # 0.4 cos wt - 0.1 cos 2wt: rests at 0
    >>> swing = FourierTrajectory(
    ...     ("elbow",), [0.5, 1.0], [0.0], [[0.0], [0.0]], there_and_back, duration=2.0
    ... )
    >>> move = Move((), swing, ())
    >>> move.evaluate([0.0, 1.0], derivatives=0)[0, :, 0].round(9).tolist()
    [0.3, -0.5]
    >>> move.excites([0.0, 1.0, 2.0, 2.1]).tolist()
    [True, True, True, False]
    """

    run_in: tuple[PolynomialPath, ...]
    trajectory: FourierTrajectory
    run_out: tuple[PolynomialPath, ...]

    def __post_init__(self) -> None:
        freeze(self, run_in=tuple(self.run_in), run_out=tuple(self.run_out))
        for number, piece in enumerate(self.pieces, 1):
            if piece.joints != self.joints:
                raise ProblemError(
                    f"move: piece {number} moves joints {piece.joints}, the trajectory "
                    f"{self.joints}; expected the same, in the same order"
                )
        still = np.zeros_like(self._state(0, at_end=False))
        self._check(still, self._state(0, at_end=False), "start", orders=(1, 2))
        for number in range(len(self.pieces) - 1):
            self._check_junction(number)
        self._check(self._state(-1, at_end=True), still, "end", orders=(1, 2))

    def _state(self, number: int, *, at_end: bool) -> Array:
        piece = self.pieces[number]
        return piece.evaluate([end_of(piece) if at_end else piece.start])[:, 0]

    def _check_junction(self, number: int) -> None:
        before, after = self.pieces[number], self.pieces[number + 1]
        slack = _SAME_TIME * (abs(end_of(before)) + self.duration)
        if abs(after.start - end_of(before)) > slack:
            raise ProblemError(
                f"move: piece {number + 1} ends at {end_of(before):.9g} s, the next "
                f"begins at {after.start:.9g} s; expected the same time"
            )
        where = f"junction at {after.start:.6g} s"
        first = self._state(number, at_end=True)
        second = self._state(number + 1, at_end=False)
        self._check(first, second, where, orders=(0, 1, 2))

    def _check(
        self, before: Array, after: Array, where: str, orders: tuple[int, ...]
    ) -> None:
        for k in orders:
            allowed = _JUMP * self.derivative_bound(k) + _SAME_STATE
            off = abs(after[k] - before[k])
            if (off > allowed).any():
                j = int(np.argmax(off / allowed))
                raise ProblemError(
                    f"move: {_ORDERS[k]} of joint {self.joints[j]!r} jumps from "
                    f"{before[k, j]:.6g} to {after[k, j]:.6g} at its {where}; expected "
                    "continuous motion from rest to rest. Call move_along"
                )

    @property
    def pieces(self) -> tuple[PolynomialPath | FourierTrajectory, ...]:
        """Run-in, trajectory and run-out, in the order of time."""
        return (*self.run_in, self.trajectory, *self.run_out)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.trajectory.joints

    @property
    def start(self) -> float:
        """Start time [s]."""
        return self.pieces[0].start

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return end_of(self.pieces[-1]) - self.start

    @property
    def window(self) -> tuple[float, float]:
        """Begin and end of the exciting part [s]; see `trimmed`."""
        return self.trajectory.start, end_of(self.trajectory)

    def excites(self, time: ArrayLike) -> BoolArray:
        """Return which samples belong to the exciting part, shape (samples,)."""
        t, (begin, end) = checked(time, (None,), "time"), self.window
        return np.asarray((t >= begin) & (t <= end))

    def evaluate(self, time: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and derivatives, shape (derivatives + 1, samples, joints).

        At a junction, those of the later piece.  Before the start and after the end the
        robot rests.

        Parameters
        ----------
        time : array_like, shape (samples,), [s]
        derivatives : int
            Highest one.
        """
        given = checked(time, (None,), "time")
        t = np.clip(given, self.start, end_of(self.pieces[-1]))
        begins = np.array([piece.start for piece in self.pieces[1:]])
        numbers = np.searchsorted(begins, t, side="right")
        values = np.empty((derivatives + 1, len(t), len(self.joints)))
        for number, piece in enumerate(self.pieces):
            mine = numbers == number
            values[:, mine] = piece.evaluate(t[mine], derivatives)
        values[1:, t != given] = 0.0
        return values

    def derivative_bound(self, order: int) -> Vector:
        """Return a bound of each joint's derivative over all pieces."""
        bounds = [piece.derivative_bound(order) for piece in self.pieces]
        return np.asarray(np.max(bounds, axis=0))

    def recording(self, rate: float, name: str = "move") -> Recording:
        """Sample position, velocity and acceleration; see `paths.sampled`.

        Parameters
        ----------
        rate : float, [Hz]
        name : str
        """
        return sampled(self, rate, name)


def end_of(piece: PolynomialPath | FourierTrajectory) -> float:
    """Return the end time of a piece [s]."""
    return piece.start + piece.duration


def move_along(
    trajectory: FourierTrajectory,
    limits: MotionLimits,
    *,
    from_pose: Pose | None = None,
    to_pose: Pose | None = None,
    from_via: ArrayLike | None = None,
    to_via: ArrayLike | None = None,
    periods: int | None = None,
    smooth: bool = False,
) -> Move:
    """Return a move from rest to rest through a trajectory.

    A run-in is one polynomial, if that stays within the limits; else a point-to-point
    polynomial and a swing from a nearby pose.  If acceleration or jerk has no limit,
    the trajectory's own bound is used for run-in and run-out, or a multiple of it if
    necessary.  The trajectory itself, torques and collisions are not checked.

    Parameters
    ----------
    trajectory : FourierTrajectory
        Periodic, or at rest at its ends.
    limits : MotionLimits
    from_pose, to_pose : array_like, shape (joints,), or mapping by joint, optional
        Poses in which the robot rests before and after [rad or m]; by default the
        nearest poses for a swing.
    from_via, to_via : array_like, shape (poses, joints), optional
        Intermediate poses after `from_pose` and before `to_pose`, in order.
    periods : int, optional
        Number of repetitions of the trajectory; by default from its duration.
    smooth : bool
        Whether moves between poses at rest begin and end without jerk; a swing from a
        nearby pose into a motion does not.

    Raises
    ------
    ProblemError
        If a pose or a state is outside the limits, or no move keeps them.

    Examples
    --------
    >>> swing = FourierTrajectory(("joint1",), [0.5], [0.0], [[0.0]], [[0.1]], 4.0)
    >>> from consistent_id import DHRow, from_modified_dh, motion_limits
    >>> from consistent_id.robot import JointLimits
    >>> arm = from_modified_dh("arm", [DHRow(0, 0, limits=JointLimits(-1, 2))])
    >>> limits = motion_limits(arm, velocity=1.0)
    >>> move = move_along(swing, limits, from_pose=[0.5], to_pose=[0.5])
    >>> [len(move.run_in), len(move.run_out)]
    [1, 1]
    >>> move.evaluate([0.0, move.duration])[:2, :, 0].round(9).tolist()
    [[0.5, 0.5], [0.0, 0.0]]
    """
    require_type(trajectory, FourierTrajectory, "trajectory")
    require_type(limits, MotionLimits, "limits")
    limits = limits_of(limits, trajectory.joints)
    if periods is not None:
        trajectory = _repeated(trajectory, periods)
    first = _pose(from_pose, trajectory.joints, "from_pose")
    last = _pose(to_pose, trajectory.joints, "to_pose")
    stops = [_stops(via, trajectory.joints) for via in (from_via, to_via)]
    if (first is None and stops[0]) or (last is None and stops[1]):
        raise ProblemError("via poses lead from or to a pose; give from_pose, to_pose")
    ends = [first, *stops[0]], [*stops[1], last]
    matched = MATCHED + smooth
    unlimited = np.isinf([limits.acceleration, limits.jerk]).any()
    *tight, widest = _FACTORS if unlimited else _FACTORS[:1]
    for factor in tight:
        own = _with_own_bounds(limits, trajectory, factor)
        try:
            return _moved(trajectory, own, *ends, matched)
        except ProblemError:
            continue  # perhaps no limit of the user is violated
    own = _with_own_bounds(limits, trajectory, widest)
    return _moved(trajectory, own, *ends, matched)


def _moved(
    trajectory: FourierTrajectory,
    limits: MotionLimits,
    before: list[MotionState | None],
    after: list[MotionState | None],
    matched: int,
) -> Move:
    """Return the move between poses, or from and to the nearest ones."""
    begin = MotionState.of(trajectory, trajectory.start)
    end = MotionState.of(trajectory, end_of(trajectory))
    run_in, run_out = (_between(ends, limits, matched) for ends in (before, after))
    first, last = before[-1], after[0]
    if not _resting(begin, trajectory, first):
        run_in += (
            (approach(begin, limits),)
            if first is None
            else _way(first, begin, limits, matched)
        )
    if not _resting(end, trajectory, last):
        run_out = (
            (departure(end, limits),)
            if last is None
            else _way(end, last, limits, matched)
        ) + run_out
    return _in_sequence(run_in, trajectory, run_out)


def _between(
    poses: list[MotionState | None], limits: MotionLimits, matched: int
) -> tuple[PolynomialPath, ...]:
    """Return the moves between poses at rest, one after another."""
    return tuple(
        transfer(one, other, limits, matched=matched)
        for one, other in pairwise(poses)
        if one is not None and other is not None
    )


def _way(
    begin: MotionState, end: MotionState, limits: MotionLimits, matched: int
) -> tuple[PolynomialPath, ...]:
    """Return one piece, or, if none keeps the limits, two that meet at rest."""
    try:
        return (transfer(begin, end, limits, matched=matched),)
    except ProblemError:
        if not (begin.values[1:].any() or end.values[1:].any()):
            raise
    if end.values[1:].any():
        near = begin.values[0]
        swing = approach(end, limits, near=near)
        meet = MotionState.at_rest(end.joints, swing.control[0])
        return transfer(begin, meet, limits, matched=matched), swing
    near = end.values[0]
    swing = departure(begin, limits, near=near)
    meet = MotionState.at_rest(end.joints, swing.control[-1])
    return swing, transfer(meet, end, limits, matched=matched)


def _resting(
    state: MotionState, trajectory: FourierTrajectory, pose: MotionState | None
) -> bool:
    """Return whether a state of the trajectory is at rest, and in the pose if given."""
    wanted = np.zeros((3, len(state.joints)))
    wanted[0] = (state if pose is None else pose).values[0]
    bounds = [trajectory.derivative_bound(k) for k in range(3)]
    small = _SAME * np.array(bounds) + np.finfo(float).tiny
    return bool((abs(state.values[:3] - wanted) <= small).all())


def _stops(via: ArrayLike | None, joints: tuple[str, ...]) -> list[MotionState]:
    if via is None:
        return []
    poses = checked(via, (None, len(joints)), "via poses")
    return [MotionState.at_rest(joints, pose) for pose in poses]


def _pose(pose: Pose | None, joints: tuple[str, ...], name: str) -> MotionState | None:
    if pose is None:
        return None
    if not isinstance(pose, Mapping):
        return MotionState.at_rest(joints, checked(pose, (len(joints),), name))
    for joint in (*pose, *joints):
        if joint not in pose or joint not in joints:
            near = did_you_mean(joint, joints)
            what = "does not name" if joint not in pose else "names"
            raise ProblemError(f"{name} {what} joint {joint!r}; {near}")
    return MotionState.at_rest(joints, [pose[joint] for joint in joints])


def _repeated(trajectory: FourierTrajectory, periods: int) -> FourierTrajectory:
    if trajectory.period is None or periods < 1:
        raise ProblemError(
            f"{periods} periods of a trajectory whose period is {trajectory.period} s; "
            "expected at least one, and frequencies that share a base"
        )
    return replace(trajectory, duration=periods * trajectory.period)


def _with_own_bounds(
    limits: MotionLimits, trajectory: FourierTrajectory, factor: float
) -> MotionLimits:
    """Return limits; missing ones are the trajectory's own bounds, times `factor`."""

    def bound(order: int) -> Vector:
        own = factor * trajectory.derivative_bound(order)
        given = limits.derivative(order)
        return np.where(np.isinf(given) & (own > 0.0), own, given)

    return replace(limits, acceleration=bound(2), jerk=bound(3))


def _in_sequence(
    run_in: tuple[PolynomialPath, ...],
    trajectory: FourierTrajectory,
    run_out: tuple[PolynomialPath, ...],
) -> Move:
    """Return the move whose pieces follow each other from time 0."""
    before, time = [], 0.0
    for piece in run_in:
        before.append(replace(piece, start=time))
        time = end_of(before[-1])
    middle = replace(trajectory, start=time)
    after, time = [], end_of(middle)
    for piece in run_out:
        after.append(replace(piece, start=time))
        time = end_of(after[-1])
    return Move(tuple(before), middle, tuple(after))


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
        Among the possible poses at rest, the nearest to this one is chosen; by default
        the middle one.

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

    It is the time reversal of the `approach` of the same state.
    """
    mirror = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    mirrored = replace(begin, values=mirror * begin.values)
    path = approach(mirrored, limits, near=near)
    return replace(path, control=path.control[::-1])


def _poses(
    control: Array, duration: Vector, limits: MotionLimits, allowed: Array
) -> Array:
    """Return the least and the greatest pose within limits, (2, durations, joints).

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
        # |a + b pose| <= allowed; where b is 0, the pose has no effect.
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (-allowed[k] - a) / b, (allowed[k] - a) / b
        counts = b != 0.0
        least = np.where(counts, np.minimum(one, other), -np.inf)
        most = np.where(counts, np.maximum(one, other), np.inf)
        low, high = np.fmax(low, least.max(axis=0)), np.fmin(high, most.min(axis=0))
    return np.array([low, high])
