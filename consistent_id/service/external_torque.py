"""Torque from outside on the joints: a momentum observer of the identified robot.

The momentum ``p = M(q) dq`` changes by motor torque, the model's own torque and what
pushes from outside.  The observer's external torque ``r`` follows the true one
``tau_e`` like a first-order filter, ``dr/dt = K (tau_e - r)``, and needs no measured
acceleration [DeLuca2006]_.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, checked, freeze, frozen
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording
from consistent_id.service.contact_place import RADIUS, ContactPlace, contact_place
from consistent_id.service.control_model import ControlModel

GAIN = 20.0  # 1/s; after 50 ms 63 % of a step are seen


@dataclass(frozen=True, slots=True, eq=False)
class ObserverState:
    """The observer's state after a sample.

    Attributes
    ----------
    time : float, [s]
    position, velocity, torque : ndarray, shape (joints,)
        Values at the sample.
    external : ndarray, shape (joints,), [N m or N]
        Torque on the joints from outside.
    acceleration : ndarray, shape (joints,), [rad/s^2 or m/s^2]
        Change of the velocity, behind the same filter.
    expected : ndarray, shape (joints,), [N m or N]
        The model's torque, behind the same filter.
    """

    time: float
    position: Vector
    velocity: Vector
    torque: Vector
    external: Vector
    acceleration: Vector
    expected: Vector


@brief
@dataclass(frozen=True, slots=True, eq=False)
class MomentumObserver:
    """Observer of the torque that acts on the joints from outside.

    In a step of `dt`, less what the configuration changes, the momentum changes by
    ``M(q) (dq_1 - dq_0)``; so the mean torque from outside in the step is
    ``M(q) (dq_1 - dq_0) / dt + bias + springs + friction - tau``, of the step's middle.
    It passes a filter of first order with the gain `gain`, which is stable for steps of
    any length.

    Parameters
    ----------
    control : ControlModel
        Its `friction_velocity` is that of the friction here: 0.01 rad/s follows
        measured torque better near rest than a value that is safe for compensation.
    gain : float or sequence of float, [1/s]
        Gain of all joints, or of each.

    Raises
    ------
    ProblemError
        If gains are not positive numbers.
    """

    control: ControlModel
    gain: float | Sequence[float] = GAIN

    def __post_init__(self) -> None:
        require_type(self.control, ControlModel, "control")
        n = len(self.control.joints)
        gain = np.broadcast_to(self.gain, n) if np.ndim(self.gain) == 0 else self.gain
        gains = frozen(gain, (n,), "gains of the observer")
        if not (gains > 0.0).all():
            raise ProblemError(
                f"gains of the observer are {gains.tolist()} 1/s, expected positive "
                f"ones, such as {GAIN:g}"
            )
        freeze(self, gain=gains)

    def start(
        self, time: float, q: ArrayLike, dq: ArrayLike, torque: ArrayLike
    ) -> ObserverState:
        """Return the state at the first sample, at which nothing acts from outside.

        Raises
        ------
        ProblemError
            If shapes do not fit, or the time is not finite.
        """
        at, rate, drive = self._sample(q, dq, torque)
        if not np.isfinite(time):
            raise ProblemError(f"the first sample's time is {time}, expected seconds")
        still = np.zeros(len(at))
        expected = self.control.torque(at, rate, still)
        return ObserverState(time, at, rate, drive, still, still, expected)

    def step(
        self,
        state: ObserverState,
        time: float,
        q: ArrayLike,
        dq: ArrayLike,
        torque: ArrayLike,
    ) -> ObserverState:
        """Return the state after another sample.

        Parameters
        ----------
        state : ObserverState
            State of the sample before.
        time : float, [s]
            Later than that one's.
        q, dq, torque : array_like, shape (joints,)
            Measured positions, velocities, and torques of the drives.

        Raises
        ------
        ProblemError
            If the time does not increase, or shapes do not fit.
        """
        at, rate, drive = self._sample(q, dq, torque)
        dt = time - state.time
        if not 0.0 < dt < np.inf:
            raise ProblemError(
                f"the sample's time is {time:.9g} s, expected more than "
                f"{state.time:.9g} s, that of the sample before"
            )
        push = (rate - state.velocity) / dt
        expected = self.control.torque(
            0.5 * (at + state.position), 0.5 * (rate + state.velocity), push
        )
        share = -np.expm1(-np.asarray(self.gain) * dt)
        measured = 0.5 * (drive + state.torque)
        return ObserverState(
            time,
            at,
            rate,
            drive,
            state.external + share * (expected - measured - state.external),
            state.acceleration + share * (push - state.acceleration),
            state.expected + share * (expected - state.expected),
        )

    def along(self, recording: Recording) -> Recording:
        """Return a log's torque from outside, as `step` finds it sample by sample.

        Parameters
        ----------
        recording : Recording
            With velocity and torque of all joints, as the robot measured them: filters
            that look ahead would show contacts too early.

        Returns
        -------
        Recording
            With the torque from outside as its `torque`, the model's torque as
            `torque_command`, and the acceleration, the last two filtered alike.

        Raises
        ------
        ProblemError
            If velocity or torque are not in the log.
        RecordingError
            If a joint is not in the log.
        """
        require_type(recording, Recording, "recording")
        log = recording.of(self.control.joints)
        if log.velocity is None or log.torque is None:
            raise ProblemError(
                f"{log.name} has {', '.join(log.channels)}; the observer needs "
                "velocity and torque, too. For positions, take differences that do not "
                "look ahead"
            )
        dt = np.diff(log.time)[:, None]
        q, dq, torque = (
            0.5 * (x[1:] + x[:-1]) for x in (log.position, log.velocity, log.torque)
        )
        push = np.diff(log.velocity, axis=0) / dt
        expected = self.control.torque(q, dq, push)
        first = self.start(log.time[0], log.position[0], log.velocity[0], log.torque[0])
        shares = -np.expm1(-np.asarray(self.gain) * dt)
        external, acceleration, filtered = (
            _followed(shares, values, start)
            for values, start in (
                (expected - torque, first.external),
                (push, first.acceleration),
                (expected, first.expected),
            )
        )
        return replace(
            log,
            torque=external,
            acceleration=acceleration,
            torque_command=filtered,
            torque_filter=None,
        )

    def place(
        self,
        q: ArrayLike,
        external: ArrayLike,
        covariance: ArrayLike,
        *,
        radius: float = RADIUS,
    ) -> ContactPlace:
        """Return where a force acts and how hard, from the torque that it causes.

        The force is taken to act without a moment on the surface of one link, whose
        points are `radius` away from the line between its joints.

        Parameters
        ----------
        q : array_like, shape (joints,), [rad or m]
        external : array_like, shape (joints,), [N m or N]
            Torque from outside, less its mean before the contact.
        covariance : array_like, shape (joints, joints), [(N m)^2]
            Covariance of `external`.
        radius : float, [m]

        Raises
        ------
        ProblemError
            If the covariance is not positive definite, or the base floats.
        """
        robot = self.control.model.robot
        return contact_place(robot, q, external, covariance, radius=radius)

    def _sample(self, *values: ArrayLike) -> tuple[Vector, ...]:
        names = ("positions", "velocities", "torques")
        n = len(self.control.joints)
        return tuple(
            checked(x, (n,), what) for what, x in zip(names, values, strict=True)
        )


def _followed(shares: Array, values: Array, start: Vector) -> Array:
    """Return the first-order filter of `values` with these shares of each step."""
    out = np.empty((len(values) + 1, values.shape[1]))
    out[0] = start
    for k, (share, value) in enumerate(zip(shares, values, strict=True)):
        out[k + 1] = out[k] + share * (value - out[k])
    return out
