"""Proofs of the torque along a path: its size, its rate, and its root mean square.

The smooth part is bounded as a path is, by Taylor's theorem: torque and its rate at the
middle of a stretch of time, and a bound of its second derivative.  That bound comes
from one pass of the recursion on intervals over stretches that are not divided further;
where time is divided, the torque is computed only at instants.

The bound of the rate is that of the smooth part: Coulomb friction jumps where a joint
reverses, so its rate has no bound.  The root mean square determines the heat of a
motor.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector, checked
from consistent_id.errors import ProblemError
from consistent_id.motion.proofs.extremes import (
    Enclosed,
    Enclosure,
    Peaks,
    bounds_of,
    peaks,
    smooth_pieces,
)
from consistent_id.motion.proofs.friction_bounds import (
    DirectedFriction,
    directed_friction,
)
from consistent_id.motion.proofs.interval import Interval
from consistent_id.motion.proofs.torque_motion import SmoothTorque, smooth_torque
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.regressor import TorqueModel

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
