"""Regressor and torque of many samples, with exact derivatives, through CasADi.

One sample's regressor is an SX expression.  So is the gradient of ``sum S * Y`` with
respect to the sample's motion, for any matrix ``S``; both are mapped over the samples.
"""

from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.casadi_rows import casadi_regressor
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import RowModel
from consistent_id.regression.rows.sensor_rows import SensorRows

SMOOTH = 0.02
"""Velocity [rad/s or m/s] that replaces the jump of a sign at standstill."""
_SLOW = 0.01  # share of a joint's possible speed that replaces that jump


class RegressorKernel:
    """The base regressor of a fixed number of samples, and its pull-back.

    Parameters
    ----------
    model : TorqueModel or SensorRows
        Coulomb friction with a jump gets a steep slope instead.
    base : BaseParameters
    samples : int
    slow : ndarray, shape (joints,), optional, [rad/s or m/s]
        See `smooth`.
    """

    def __init__(
        self,
        model: RowModel,
        base: BaseParameters,
        samples: int,
        slow: Vector | None = None,
    ) -> None:
        import casadi as ca

        n = len(model.robot)
        x = ca.SX.sym("x", 3 * n)
        columns = list(base.independent)
        expression = _expression(model, slow)
        Y = expression(x[:n], x[n : 2 * n], x[2 * n :])[:, columns]
        entries = ca.vertcat(*Y.nonzeros())
        seed = ca.SX.sym("seed", entries.shape[0])
        slope = ca.gradient(ca.dot(seed, entries), x)
        options = {"cse": True}
        self._rows, self._columns = (np.array(i) for i in Y.sparsity().get_triplet())
        self._shape = (Y.shape[0], samples, Y.shape[1])
        self._values = _Mapped(ca.Function("Y", [x], [entries], options), samples)
        self._slopes = _Mapped(ca.Function("dY", [x, seed], [slope], options), samples)

    def regressor(self, motion: Array) -> Array:
        """Return the base regressor, shape (torque joints, samples, base).

        `motion` has the shape (3, samples, joints).
        """
        values = self._values(_stacked(motion))
        W = np.zeros(self._shape)
        W[self._rows, :, self._columns] = values.T
        return W

    def pull(self, motion: Array, seed: Array) -> Array:
        """Return the gradient of ``sum seed * W`` with respect to the motion."""
        entries = np.ascontiguousarray(seed[self._rows, :, self._columns].T)
        slopes = self._slopes(_stacked(motion), entries)
        return _unstacked(slopes)


class TorqueKernel:
    """The torque of given parameters, with derivatives.

    Parameters
    ----------
    model : TorqueModel
    parameters : ndarray, shape (members, parameters)
    slow : ndarray, shape (joints,), optional, [rad/s or m/s]
        See `smooth`.
    """

    def __init__(
        self, model: TorqueModel, parameters: Matrix, slow: Vector | None = None
    ) -> None:
        import casadi as ca

        n = len(model.robot)
        x = ca.SX.sym("x", 3 * n)
        Y = casadi_regressor(smooth(model, slow))(x[:n], x[n : 2 * n], x[2 * n :])
        torque = ca.vec(Y @ ca.DM(parameters.T))
        jacobian = ca.vec(ca.densify(ca.jacobian(torque, x)).T)
        options = {"cse": True}
        self._shape = (len(parameters), Y.shape[0])
        self._torque = ca.Function("tau", [x], [ca.densify(torque)], options)
        self._slopes = ca.Function("dtau", [x], [jacobian], options)
        # One expression for all numbers of samples: that of 17 joints takes a second.
        self._mapped: dict[tuple[str, int], _Mapped] = {}

    def torque(self, motion: Array) -> Array:
        """Return torques, shape (samples, members, torque joints)."""
        return self._values(self._torque, motion).reshape(-1, *self._shape)

    def slopes(self, motion: Array) -> Array:
        """Return derivatives, (samples, members, torque joints, 3 orders, joints)."""
        joints = motion.shape[2]
        values = self._values(self._slopes, motion)
        return values.reshape(-1, *self._shape, 3, joints)

    def _values(self, function: Any, motion: Array) -> Matrix:
        key = function.name(), motion.shape[1]
        if key not in self._mapped:
            self._mapped[key] = _Mapped(function, key[1])
        return self._mapped[key](_stacked(motion))


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class ParameterTorque:
    """The torque of given parameters, whose kernel is compiled once.

    Parameters
    ----------
    model : TorqueModel
    parameters : ndarray, shape (members, parameters)
    slow : ndarray, shape (joints,), optional, [rad/s or m/s]
        See `smooth`.
    """

    model: TorqueModel
    parameters: Matrix
    slow: Vector | None = None

    @property
    def kernel(self) -> TorqueKernel:
        """The torque as a function of motion, with derivatives."""
        if self not in _KERNELS:
            _KERNELS[self] = TorqueKernel(self.model, self.parameters, self.slow)
        return _KERNELS[self]


