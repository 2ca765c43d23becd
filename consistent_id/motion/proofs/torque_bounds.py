"""Proofs of the torque along a path: its size, its rate, and its root mean square.

The smooth part is bounded as a path is, by Taylor's theorem: torque and its rate at the
middle of a stretch of time, and a bound of its second derivative.  That bound comes
from one pass of the recursion on intervals over stretches that are not divided further;
where time is divided, the torque is computed only at instants.

The bound of the rate is that of the smooth part: Coulomb friction jumps where a joint
reverses, so its rate has no bound.  The root mean square determines the heat of a
motor.

Friction that is not polynomial in the motion is bounded over stretches of time.  It
may jump, or nearly, where a joint turns back, so its derivative is not used. Its
columns are computed with intervals instead of numbers, separately for motion forwards,
backwards and at rest, so that columns of one sign keep it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector, checked
from consistent_id.errors import ProblemError
from consistent_id.motion.proofs.extremes import (
    Enclosed,
    Enclosure,
    Interval,
    Peaks,
    bounds_of,
    path_interval,
    peaks,
    smooth_pieces,
)
from consistent_id.motion.proofs.torque_motion import SmoothTorque, smooth_torque
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.drive.term import JointSamples, term_columns
from consistent_id.regression.regressor import TorqueModel

_ROUNDING = 64.0 * np.finfo(float).eps  # relative rounding of motion and columns
_LEAST = float(np.finfo(float).tiny)  # least rate with a direction


@dataclass(frozen=True, slots=True, eq=False)
class DirectedFriction:
    """The columns of a model that are no polynomials, and their coefficients.

    Parameters
    ----------
    own : TorqueModel
        The same model without couplings: each joint's friction depends on its own rate.
    parameters : ndarray, shape (robots, parameters)
    """

    model: TorqueModel
    own: TorqueModel
    parameters: Matrix

    @property
    def needed(self) -> bool:
        """Whether any robot has such friction."""
        start = self.model.layout.inertial_size
        terms = self.model.column_terms
        return any(
            not term.polynomial and self.parameters[:, column].any()
            for column, term in enumerate(terms, start)
        )

    def enclosed(
        self, path: JointPath, middle: Vector, radius: float, load: Interval
    ) -> Interval:
        """Enclose the friction over stretches of time, rounding included.

        Parameters
        ----------
        middle : ndarray, shape (stretches,), [s]
        radius : float, [s]
            May be zero; then a joint at rest has friction of both signs.
        load : Interval, shape (stretches, joints), [N m or N]
            Torque that the joints transmit.

        Returns
        -------
        Interval, shape (stretches, robots, joints), [N m or N]
        """
        q, dq, ddq = (
            [_widened(x, x.size) for x in order.columns()]
            for order in path_interval(path, middle, radius, 2)
        )
        loads = load.columns()
        # exactly at rest, a joint may begin to move either way
        dq = [Interval(x.low - 2.0 * _LEAST, x.high + 2.0 * _LEAST) for x in dq]
        parts = [
            self._sum(self.own, [q, rates, ddq], loads, 0)
            for rates in zip(*(_directions(rate) for rate in dq), strict=True)
        ]
        both = self._sum(self.model, [q, dq, ddq], loads, len(self.own.layout))
        shape = (len(self.parameters), len(middle))
        ends = []
        for j, shared in enumerate(both):
            first, *others = (_interval(part[j], shape) for part in parts)
            for other in others:
                first = first.union(other)
            ends.append(first + _interval(shared, shape))
        low = np.stack([x.low.T for x in ends], axis=-1)
        return Interval(low, np.stack([x.high.T for x in ends], axis=-1))

    def _sum(
        self, model: TorqueModel, motion: Sequence[Any], loads: list[Any], start: int
    ) -> list[Any]:
        """Add up the columns from `start` on, joint by joint."""
        total: list[Any] = [0.0] * len(model.robot)
        terms, skip = self.model.column_terms, self.model.layout.inertial_size
        needed = {
            j: loads[j] for j, joint in enumerate(model.terms) if joint.needs_load
        }
        q, dq, ddq = motion
        for j, column, values in model.drive_entries(q, dq, ddq, needed):
            if column >= start and not terms[column - skip].polynomial:
                values = _interval(values)
                values = _widened(values, 1.0 + values.size)
                total[j] = values * self.parameters[:, column, None] + total[j]
        return total


def directed_friction(model: TorqueModel, parameters: Matrix) -> DirectedFriction:
    """Return the friction terms of a model that are not polynomial in the motion."""
    return DirectedFriction(model, replace(model, couplings=()), parameters)


def require_enclosable(model: TorqueModel) -> None:
    """Refuse terms that cannot be computed for intervals, before any work is done.

    Raises
    ------
    ProblemError
        The message names the term and the reason.
    """
    stretch = Interval(np.array([-0.5]), np.array([0.5]))
    for term in model.column_terms:
        term_columns(term, JointSamples(stretch, stretch, stretch, stretch))


def _directions(rate: Interval) -> list[Interval]:
    """Return the rates forwards, backwards and at rest; all rates if there are none.

    Zero is rounded up to the least number with a direction, which changes a continuous
    term by a negligible amount.
    """
    forwards = Interval(np.maximum(rate.low, _LEAST), rate.high)
    backwards = Interval(rate.low, np.minimum(rate.high, -_LEAST))
    at_rest = Interval(np.zeros_like(rate.low), np.zeros_like(rate.low))
    there = (rate.high >= _LEAST, rate.low <= -_LEAST, abs(rate).low == 0.0)
    return [
        Interval(np.where(x, r.low, rate.low), np.where(x, r.high, rate.high))
        for x, r in zip(there, (forwards, backwards, at_rest), strict=True)
    ]


def _widened(x: Interval, size: Array) -> Interval:
    """Return an interval widened by the rounding of numbers of some size."""
    return Interval(x.low - _ROUNDING * size, x.high + _ROUNDING * size)


def _interval(x: Any, shape: tuple[int, ...] = ()) -> Interval:
    low, high = (x.low, x.high) if isinstance(x, Interval) else (x, x)
    shape = np.broadcast_shapes(np.shape(low), shape)
    return Interval(np.broadcast_to(low, shape), np.broadcast_to(high, shape))


_TURN = 0.025  # largest motion of a joint in half a stretch at the beginning [rad or m]
_FEWEST, _MOST_CELLS = 32, 4096
_ROUNDED_UP = 1.0 + 1e-9  # rounding of a bound, for sums of far fewer terms

# Largest difference of proven and reached rates, as a share of a limit
_TOLERANCE = 0.01
_DENSITY = 400.0  # stretches per second, in which the largest torque is used


@dataclass(frozen=True, slots=True, eq=False)
class TorqueBounds:
    """Proven bounds of the torque along a path; arrays of shape (joints,), [N m or N].

    Parameters
    ----------
    joints : tuple of str
        Joints with a torque in the model.
    lowest, highest : ndarray
        Proven: never below, never above, for any of the robots.
    least, most : ndarray
        Values that are reached, at `least_time` and `most_time` [s].
    """

    joints: tuple[str, ...]
    lowest: Vector
    highest: Vector
    least: Vector
    most: Vector
    least_time: Vector
    most_time: Vector

    @property
    def size(self) -> Vector:
        """Proven bound of the absolute value."""
        return np.maximum(-self.lowest, self.highest)


@dataclass(frozen=True, slots=True, eq=False)
class PathTorque:
    """Smooth torque and friction of several robots along a path."""

    path: JointPath
    smooth: SmoothTorque
    friction: DirectedFriction
    rows: list[int]

    def reach(self, samples: int) -> Vector:
        """Return the largest torques at some instants."""
        time = self.path.start + self.path.duration * np.linspace(0.0, 1.0, samples)
        value = self.smooth.derivatives(self.path, time)[0]
        over = self._with_friction(time, 0.0, Interval(value, value))
        return np.asarray(over.size.max(axis=(0, 1)))

    def enclosure(self, cells: int) -> Enclosure:
        """Return the function that encloses the torques, both ways."""
        path = self.path
        radius, middles = _halves(path, cells)
        wider = _ROUNDED_UP * radius
        curvature = _ROUNDED_UP * self.smooth.curvature(path, middles, wider)
        slack = self.smooth.rounding(path)

        def enclose(middle: Vector, radius: float, cell: IntArray) -> Enclosed:
            value, rate = self.smooth.derivatives(path, middle)
            away = abs(rate) * radius + curvature[cell] * radius**2 / 2.0 + slack
            at = self._with_friction(middle, 0.0, Interval(value, value))
            over = Interval(value - away, value + away)
            return Enclosed(
                _both_ways(at), _both_ways(self._with_friction(middle, radius, over))
            )

        return enclose

    def rate_enclosure(self, cells: int) -> Enclosure:
        """Return the function that encloses the rates of the smooth part, both ways."""
        path, robots = self.path, len(self.friction.parameters)
        radius, middles = _halves(path, cells)
        curvature = self.smooth.curvature(path, middles, _ROUNDED_UP * radius)

        def enclose(middle: Vector, radius: float, cell: IntArray) -> Enclosed:
            rate = self.smooth.derivatives(path, middle)[1]
            away = _ROUNDED_UP * (curvature[cell] * radius)
            low, high = (
                (rate + sign * away)[:, :robots, self.rows] for sign in (-1.0, 1.0)
            )
            now = rate[:, :robots, self.rows]
            at, over = Interval(now, now), Interval(low, high)
            return Enclosed(_both_ways(at), _both_ways(over))

        return enclose

    def mean_square(self, cells: int) -> Vector:
        """Bound the mean square of the torque of any robot, shape (torque joints,)."""
        path, every = self.path, np.arange(cells)
        radius, middle = _halves(path, cells)
        above = self.enclosure(cells)(middle, _ROUNDED_UP * radius, every).above
        size = np.maximum(*np.split(above, 2, axis=1))
        return np.asarray(_ROUNDED_UP * (size**2).mean(axis=0))

    def _with_friction(
        self, middle: Vector, radius: float, torque: Interval
    ) -> Interval:
        """Add friction; shape (stretches, robots, torque joints)."""
        robots, friction = len(self.friction.parameters), self.friction
        total = Interval(torque.low[:, :robots], torque.high[:, :robots])
        if friction.needed:
            load = Interval(torque.low[:, -1], torque.high[:, -1])
            total = total + friction.enclosed(self.path, middle, radius, load)
        return Interval(total.low[:, :, self.rows], total.high[:, :, self.rows])


def torque_bounds(
    path: JointPath,
    model: TorqueModel,
    parameters: ArrayLike,
    *,
    effort: ArrayLike | None = None,
    tolerance: float = 1e-3,
) -> TorqueBounds:
    """Enclose the torques along a path, over its whole duration.

    Parameters
    ----------
    path : JointPath
        With four continuous derivatives, which is not checked, or with such `pieces`,
        as in a `Move`; and with all joints of the model's robot in order.
    parameters : array_like, shape (parameters,) or (robots, parameters)
        Those of one robot, or of several: the torque is linear in them, so a bound for
        all is valid for every mixture of them.
    effort : array_like, shape (torque joints,), optional, [N m or N]
        Reference of the tolerance; by default, the largest torque.
    tolerance : float
        Largest difference of bound and reached value.

    Notes
    -----
    At standstill, dry friction has any value between its levels; both levels are used
    for a joint at rest.

    Raises
    ------
    ProblemError
        If path and model have other joints, or a shape is wrong; or if a drive term
        cannot be computed for intervals, so nothing can be proven.
    """
    x = _robots(parameters, model)
    if path.joints != model.robot.joint_names:
        raise ProblemError(
            f"the path moves {', '.join(path.joints)}; the robot's joints are "
            f"{', '.join(model.robot.joint_names)}; expected the same, in order"
        )
    if not 0.0 < tolerance < 1.0:
        raise ProblemError(f"tolerance is {tolerance}, expected between 0 and 1")
    wanted = None
    if effort is not None:
        shape = (len(model.torque_joints),)
        wanted = checked(effort, shape, "effort", finite=False)
    found = [
        _of_piece(torque, wanted, tolerance) for torque in path_torques(path, model, x)
    ]
    return TorqueBounds(model.torque_joints, *bounds_of(found))


def torque_rate_bounds(
    path: JointPath, model: TorqueModel, parameters: Matrix, limit: Vector
) -> TorqueBounds:
    """Enclose the rates at which the smooth part of each torque changes, [N m/s].

    Parameters
    ----------
    parameters : ndarray, shape (robots, parameters)
    limit : ndarray, shape (torque joints,), [N m/s or N/s]
        Reference of the tolerance, where it is finite.
    """
    found = []
    for torque in path_torques(path, model, parameters):
        piece, cells = torque.path, first_cells(torque.path)
        within = np.tile(_TOLERANCE * limit, 2)
        found.append(
            peaks(
                torque.rate_enclosure(cells),
                piece.start,
                piece.duration,
                cells,
                within,
            )
        )
    return TorqueBounds(model.torque_joints, *bounds_of(found))


def torque_rms_bound(path: JointPath, model: TorqueModel, parameters: Matrix) -> Vector:
    """Bound each torque's root mean square over a path, friction included.

    In each of 400 stretches per second, the largest torque of any robot is used.

    Returns
    -------
    ndarray, shape (torque joints,), [N m or N]
    """
    total, duration = np.zeros(len(model.torque_joints)), 0.0
    for torque in path_torques(path, model, parameters):
        length = torque.path.duration
        cells = max(first_cells(torque.path), int(np.ceil(_DENSITY * length)))
        total += length * torque.mean_square(cells)
        duration += length
    return np.asarray(np.sqrt(total / duration))


def path_torques(
    path: JointPath, model: TorqueModel, parameters: Matrix
) -> "list[PathTorque]":
    """Return the torques along each smooth piece of a path."""
    names = model.robot.joint_names
    smooth = smooth_torque(model, parameters)
    friction = directed_friction(model, parameters)
    rows = [names.index(name) for name in model.torque_joints]
    return [PathTorque(piece, smooth, friction, rows) for piece in smooth_pieces(path)]


def _of_piece(torque: "PathTorque", effort: Vector | None, tolerance: float) -> Peaks:
    path = torque.path
    cells = first_cells(path)
    scale = torque.reach(cells)
    if effort is not None:
        scale = np.where(np.isfinite(effort), effort, scale)
    return peaks(
        torque.enclosure(cells),
        path.start,
        path.duration,
        cells,
        np.tile(tolerance * scale, 2),
    )


def _both_ways(torque: Interval) -> Array:
    """Return the largest torques of any robot, and the least with reversed sign."""
    return np.hstack([torque.high.max(axis=1), -torque.low.min(axis=1)])


def _halves(path: JointPath, cells: int) -> tuple[float, Vector]:
    """Return half the length of equal stretches of a path's time, and their middles."""
    half = path.duration / (2 * cells)
    return half, path.start + half * np.arange(1, 2 * cells, 2, dtype=float)


def _robots(parameters: ArrayLike, model: TorqueModel) -> Matrix:
    x = np.asarray(parameters, dtype=float)
    return checked(
        x[None] if x.ndim == 1 else x, (None, len(model.layout)), "parameters"
    )


def first_cells(path: JointPath) -> int:
    """Return the number of stretches at the beginning."""
    fastest = path.derivative_bound(1).max()
    cells = np.ceil(path.duration * fastest / (2.0 * _TURN))
    return int(np.clip(cells, _FEWEST, _MOST_CELLS))
