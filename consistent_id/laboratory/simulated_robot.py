"""A simulated robot of known parameters, and its equations of motion."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector, freeze, frozen
from consistent_id.errors import ModelError, ProblemError
from consistent_id.regression.casadi_regressor import casadi_regressor
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.mass_matrix import least_mass_eigenvalue, random_poses
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

_POSES = 200  # random poses at which the mass matrix must be positive definite


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRobot:
    """A torque model with its true parameters.

    Parameters
    ----------
    model : TorqueModel
        Coulomb friction is a ``"tanh"``: a sign has no equations of motion at rest.
    parameters : array_like, shape (parameters,)

    Raises
    ------
    ModelError
        If the mass matrix is not positive definite, so that no such robot moves.
    ProblemError
        If friction has a sign, or grows with the load, of which acceleration is part.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> model = TorqueModel(from_modified_dh("rod", [DHRow(0, 0)]))
    >>> SimulatedRobot(model, [1.0, 0.5, 0, 0, 0, 0, 0.3, 0, 0, 0.3]).friction
    False
    """

    model: TorqueModel
    parameters: Vector

    def __post_init__(self) -> None:
        model = replace(self.model, torque_joints=())
        x = frozen(self.parameters, (len(model.layout),), "true parameters")
        freeze(self, model=model, parameters=x)
        for name, terms in zip(model.robot.joint_names, model.terms, strict=True):
            if terms.needs_load:
                raise ProblemError(
                    f"laboratory: friction of {name!r} depends on the load, and so on "
                    "the acceleration that it decides; leave load_friction out"
                )
            if terms.smoothed(1.0) != terms:
                raise ProblemError(
                    f"laboratory: friction of {name!r} has a sign, which leaves motion "
                    'at rest undecided; use coulomb "tanh" with a small velocity_scale'
                )
        poses = random_poses(model, _POSES, 0)
        least = least_mass_eigenvalue(model, x, poses)
        if not least > 0.0:
            raise ModelError(
                f"robot {model.robot.name!r}: the mass matrix of these parameters has "
                f"an eigenvalue of {least:.3g}; a robot that moves has positive ones. "
                "Use physically consistent parameters"
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.model.robot.joint_names

    @property
    def friction(self) -> bool:
        """Whether anything dissipates energy."""
        return bool(self.parameters[self._dissipative].any())

    def without_friction(self) -> Self:
        """Return the same robot with friction switched off; rotors and springs stay."""
        x = self.parameters.copy()
        x[self._dissipative] = 0.0
        return replace(self, parameters=x)

    @property
    def _dissipative(self) -> list[int]:
        terms, start = self.model.column_terms, self.model.layout.inertial_size
        return [i for i, t in enumerate(terms, start) if t.friction and t.nonnegative]

    def forward_dynamics(self) -> Any:
        """Return ``ddq(q, dq, tau)`` as a CasADi function of one sample.

        ``M ddq = tau - h``; both come from the regressor, ``M`` by differentiation.
        """
        import casadi as ca

        n, x = len(self.joints), ca.DM(self.parameters)
        q, dq, ddq, tau = (ca.SX.sym(s, n) for s in ("q", "dq", "ddq", "tau"))
        Y = casadi_regressor(self.model)
        M = ca.jacobian(ca.mtimes(Y(q, dq, ddq), x), ddq)
        h = ca.mtimes(Y(q, dq, ca.SX.zeros(n)), x)
        D, LT, p = ca.ldl(M)
        motion = ca.ldl_solve(tau - h, D, LT, p)
        return ca.Function("forward_dynamics", [q, dq, tau], [motion], {"cse": True})


def with_friction(
    robot: RobotModel,
    inertial: ArrayLike,
    *,
    viscous: ArrayLike = 0.0,
    coulomb: ArrayLike = 0.0,
    velocity_scale: float = 0.02,
) -> SimulatedRobot:
    """Return a robot of known inertial parameters with viscous and Coulomb friction.

    Parameters
    ----------
    inertial : array_like, shape (10 links,)
    viscous : array_like, shape () or (joints,), [N m s/rad or N s/m]
    coulomb : array_like, shape () or (joints,), [N m or N]
    velocity_scale : float, [rad/s or m/s]
        See `DriveTerms`.
    """
    n = len(robot)
    known = frozen(inertial, (10 * len(robot.links),), "inertial parameters")
    pairs = np.empty((n, 2))
    for column, (values, what) in enumerate(
        ((viscous, "viscous"), (coulomb, "coulomb"))
    ):
        shape = (n,) if np.ndim(values) else ()
        pairs[:, column] = frozen(values, shape, f"{what} friction")
    if (pairs < 0.0).any():
        raise ProblemError(f"friction is {pairs.tolist()}, expected 0 or more")
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=velocity_scale)
    model = TorqueModel(robot, drive)
    return SimulatedRobot(model, np.concatenate([known, pairs.ravel()]))