# CasADi functions with their own memory, which is not sent to other processes.
_KERNELS: WeakKeyDictionary[ParameterTorque, TorqueKernel] = WeakKeyDictionary()


def slow_speeds(limits: MotionLimits) -> Vector:
    """Return a hundredth of the speed that each joint can have, (joints,).

    That of its limit, or what acceleration or jerk allow over half of its range.
    """
    half = limits.derivative(0)
    speed = np.minimum(limits.velocity, np.sqrt(2.0 * limits.acceleration * half))
    by_jerk = np.cbrt(limits.jerk * half**2)
    return np.asarray(_SLOW * np.minimum(speed, by_jerk))


def smooth(model: TorqueModel, slow: Vector | None = None) -> TorqueModel:
    """Return the model with a steep slope where Coulomb friction has a jump.

    Parameters
    ----------
    model : TorqueModel
    slow : ndarray, shape (joints,), optional, [rad/s or m/s]
        Velocity of each joint that replaces the jump.  It must be far below the
        relevant speeds; otherwise a slow joint's friction looks viscous.  By default
        `SMOOTH`. Coupled joints have the lesser of two.

    Raises
    ------
    ProblemError
        If a drive term is not smooth and has no smooth replacement.
    """
    names = model.robot.joint_names
    each = [SMOOTH] * len(names) if slow is None else slow.tolist()
    speed = dict(zip(names, each, strict=True))
    terms = tuple(
        term.smoothed(speed[name])
        for name, term in zip(names, model.terms, strict=True)
    )
    couplings = tuple(
        c.smoothed(min(speed[c.first], speed[c.second])) for c in model.couplings
    )
    return replace(model, drive=terms, couplings=couplings)


def _expression(model: RowModel, slow: Vector | None) -> Any:
    """Return the regressor of a sample as a CasADi function."""
    if isinstance(model, SensorRows):
        return model.casadi()
    if not isinstance(model, TorqueModel):
        raise ProblemError(
            f"rows of a {type(model).__name__}, expected a TorqueModel or SensorRows"
        )
    return casadi_regressor(smooth(model, slow))


class _Mapped:
    """A CasADi function run over samples, on memory of its own without copies."""

    def __init__(self, function: Any, samples: int) -> None:
        mapped = function.map(samples)
        self._inputs = [
            np.zeros((samples, function.numel_in(i))) for i in range(function.n_in())
        ]
        self._output = np.zeros((samples, function.numel_out(0)))
        self._buffer, self._run = mapped.buffer()
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, array.data)
        self._buffer.set_res(0, self._output.data)

    def __call__(self, *values: Matrix) -> Matrix:
        for place, value in zip(self._inputs, values, strict=True):
            place[:] = value
        self._run()
        return self._output


def _stacked(motion: Array) -> Matrix:
    """(3, samples, joints) as the kernels' (samples, 3 joints)."""
    return np.concatenate(list(motion), axis=1)


def _unstacked(slopes: Matrix) -> Array:
    samples = len(slopes)
    return slopes.reshape(samples, 3, -1).transpose(1, 0, 2)
