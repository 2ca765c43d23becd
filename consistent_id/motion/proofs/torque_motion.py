"""Torque along a path and its derivatives in time, at instants and over stretches.

What is smooth: rigid bodies, and drive terms that are polynomials of the motion.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.motion.proofs.extremes import path_interval
from consistent_id.motion.proofs.interval import Interval
from consistent_id.motion.proofs.jets import Jet, jet, sine_and_cosine
from consistent_id.recordings.paths import JointPath
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive_entries import drive_entries
from consistent_id.regression.joint_geometry import (
    floats,
    joint_geometry,
    joint_motions,
)
from consistent_id.regression.newton_euler import JointMotion, torque_parts
from consistent_id.regression.regressor import TorqueModel

_PIECE = 20_000  # samples times robots at once
_DEPTH = 100.0  # roundings that one link adds, one after another, at most


@dataclass(frozen=True, slots=True, eq=False)
class SmoothTorque:
    """The part of a model's torque that is smooth in time, for several robots at once.

    Parameters
    ----------
    model : TorqueModel
        Of polynomial drive terms alone.
    parameters : ndarray, shape (robots, parameters)
        Of that model.
    """

    model: TorqueModel
    parameters: Matrix

    def derivatives(self, path: JointPath, time: Vector) -> Array:
        """Return torque and its rate, shape (2, samples, robots, joints)."""
        pieces = []
        for part in self._parts(time):
            values = path.evaluate(part, 3).transpose(0, 2, 1)
            torques = self._jets(self._motion(values, 1))
            shape = (len(self.parameters), len(part))
            pieces.append(np.stack([_stacked(torques, k, shape) for k in range(2)]))
        return np.concatenate(pieces, axis=1)

    def curvature(self, path: JointPath, middle: Vector, radius: float) -> Array:
        """Bound the torque's second derivative, shape (stretches, robots, joints)."""
        pieces = []
        for part in self._parts(middle):
            values = [x.columns() for x in path_interval(path, part, radius, 4)]
            torques = self._jets(self._motion(values, 2))
            shape = (len(self.parameters), len(part))
            pieces.append(2.0 * _stacked(torques, 2, shape))
        return np.concatenate(pieces)

    def rounding(self, path: JointPath) -> Matrix:
        """Bound what rounding does to `derivatives`, shape (robots, joints).

        With every number replaced by plus or minus its size, the recursion yields the
        size of all that is added up; its rate, what a rounded time or phase can do.
        """
        sizes = [path.derivative_bound(order) for order in range(4)]
        values = [[_within(np.atleast_1d(s)) for s in size] for size in sizes]
        motion = [
            moves._replace(sin=turned, cos=turned)
            for moves in self._motion(values, 1)
            for turned in [_turned(moves.q)]
        ]
        torques = self._jets(motion)
        shape = (len(self.parameters), 1)
        size, rate = (_stacked(torques, k, shape)[0] for k in range(2))
        unit = float(np.finfo(float).eps)
        latest = abs(path.start) + path.duration
        depth = _DEPTH * (len(self.model.robot) + 1)
        slack = depth * (size + path.duration * rate) + 64.0 * latest * rate
        return np.asarray(unit * slack)

    def _motion(self, derivatives: Any, order: int) -> list[JointMotion]:
        """Return the joints' motion as jets, from derivatives[order][coordinate]."""
        orders = range(order + 1)
        states = [
            [
                jet([derivatives[n + k][j] for k in orders])
                for j in range(len(self.model.robot))
            ]
            for n in range(3)
        ]
        return joint_motions(self.model.robot, states, sine_and_cosine)

    def _parts(self, time: Vector) -> list[Vector]:
        """Return times piece by piece, so that arrays stay of moderate size."""
        return np.array_split(time, 1 + len(time) * len(self.parameters) // _PIECE)

    def _jets(self, motion: list[JointMotion]) -> list[Any]:
        """Return each joint's torque as a jet, or a number where nothing moves it."""
        model, x = self.model, self.parameters
        geometry, gravity = joint_geometry(model.robot), floats(model.robot.gravity)
        total: list[Any] = [0.0] * len(model.robot)
        links = range(len(model.robot.links))
        bodies = [_body(x, model.layout.link_slice(k)) for k in links]
        for j, _, part in torque_parts(geometry, gravity, motion, bodies):
            total[j] = part + total[j]
        own = [
            moves
            for moves, joint in zip(motion, model.robot.joints, strict=True)
            if joint.mimic is None
        ]
        q, dq, ddq = ([m[i] for m in own] for i in (0, 3, 4))
        for j, column, values in drive_entries(model, q, dq, ddq, {}):
            total[j] = values * x[:, column, None] + total[j]
        return total


def smooth_torque(model: TorqueModel, parameters: Matrix) -> SmoothTorque:
    """Return a model's torque without drive terms that are not polynomials.

    If friction depends on the load, its reference is one more robot, the last.
    """
    plain = replace(
        model,
        drive=tuple(
            DriveTerms(terms=[term for term in joint.terms if term.polynomial])
            for joint in model.terms
        ),
        couplings=tuple(p for c in model.couplings for p in _plain_coupling(c)),
        load_reference=None,
    )
    columns = [model.layout.index(name) for name in plain.layout.names]
    x = parameters[:, columns]
    if model.load_reference is not None:
        last = np.zeros((1, x.shape[1]))
        last[0, : len(model.load_reference)] = model.load_reference
        x = np.vstack([x, last])
    return SmoothTorque(plain, x)


def _plain_coupling(coupling: GearCoupling) -> list[GearCoupling]:
    if not (coupling.viscous or coupling.rotor_inertia):
        return []
    return [replace(coupling, coulomb="none", velocity_scale=None)]


def _turned(q: Jet) -> Jet:
    """Return the sizes of sine and cosine, and of their rates."""
    return Jet((_within(np.ones(1)), q.coefficients[1]))


def _within(size: Array) -> Interval:
    return Interval(-size, size)


def _body(x: Matrix, link: slice) -> list[Any]:
    """Return a link's parameters: numbers for one robot, columns for several."""
    if len(x) == 1:
        return list(x[0, link].tolist())
    return list(x.T[link, :, None])


def _stacked(torques: list[Any], order: int, shape: tuple[int, int]) -> Array:
    """Return a coefficient of all joints, shape (samples, robots, joints).

    Of intervals, the size.
    """
    parts = []
    for torque in torques:
        if isinstance(torque, Jet):
            value = torque.coefficients[order]
            value = value.size if isinstance(value, Interval) else value
        else:
            value = torque if order == 0 else 0.0
        parts.append(np.broadcast_to(value, shape).T)
    return np.stack(parts, axis=-1)
