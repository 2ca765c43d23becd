"""A controlled robot in time: Runge-Kutta steps between the controller's ticks."""

from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import ProblemError, SolverError
from consistent_id.laboratory.control import Controller
from consistent_id.laboratory.sensors import Encoders
from consistent_id.laboratory.simulated_robot import SimulatedRobot
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate

_TICKS = 1000  # per call of the compiled loop
_POSES = 50  # of the motion at which friction is looked at
_STABLE = 2.5  # of Runge-Kutta's fourth order: steps over time constants, up to 2.78


class Loop(NamedTuple):
    """What happened at each tick; the torque holds until the next.

    Attributes
    ----------
    motion : Recording
        True position, velocity, acceleration and torque.  At a tick the last two
        jump; what is logged is halfway, where a filter without phase finds them.
    torque : ndarray, shape (samples, joints), [N m or N]
        The same torque.
    readings : ndarray, shape (samples, joints), [rad or m]
        Of the encoders.
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
    tick = 1.0 / uniform_rate(wanted)
    dynamics = robot.forward_dynamics()
    poses = wanted.position[:: max(len(wanted) // _POSES, 1)]
    _require_stable(robot, dynamics, poses, tick, substeps)
    step = _tick(robot, controller, encoders, wanted, dynamics, tick, substeps)
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
            f"{wanted.time[at]:.4g} s; lower the controller's bandwidth, or take more "
            "substeps"
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


def _tick(
    robot: SimulatedRobot,
    controller: Controller,
    encoders: Encoders,
    wanted: Recording,
    dynamics: Any,
    tick: float,
    substeps: int,
) -> Any:
    """Return ``(state, inputs) -> (next state, log)`` of one tick.

    The state is ``(q, dq, last error, its rate, last torque)``, the inputs are
    ``(wanted q, feedforward)``, the log is ``(q, dq, ddq, tau, reading)``.
    """
    import casadi as ca

    n = len(robot.joints)
    gains = controller.gains(wanted)
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
    h, x = tick / substeps, ca.vertcat(q, dq)

    def rate(x: Any) -> Any:
        return ca.vertcat(x[n:], dynamics(x[:n], x[n:], tau))

    for _ in range(substeps):
        k1 = rate(x)
        k2 = rate(x + h / 2.0 * k1)
        k3 = rate(x + h / 2.0 * k2)
        k4 = rate(x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    following = ca.vertcat(x, error, slope, tau)
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


def _require_stable(
    robot: SimulatedRobot, dynamics: Any, q: Array, tick: float, substeps: int
) -> None:
    """Refuse steps longer than what friction near standstill, the steepest, takes."""
    import casadi as ca

    if substeps < 1:
        raise ProblemError(f"laboratory: {substeps} substeps, expected 1 or more")
    n = len(robot.joints)
    pose, rate, none = ca.SX.sym("q", n), ca.SX.sym("dq", n), np.zeros(n)
    slope = ca.jacobian(dynamics(pose, rate, none), rate)
    braking = ca.Function("braking", [pose, rate], [slope])
    at_rest = [np.array(braking(row, none)) for row in q]
    fastest = float(abs(np.linalg.eigvals(np.array(at_rest))).max())
    needed = int(np.ceil(fastest * tick / _STABLE))
    if needed > substeps:
        raise ProblemError(
            f"laboratory: near standstill friction brakes within {1 / fastest:.3g} s, "
            f"too fast for {substeps} steps in {tick:.3g} s; take {needed} substeps, "
            "or a larger velocity_scale"
        )
