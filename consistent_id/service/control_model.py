"""The identified robot as a controller uses it: gravity, bias, friction, torque.

``tau = M(q) ddq + bias(q, dq) + springs(q) + friction(q, dq)``

Friction is smooth at rest and at most the identified friction; see
`with_smooth_friction`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, freeze
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.casadi_functions import Functions, to_c, to_casadi
from consistent_id.export.export_formats import Export, require_exportable
from consistent_id.export.pinocchio_model import to_pinocchio
from consistent_id.export.smooth_friction import (
    FRICTION_VELOCITY,
    with_smooth_friction,
)
from consistent_id.regression.drive.drive_terms import LAWS
from consistent_id.regression.drive.laws import FrictionSlope, LoadFriction
from consistent_id.regression.mass_matrix import mass_matrices
from consistent_id.regression.regressor import TorqueModel

_OF_Q = (FrictionSlope, LoadFriction)  # built-in laws that depend on the position


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ControlModel:
    """Torques of an identified robot, for a controller; made by `control_model`.

    Positions `q` [rad or m], velocities `dq` and accelerations `ddq` have shape
    (..., joints), torques too, [N m or N]; all joints, in the order of `joints`.

    Parameters
    ----------
    estimate : Estimate
    friction_velocity : float or sequence of float, [rad/s or m/s]
        See `with_smooth_friction`.
    allow_refused : bool
        Whether the estimate may be used if its verdict is ``do not use``.

    Attributes
    ----------
    model : TorqueModel
        With smooth friction; every joint has a torque.
    parameters : ndarray, shape (parameters,)
        Those of the estimate, less friction laws that are not smooth.
    left_out : tuple of str
        Names of these.
    """

    estimate: Estimate
    friction_velocity: float | Sequence[float] = FRICTION_VELOCITY
    allow_refused: bool = False
    model: TorqueModel = field(init=False)
    parameters: Vector = field(init=False)
    left_out: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        require_exportable(self.estimate, "numpy", allow_refused=self.allow_refused)
        # Joints without a measured torque have a torque, too.
        every = replace(self.estimate.model, torque_joints=())
        smooth = with_smooth_friction(every, self.friction_velocity)
        parameters = smooth.parameters(self.estimate.parameters)
        freeze(
            self,
            model=smooth.model,
            parameters=parameters,
            left_out=smooth.left_out,
        )

    def __repr__(self) -> str:
        robot = self.model.robot
        return f"ControlModel({robot.name!r}, {len(robot)} joints)"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.model.robot.joint_names

    def gravity(self, q: ArrayLike) -> Array:
        """Return the torque that balances the bodies' weight at rest."""
        return self._bodies(self.parameters, q)

    def bias(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return gravity, Coriolis and centrifugal torque of the bodies."""
        return self._bodies(self.parameters, q, dq)

    def springs(self, q: ArrayLike) -> Array:
        """Return the torque of springs and constant offsets of the drives."""
        return self._drives(q)

    def friction(self, dq: ArrayLike, q: ArrayLike | None = None) -> Array:
        """Return friction: smooth at rest, and at most what was identified.

        Friction that depends on the load is computed for the load at rest; while the
        arm accelerates, it may exceed the real friction.

        Parameters
        ----------
        dq : array_like, shape (..., joints), [rad/s or m/s]
        q : array_like, shape (..., joints), [rad or m], optional
            Needed by friction that depends on the position or the load; of the load,
            the part at rest counts.

        Raises
        ------
        ProblemError
            If it is needed and not given.
        """
        if q is None:
            if needed := self._of_position:
                raise ProblemError(
                    f"friction by {', '.join(needed)} depends on the position; give q, "
                    "too: friction(dq, q)"
                )
            q = np.zeros_like(np.asarray(dq, dtype=np.float64))
        return np.asarray(self._drives(q, dq) - self._drives(q))

    def torque(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return ``M(q) ddq + bias(q, dq) + springs(q) + friction(q, dq)``."""
        rotors = self._drives(q, None, ddq)  # and springs
        bodies = self._bodies(self.parameters, q, dq, ddq)
        return np.asarray(bodies + rotors + self.friction(dq, q))

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return the mass matrix, rotor inertias and couplings included.

        Returns
        -------
        ndarray, shape (..., joints, joints), [kg m^2 or kg]
        """
        (poses,), shape = self._flat(q)
        found = mass_matrices(self.model, self.parameters, poses)
        return found.reshape(*shape, len(self.joints))

    def casadi(self) -> Functions:
        """Return the same torques as CasADi functions, by the same recursion."""
        return to_casadi(
            self.estimate,
            friction_velocity=self.friction_velocity,
            allow_refused=self.allow_refused,
        )

    def pinocchio(self) -> Any:
        """Return a ``pinocchio.Model`` of the bodies and the drives.

        Its damping and dry friction are those of the estimate, not smooth, and it has
        neither springs nor offsets; see `to_pinocchio`.
        """
        return to_pinocchio(self.estimate, allow_refused=self.allow_refused)

    def c(self, *, name: str | None = None) -> Export:
        """Return the same torques as C without allocation: a source and a header.

        Parameters
        ----------
        name : str, optional
            Prefix of the functions; by default the robot's name.
        """
        return to_c(
            self.estimate,
            name=name,
            friction_velocity=self.friction_velocity,
            allow_refused=self.allow_refused,
        )

    @property
    def _of_position(self) -> list[str]:
        """Names of friction coefficients whose columns depend on the position."""
        model = self.model
        names = model.layout.names[model.layout.inertial_size :]
        built_in = tuple(LAWS.values())
        return [
            name
            for name, term in zip(names, model.column_terms, strict=False)
            if isinstance(term, _OF_Q)
            or (term.friction and not isinstance(term, built_in))
        ]

    def _bodies(
        self,
        parameters: Vector,
        q: ArrayLike,
        dq: ArrayLike | None = None,
        ddq: ArrayLike | None = None,
    ) -> Array:
        state, shape = self._flat(q, dq, ddq)
        bodies = parameters[: self.model.layout.inertial_size]
        return self.model.rigid_torque(bodies, state).reshape(shape)

    def _drives(
        self, q: ArrayLike, dq: ArrayLike | None = None, ddq: ArrayLike | None = None
    ) -> Array:
        """Return the torque of drive terms; at rest where derivatives are None."""
        state, shape = self._flat(q, dq, ddq)
        model, samples = self.model, len(state[0])
        torque = np.zeros((samples, len(self.joints)))
        loads: dict[int, Any] = {}
        if model.load_reference is not None:
            carried = self._bodies(model.load_reference, state[0])
            loads = dict(enumerate(carried.T))
        still = np.zeros((len(self.joints), samples))
        at, rate, push = (still if values is None else values.T for values in state)
        for j, column, values in model.drive_entries(at, rate, push, loads):
            torque[:, j] += self.parameters[column] * values
        return torque.reshape(shape)

    def _flat(
        self, q: ArrayLike, *others: ArrayLike | None
    ) -> tuple[list[Any], tuple[int, ...]]:
        """Return arrays of shape (samples, joints), and the shape of the result."""
        n = len(self.joints)
        given = [self._state(q), *(self._state(v) for v in others if v is not None)]
        shapes = [array.shape for array in given]
        try:
            shape = np.broadcast_shapes(*shapes)
        except ValueError:
            raise ProblemError(
                f"positions, velocities and accelerations have shapes "
                f"{', '.join(map(str, shapes))}, expected the same number of samples"
            ) from None
        same = iter(np.broadcast_arrays(*given))
        return [
            None if v is None else np.ascontiguousarray(next(same).reshape(-1, n))
            for v in (q, *others)
        ], shape

    def _state(self, values: ArrayLike) -> Array:
        """Return a state as numbers of shape (..., joints)."""
        n = len(self.joints)
        expected = (
            f"expected finite numbers of shape (..., {n}): one for each of "
            f"{', '.join(self.joints)}"
        )
        try:
            if np.iscomplexobj(values):
                raise TypeError("complex numbers")
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as cause:
            raise ProblemError(f"the state: {cause}, {expected}") from None
        if array.ndim == 0 or array.shape[-1] != n:
            raise ProblemError(f"the state has shape {array.shape}, {expected}")
        if not (finite := np.isfinite(array)).all():
            *sample, joint = np.argwhere(~finite)[0].tolist()
            value = array[*sample, joint]
            raise ProblemError(
                f"the state of {self.joints[joint]} is {value}, {expected}"
            )
        return np.asarray(array)


def control_model(
    estimate: Estimate,
    *,
    friction_velocity: float | Sequence[float] = FRICTION_VELOCITY,
    allow_refused: bool = False,
) -> ControlModel:
    """Return the torques of an identified robot for a controller.

    Parameters
    ----------
    estimate : Estimate
    friction_velocity : float or sequence of float, [rad/s or m/s]
        Velocity at which compensated dry friction has 0.76 of its level, for all joints
        or one each; a term's own scale, if it is larger.
    allow_refused : bool
        Whether an estimate may be used whose verdict is ``do not use``.

    Raises
    ------
    ProblemError
        If the estimate is refused, its base floats, or velocities are not positive.
    """
    return ControlModel(estimate, friction_velocity, allow_refused)
