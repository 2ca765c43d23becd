"""A simulated robot of known parameters follows a motion under a controller.

The controller has feedforward and PD; between its ticks the robot moves by Runge-Kutta
steps.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    Vector,
    array_default,
    freeze,
    freeze_arrays,
    frozen,
)
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError, ProblemError, SolverError
from consistent_id.recordings.recording import Recording, states
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.regression.casadi_rows import casadi_regressor
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.mass_matrix import (
    least_mass_eigenvalue,
    mass_matrices,
    random_poses,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

_EVERY = 20  # of the motion's samples, for the mean inertia that sets the gains

_POSES = 200  # random poses at which the mass matrix must be positive definite

_TICKS = 1000  # per call of the compiled loop
_FRICTION_POSES = 50  # samples of the motion at which friction is checked
_STABLE = 2.5  # of Runge-Kutta's fourth order: steps over time constants, up to 2.78


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Encoders:
    """Joint positions, rounded to whole steps, on the controller's clock.

    Parameters
    ----------
    step : array_like, shape () or (joints,), [rad or m]
        Step of a reading; zero for an encoder without steps.
    """

    step: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        freeze(self, step=one_or_each(self.step, "encoders: step"))


def one_or_each(values: ArrayLike, what: str) -> Vector:
    """Return numbers of 0 or more, one for all joints or one each."""
    array = frozen(values, (None,) * np.ndim(values), what)
    if array.ndim > 1 or (array < 0.0).any():
        raise ProblemError(
            f"{what} is {array.tolist()}, expected numbers of 0 or more, one for all "
            "joints or one each"
        )
    return array


class ControllerGains(NamedTuple):
    """Stiffness [N m/rad], damping [N m s/rad]; the low-pass's share of a new value."""

    stiffness: Vector
    damping: Vector
    share: float


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """``tau = Y(q_d, dq_d, ddq_d) x + K e + D de``, ``e = q_d - q``.

    It runs at the rate of the given motion, keeps its torque constant in between, and
    uses only encoder readings: ``de`` is the difference of ``e`` between ticks, through
    a low-pass of first order.

    Parameters
    ----------
    model : TorqueModel
        The controller's model of the robot.
    parameters : array_like, shape (parameters,)
        Its parameters; zero for no feedforward and no gains.
    bandwidth : float, [Hz]
        ``K = (2 pi bandwidth)^2 m``, ``m`` being each joint's own inertia by these
        parameters, on average over the motion.
    damping : float
        ``D = 2 damping (2 pi bandwidth) m``.
    rate_cutoff : float, [Hz]
        Cut-off of the low-pass.
    """

    model: TorqueModel
    parameters: Vector
    bandwidth: float = 5.0
    damping: float = 1.0
    rate_cutoff: float = 60.0

    def __post_init__(self) -> None:
        for name in ("bandwidth", "damping", "rate_cutoff"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ProblemError(f"controller: {name} is {value}, expected above 0")
        freeze_arrays(self, {"parameters": (len(self.model.layout),)}, "controller")

    def feedforward(self, motion: Recording) -> Array:
        """Return the model's torque for a motion, shape (samples, joints)."""
        return self.model.predict(self.parameters, *states(motion))

    def gains(self, motion: Recording) -> ControllerGains:
        """Return the gains for a motion."""
        M = mass_matrices(self.model, self.parameters, motion.position[::_EVERY])
        inertia = np.diagonal(M, axis1=1, axis2=2).mean(axis=0)
        w = 2.0 * np.pi * self.bandwidth
        share = 1.0 - np.exp(-2.0 * np.pi * self.rate_cutoff / motion.rate)
        return ControllerGains(
            w**2 * inertia, 2.0 * self.damping * w * inertia, float(share)
        )


@brief
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
                    f"laboratory: friction of {name!r} depends on the load, and so "
                    f"on the acceleration that it determines; leave load_friction out"
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


class Loop(NamedTuple):
    """The motion at each tick; the torque is constant until the next.

    Attributes
    ----------
    motion : Recording
        True position, velocity, acceleration and torque.  At a tick the last two jump;
        the mean of both sides is logged, as a zero-phase filter returns.
    torque : ndarray, shape (samples, joints), [N m or N]
        The same torque.
    readings : ndarray, shape (samples, joints), [rad or m]
        Readings of the encoders.
    """

    motion: Recording
    torque: Array
    readings: Array


def controlled(
    robot: SimulatedRobot,
    controller: Controller,
    encoders: Encoders,
    wanted: Recording,
    *,
    substeps: int = 2,
) -> Loop:
    """Let a controlled robot follow a motion, from its first position and velocity.

    Parameters
    ----------
    wanted : Recording
        Uniformly sampled, at the controller's rate.
    substeps : int
        Runge-Kutta steps of fourth order between ticks.

    Raises
    ------
    ProblemError
        If friction is too steep for the steps.
    SolverError
        If the robot gets out of control.
    """
    wanted = wanted.of(robot.joints)
    integration = _Integration(
        robot, robot.forward_dynamics(), 1.0 / uniform_rate(wanted), substeps
    )
    poses = wanted.position[:: max(len(wanted) // _FRICTION_POSES, 1)]
    integration.require_stable(poses)
    step = _tick(integration, controller.gains(wanted), encoders)
    feedforward = controller.feedforward(wanted)
    inputs = np.hstack([wanted.position, feedforward]).T
    q0 = wanted.position[0]
    dq0 = np.zeros_like(q0) if wanted.velocity is None else wanted.velocity[0]
    error = q0 - _read(q0, encoders)
    state = np.concatenate([q0, dq0, error, 0.0 * q0, feedforward[0]])
    logged = _run(step, state, inputs)
    if not np.isfinite(logged).all():
        at = int(np.argmin(np.isfinite(logged).all(axis=0)))
        raise SolverError(
            f"{wanted.name}: the robot gets out of control before t = "
            f"{wanted.time[at]:.4g} s; lower the controller's bandwidth, or use more "
            f"substeps"
        )
    q, dq, ddq, torque, readings = (part.T for part in np.split(logged, 5))
    name = f"{wanted.name} (as it was)"
    motion = Recording(robot.joints, wanted.time, q, dq, ddq, torque, name=name)
    return Loop(motion, torque, readings)


def _read(q: Vector, encoders: Encoders) -> Vector:
    """Round half up, as the compiled loop does."""
    step = np.broadcast_to(encoders.step, q.shape)
    stepped = step > 0.0
    counts = np.floor(q / np.where(stepped, step, 1.0) + 0.5)
    return np.where(stepped, counts * step, q)


@dataclass(frozen=True, slots=True, eq=False)
class _Integration:
    """The integration of a robot's motion from tick to tick.

    Parameters
    ----------
    dynamics : callable
        ``(q, dq, tau) -> ddq``.
    tick : float, [s]
    substeps : int
        Runge-Kutta steps of fourth order between ticks.
    """

    robot: SimulatedRobot
    dynamics: Any
    tick: float
    substeps: int

    def after(self, q: Any, dq: Any, tau: Any) -> Any:
        """Return ``(q, dq)`` a tick later."""
        import casadi as ca

        n = len(self.robot.joints)
        h, x = self.tick / self.substeps, ca.vertcat(q, dq)

        def rate(x: Any) -> Any:
            return ca.vertcat(x[n:], self.dynamics(x[:n], x[n:], tau))

        for _ in range(self.substeps):
            k1 = rate(x)
            k2 = rate(x + h / 2.0 * k1)
            k3 = rate(x + h / 2.0 * k2)
            k4 = rate(x + h * k3)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return x

    def require_stable(self, poses: Array) -> None:
        """Refuse steps that are too long for friction near standstill."""
        import casadi as ca

        tick, substeps = self.tick, self.substeps
        if substeps < 1:
            raise ProblemError(f"laboratory: {substeps} substeps, expected 1 or more")
        n = len(self.robot.joints)
        pose, rate, none = ca.SX.sym("q", n), ca.SX.sym("dq", n), np.zeros(n)
        slope = ca.jacobian(self.dynamics(pose, rate, none), rate)
        braking = ca.Function("braking", [pose, rate], [slope])
        at_rest = [np.array(braking(row, none)) for row in poses]
        fastest = float(abs(np.linalg.eigvals(np.array(at_rest))).max())
        needed = int(np.ceil(fastest * tick / _STABLE))
        if needed > substeps:
            raise ProblemError(
                f"laboratory: near standstill friction brakes within "
                f"{1 / fastest:.3g} s, too fast for {substeps} steps in {tick:.3g} s; "
                f"use {needed} substeps, or a larger velocity_scale"
            )


def _tick(integration: _Integration, gains: ControllerGains, encoders: Encoders) -> Any:
    """Return ``(state, inputs) -> (next state, log)`` of one tick.

    The state is ``(q, dq, last error, its rate, last torque)``, the inputs are
    ``(wanted q, feedforward)``, the log is ``(q, dq, ddq, tau, reading)``.
    """
    import casadi as ca

    robot, dynamics, tick = integration.robot, integration.dynamics, integration.tick
    n = len(robot.joints)
    state, inputs = ca.MX.sym("state", 5 * n), ca.MX.sym("inputs", 2 * n)
    q, dq, last, slope, before = ca.vertsplit(state, n)
    q_wanted, feedforward = ca.vertsplit(inputs, n)
    step = np.broadcast_to(encoders.step, n)
    counts = ca.floor(q / np.where(step > 0.0, step, 1.0) + 0.5)
    reading = ca.if_else(ca.DM(step) > 0.0, counts * step, q)
    error = q_wanted - reading
    slope = slope + gains.share * ((error - last) / tick - slope)
    tau = feedforward + gains.stiffness * error + gains.damping * slope
    effort = np.array([joint.limits.effort for joint in robot.model.robot.driven])
    tau = ca.fmax(ca.fmin(tau, effort), -effort)
    following = ca.vertcat(integration.after(q, dq, tau), error, slope, tau)
    logged = (before + tau) / 2.0
    log = ca.vertcat(q, dq, dynamics(q, dq, logged), logged, reading)
    return ca.Function("tick", [state, inputs], [following, log])


def _run(step: Any, state: Vector, inputs: Array) -> Array:
    """Repeat a tick over all inputs; return the log, shape (5 joints, samples)."""
    import casadi as ca

    parts = []
    for start in range(0, inputs.shape[1], _TICKS):
        part = inputs[:, start : start + _TICKS]
        states, log = step.mapaccum(part.shape[1])(state, ca.DM(part))
        state = np.array(states)[:, -1]
        parts.append(np.array(log))
    return np.hstack(parts)
