"""A controller that makes a robot follow a motion: feedforward and PD."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector, freeze_arrays
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording, states
from consistent_id.regression.mass_matrix import mass_matrices
from consistent_id.regression.regressor import TorqueModel

_EVERY = 20  # of the motion's samples, for the mean inertia that sets the gains


class ControllerGains(NamedTuple):
    """Stiffness [N m/rad], damping [N m s/rad]; the low-pass's share of a new value."""

    stiffness: Vector
    damping: Vector
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """``tau = Y(q_d, dq_d, ddq_d) x + K e + D de``, ``e = q_d - q``.

    It runs at the rate of the motion it is given, holds its torque in between, and sees
    encoder readings only: ``de`` is the difference of ``e`` between ticks, through a
    low-pass of first order.

    Parameters
    ----------
    model : TorqueModel
        The controller's model of the robot.
    parameters : array_like, shape (parameters,)
        Its belief; zero for none, and no gains either.
    bandwidth : float, [Hz]
        ``K = (2 pi bandwidth)^2 m``, ``m`` being each joint's own inertia by the
        belief, on average over the motion.
    damping : float
        ``D = 2 damping (2 pi bandwidth) m``.
    rate_cutoff : float, [Hz]
        Of the low-pass.
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
