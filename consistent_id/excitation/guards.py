"""Limits that are no linear function of the variables, as rows where they matter.

A guard measures every item it watches (a joint's torque, a pair of bodies) along a
path; what is above zero is not allowed.  Rows are made only at times where an item
comes near to that.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol, Self

import numpy as np

from consistent_id._arrays import Array, IntArray, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.kernels import TorqueKernel
from consistent_id.regressor import TorqueModel

_TIGHTER = 0.03  # share of a limit given up where a proof has failed
_NEAR = 0.05  # share of what is allowed within which an item gets a row


class Guard(Protocol):
    """What a path must not do, item by item."""

    def measure(self, motion: Array) -> Matrix:
        """Return how far each item is above what is allowed, (samples, items)."""

    def slopes(self, motion: Array, items: IntArray) -> Array:
        """Return derivatives of one item per sample, (samples, 3 orders, joints)."""

    def told(self, item: int) -> str:
        """Name an item for people."""

    def tightened(self) -> Self:
        """Return a guard that allows a little less."""


@dataclass(frozen=True, slots=True, eq=False)
class TorqueGuard:
    """Torque of every parameter vector of a set, in shares of the limit.

    Parameters
    ----------
    model : TorqueModel
    parameters : ndarray, shape (members, parameters)
    effort : ndarray, shape (torque joints,), [N m or N]
    reach : float
        Share of the limit that may be used at a sample.
    """

    model: TorqueModel
    parameters: Matrix
    effort: Vector
    reach: float
    _kernels: dict[int, TorqueKernel] = field(default_factory=dict, init=False)

    def measure(self, motion: Array) -> Matrix:
        """Return how far each torque is above its limit."""
        torque = self._kernel(motion).torque(motion)
        return (abs(torque) / self.effort - self.reach).reshape(len(torque), -1)

    def slopes(self, motion: Array, items: IntArray) -> Array:
        """Return derivatives of the chosen torques' sizes."""
        kernel, samples = self._kernel(motion), np.arange(motion.shape[1])
        member, joint = np.divmod(items, len(self.effort))
        sign = np.sign(kernel.torque(motion)[samples, member, joint])
        slopes = kernel.slopes(motion)[samples, member, joint]
        return slopes * (sign / self.effort[joint])[:, None, None]

    def told(self, item: int) -> str:
        """Name the joint."""
        return f"torque of joint {self.model.torque_joints[item % len(self.effort)]!r}"

    def tightened(self) -> Self:
        """Return a guard with less of each limit to use."""
        return replace(self, reach=self.reach - _TIGHTER)

    def _kernel(self, motion: Array) -> TorqueKernel:
        samples = motion.shape[1]
        if samples not in self._kernels:
            self._kernels[samples] = TorqueKernel(self.model, self.parameters, samples)
        return self._kernels[samples]


class Place(NamedTuple):
    """Where a guard wants a row: a time of the grid, and an item."""

    time: int
    item: int


def near_places(measure: Matrix) -> set[Place]:
    """Return the local maxima over time that come near to what is allowed."""
    before = np.roll(measure, 1, axis=0)
    after = np.roll(measure, -1, axis=0)
    peaks = (measure >= before) & (measure >= after) & (measure > -_NEAR)
    return {Place(int(t), int(i)) for t, i in np.argwhere(peaks)}


def guard_rows(
    guard: Guard,
    places: list[Place],
    basis: FourierBasis,
    time: Vector,
    variables: Matrix,
) -> tuple[Vector, Matrix]:
    """Return the values of a guard's rows and their Jacobian in the variables.

    Parameters
    ----------
    guard : Guard
    places : list of Place
    basis : FourierBasis
    time : ndarray, shape (samples,), [s]
        The grid that places refer to.
    variables : ndarray, shape (size, joints)
    """
    at = time[[place.time for place in places]]
    items = np.array([place.item for place in places])
    motion = basis.motion(variables, at)
    values = guard.measure(motion)[np.arange(len(places)), items]
    slopes = guard.slopes(motion, items)
    jacobian = np.zeros((len(places), *variables.shape))
    for order in range(3):
        columns = basis.columns(order, at)
        jacobian[:, 1:] += (
            columns[:, :, None] * (slopes[:, order] * basis.unit)[:, None]
        )
    jacobian[:, 0] = slopes[:, 0] * basis.limits.derivative(0)
    return values, jacobian.reshape(len(places), -1)
