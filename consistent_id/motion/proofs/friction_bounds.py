"""Bounds of friction that is not polynomial in the motion, over stretches of time.

It may jump, or nearly, where a joint turns back, so its derivative is not used. Its
columns are computed with intervals instead of numbers, separately for motion forwards,
backwards and at rest, so that columns of one sign keep it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.motion.proofs.extremes import path_interval
from consistent_id.motion.proofs.interval import Interval
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.drive.term import JointSamples, term_columns
from consistent_id.regression.regressor import TorqueModel

_ROUNDING = 64.0 * np.finfo(float).eps  # relative rounding of motion and columns
_LEAST = float(np.finfo(float).tiny)  # least rate with a direction


@dataclass(frozen=True, slots=True, eq=False)
class DirectedFriction:
    """The columns of a model that are no polynomials, and their coefficients.

    Parameters
    ----------
    own : TorqueModel
        The same model without couplings: each joint's friction depends on its own rate.
    parameters : ndarray, shape (robots, parameters)
    """

    model: TorqueModel
    own: TorqueModel
    parameters: Matrix

    @property
    def needed(self) -> bool:
        """Whether any robot has such friction."""
        start = self.model.layout.inertial_size
        terms = self.model.column_terms
        return any(
            not term.polynomial and self.parameters[:, column].any()
            for column, term in enumerate(terms, start)
        )

    def enclosed(
        self, path: JointPath, middle: Vector, radius: float, load: Interval
    ) -> Interval:
        """Enclose the friction over stretches of time, rounding included.

        Parameters
        ----------
        middle : ndarray, shape (stretches,), [s]
        radius : float, [s]
            May be zero; then a joint at rest has friction of both signs.
        load : Interval, shape (stretches, joints), [N m or N]
            Torque that the joints transmit.

        Returns
        -------
        Interval, shape (stretches, robots, joints), [N m or N]
        """
        q, dq, ddq = (
            [_widened(x, x.size) for x in order.columns()]
            for order in path_interval(path, middle, radius, 2)
        )
        loads = load.columns()
        # exactly at rest, a joint may begin to move either way
        dq = [Interval(x.low - 2.0 * _LEAST, x.high + 2.0 * _LEAST) for x in dq]
        parts = [
            self._sum(self.own, [q, rates, ddq], loads, 0)
            for rates in zip(*(_directions(rate) for rate in dq), strict=True)
        ]
        both = self._sum(self.model, [q, dq, ddq], loads, len(self.own.layout))
        shape = (len(self.parameters), len(middle))
        ends = []
        for j, shared in enumerate(both):
            first, *others = (_interval(part[j], shape) for part in parts)
            for other in others:
                first = first.union(other)
            ends.append(first + _interval(shared, shape))
        low = np.stack([x.low.T for x in ends], axis=-1)
        return Interval(low, np.stack([x.high.T for x in ends], axis=-1))

    def _sum(
        self, model: TorqueModel, motion: Sequence[Any], loads: list[Any], start: int
    ) -> list[Any]:
        """Add up the columns from `start` on, joint by joint."""
        total: list[Any] = [0.0] * len(model.robot)
        terms, skip = self.model.column_terms, self.model.layout.inertial_size
        needed = {
            j: loads[j] for j, joint in enumerate(model.terms) if joint.needs_load
        }
        q, dq, ddq = motion
        for j, column, values in model.drive_entries(q, dq, ddq, needed):
            if column >= start and not terms[column - skip].polynomial:
                values = _interval(values)
                values = _widened(values, 1.0 + values.size)
                total[j] = values * self.parameters[:, column, None] + total[j]
        return total


def directed_friction(model: TorqueModel, parameters: Matrix) -> DirectedFriction:
    """Return the friction terms of a model that are not polynomial in the motion."""
    return DirectedFriction(model, replace(model, couplings=()), parameters)


def require_enclosable(model: TorqueModel) -> None:
    """Refuse terms that cannot be computed for intervals, before any work is done.

    Raises
    ------
    ProblemError
        The message names the term and the reason.
    """
    stretch = Interval(np.array([-0.5]), np.array([0.5]))
    for term in model.column_terms:
        term_columns(term, JointSamples(stretch, stretch, stretch, stretch))


def _directions(rate: Interval) -> list[Interval]:
    """Return the rates forwards, backwards and at rest; all rates if there are none.

    Zero is rounded up to the least number with a direction, which changes a continuous
    term by a negligible amount.
    """
    forwards = Interval(np.maximum(rate.low, _LEAST), rate.high)
    backwards = Interval(rate.low, np.minimum(rate.high, -_LEAST))
    at_rest = Interval(np.zeros_like(rate.low), np.zeros_like(rate.low))
    there = (rate.high >= _LEAST, rate.low <= -_LEAST, abs(rate).low == 0.0)
    return [
        Interval(np.where(x, r.low, rate.low), np.where(x, r.high, rate.high))
        for x, r in zip(there, (forwards, backwards, at_rest), strict=True)
    ]


def _widened(x: Interval, size: Array) -> Interval:
    """Return an interval widened by the rounding of numbers of some size."""
    return Interval(x.low - _ROUNDING * size, x.high + _ROUNDING * size)


def _interval(x: Any, shape: tuple[int, ...] = ()) -> Interval:
    low, high = (x.low, x.high) if isinstance(x, Interval) else (x, x)
    shape = np.broadcast_shapes(np.shape(low), shape)
    return Interval(np.broadcast_to(low, shape), np.broadcast_to(high, shape))
