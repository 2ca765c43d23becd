"""Torque along a path and its derivatives in time, at instants and over stretches.

The smooth part is the torque of rigid bodies and of drive terms that are polynomials of
the motion.  The recursion runs on jets, Taylor coefficients ``f, f', f''/2, ...`` of
any scalar: arrays, for values at instants, or `Interval`, for all values over stretches
of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import factorial
from typing import Any, ClassVar

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.motion.proofs.extremes import Interval, path_interval
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.newton_euler import (
    JointMotion,
    floats,
    joint_geometry,
    joint_motions,
    torque_parts,
)
from consistent_id.regression.regressor import TorqueModel

_PIECE = 20_000  # samples times robots at once
_DEPTH = 100.0  # most successive roundings of one link


@dataclass(frozen=True, slots=True, eq=False)
class Jet:
    """Taylor coefficients with respect to time, up to some order.

    Examples
    --------
    >>> t = Jet((np.array([3.0]), 1.0, 0.0))
    >>> [float(c) for c in np.ravel((t * t * 2.0 + 1.0).coefficients)]
    [19.0, 12.0, 2.0]
    """

    coefficients: tuple[Any, ...]
    __array_ufunc__: ClassVar[None] = None  # an array times a jet is computed here

    def __add__(self, other: Any) -> "Jet":
        a = self.coefficients
        if isinstance(other, Jet):
            return Jet(tuple(x + y for x, y in zip(a, other.coefficients, strict=True)))
        return Jet((a[0] + other, *a[1:]))

    __radd__ = __add__

    def __neg__(self) -> "Jet":
        return Jet(tuple(-x for x in self.coefficients))

    def __sub__(self, other: Any) -> "Jet":
        return self.__add__(-other)

    def __rsub__(self, other: Any) -> "Jet":
        return self.__neg__().__add__(other)

    def __mul__(self, other: Any) -> "Jet":
        a = self.coefficients
        if not isinstance(other, Jet):
            return Jet(tuple(x * other for x in a))
        b = other.coefficients
        return Jet(tuple(_convolved(a, b, k) for k in range(len(a))))

    __rmul__ = __mul__


def jet(derivatives: Sequence[Any]) -> Jet:
    """Return the jet of a function from its value and derivatives."""
    return Jet(tuple(x * (1.0 / factorial(k)) for k, x in enumerate(derivatives)))


@dataclass(frozen=True, slots=True, eq=False)
class SmoothTorque:
    """The part of a model's torque that is smooth in time, for several robots at once.

    Parameters
    ----------
    model : TorqueModel
        Model with only polynomial drive terms.
    parameters : ndarray, shape (robots, parameters)
        Parameters of that model.
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
        """Bound the rounding of `derivatives`, shape (robots, joints).

        With every number replaced by plus or minus its size, the recursion gives the
        total size of all summands; its rate gives the effect of a rounded time or
        phase.
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
        """Return each joint's torque as a jet, or a number if it is constant."""
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
        for j, column, values in model.drive_entries(q, dq, ddq, {}):
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

    It is the size of intervals.
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


def sine_and_cosine(x: Jet) -> tuple[Jet, Jet]:
    """Return the jets of ``sin x`` and ``cos x``: ``s' = c x'`` and ``c' = -s x'``."""
    q = x.coefficients
    s, c = [_sine(q[0])], [_cosine(q[0])]
    slopes = [k * q[k] for k in range(1, len(q))]
    for k in range(1, len(q)):
        s.append(_convolved(slopes, c, k - 1) * (1.0 / k))
        c.append(_convolved(slopes, s, k - 1) * (-1.0 / k))
    return Jet(tuple(s)), Jet(tuple(c))


def _convolved(a: Sequence[Any], b: Sequence[Any], k: int) -> Any:
    total = a[0] * b[k]
    for i in range(1, k + 1):
        total = total + a[i] * b[k - i]
    return total


def _sine(x: Any) -> Any:
    return np.sin(x) if isinstance(x, np.ndarray) else x.sin()


def _cosine(x: Any) -> Any:
    return np.cos(x) if isinstance(x, np.ndarray) else x.cos()
