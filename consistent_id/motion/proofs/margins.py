"""Distances of a path from its limits, proven for all time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ProblemError
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.proofs.extremes import Extremes, extremes
from consistent_id.motion.proofs.torque_bounds import (
    TorqueBounds,
    torque_bounds,
    torque_rate_bounds,
    torque_rms_bound,
)
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.regressor import TorqueModel

_RATES = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True, slots=True)
class Margin:
    """One limit of one joint, and the path's extreme.

    Parameters
    ----------
    quantity : str
        ``"lower position"``, ``"upper position"``, ``"velocity"``, ``"acceleration"``,
        ``"jerk"``, ``"torque"``, ``"torque rate"`` or ``"torque RMS"``; all but
        positions as absolute values.
    limit : float
        In the units of `MotionLimits`.
    bound : float
        Proven bound that the quantity never exceeds (or falls below).
    reached : float
        Value that it reaches, at `time` [s]; the extreme is between it and `bound`.
    span : float
        Reference of the margin: the limit, for a position the joint's range.
    """

    joint: str
    quantity: str
    limit: float
    bound: float
    reached: float
    time: float
    span: float

    @property
    def margin(self) -> float:
        """Least distance from the limit; negative if it is not kept."""
        away = self.limit - self.bound
        return -away if self.quantity == "lower position" else away

    @property
    def relative(self) -> float:
        """The margin as a share of the limit, or of the joint's range."""
        return self.margin / self.span

    @property
    def holds(self) -> bool:
        """Whether it is proven that the limit is kept at all times."""
        return self.margin >= 0.0

    @property
    def violated(self) -> bool:
        """Whether the path is beyond the limit at `time`."""
        beyond = self.reached - self.limit
        return (-beyond if self.quantity == "lower position" else beyond) > 0.0


@brief
@dataclass(frozen=True, slots=True)
class MotionMargins:
    """The margins of a path from all its limits.

    Parameters
    ----------
    margins : tuple of Margin
        Joint by joint; limits that are infinite are left out.
    """

    margins: tuple[Margin, ...]

    @property
    def holds(self) -> bool:
        """Whether it is proven that all limits are kept at all times."""
        return all(margin.holds for margin in self.margins)

    @property
    def least(self) -> Margin:
        """The margin with the least relative value."""
        return min(self.margins, key=lambda margin: margin.relative)

    def require(self) -> None:
        """Raise unless all limits are proven to be kept.

        Raises
        ------
        ProblemError
            The message names joint, limit, time and value of the worst.
        """
        bad = [margin for margin in self.margins if not margin.holds]
        if not bad:
            return
        worst = min(bad, key=lambda margin: margin.relative)
        more = f" (and {len(bad) - 1} more)" if len(bad) > 1 else ""
        what = f"joint {worst.joint!r}: {worst.quantity} limit {worst.limit:.6g}"
        if worst.violated:
            raise ProblemError(
                f"{what} is not kept: {worst.reached:.6g} at {worst.time:.4f} s{more}; "
                "move less, slower or longer, or design with a smaller share of limits"
            )
        raise ProblemError(
            f"{what} is not proven to be kept: {worst.reached:.6g} is reached at "
            f"{worst.time:.4f} s, and no more than {worst.bound:.6g} is proven{more}; "
            "leave more margin"
        )

    def table(self) -> Table:
        """Return the margins for people."""
        rows = tuple(
            (
                m.joint,
                m.quantity,
                f"{m.limit:.5g}",
                f"{m.bound:.5g}",
                f"{m.time:.3f}",
                f"{m.margin:.3g}",
                f"{100.0 * m.relative:.2f} %",
                "yes" if m.holds else "violated" if m.violated else "not proven",
            )
            for m in self.margins
        )
        header = ("joint", "limit of", "limit", "proven", "at [s]")
        note = "bounds proven for all times, not only at samples; rad or m, N m or N"
        return Table(
            "Margins from limits",
            (*header, "margin", "relative", "kept"),
            rows,
            (note,),
        )


def motion_margins(
    path: JointPath,
    limits: MotionLimits,
    *,
    model: TorqueModel | None = None,
    parameters: ArrayLike | None = None,
) -> MotionMargins:
    """Prove the distances of a path from its limits, over its whole duration.

    Parameters
    ----------
    path : JointPath
        As smooth as `extremes` and `torque_bounds` require, which is not checked; a
        `Move` is proven piece by piece.
    limits : MotionLimits
    model : TorqueModel, optional
        If given, torque limits are checked, too, for all joints, also for those whose
        torque is not measured.
    parameters : array_like, shape (parameters,) or (robots, parameters), optional
        Parameters of one robot, or of several; then the worst is used.

    Raises
    ------
    ProblemError
        If joints differ, or one of model and parameters is missing.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.robot import JointLimits
    >>> from consistent_id.motion.limits import motion_limits
    >>> from consistent_id.recordings.joint_paths import FourierTrajectory
    >>> arm = from_modified_dh("arm", [DHRow(0, 0, limits=JointLimits(-1, 1, 2.0))])
    >>> path = FourierTrajectory(("joint1",), [0.5], [0.1], [[0.5]], [[0.0]], 2.0)
    >>> margins = motion_margins(path, motion_limits(arm))
    >>> margins.holds, margins.least.quantity, round(margins.least.margin, 4)
    (True, 'upper position', 0.4)
    """
    require_type(path, JointPath, "path")
    require_type(limits, MotionLimits, "limits")
    if path.joints != limits.joints:
        raise ProblemError(
            f"the path moves {', '.join(path.joints)}; the limits are of "
            f"{', '.join(limits.joints)}; expected the same, in order"
        )
    if (model is None) != (parameters is None):
        raise ProblemError("give both model and parameters, or none, to bound torques")
    found = list(_positions(limits, extremes(path, 0)))
    for order, quantity in enumerate(_RATES, start=1):
        limit = limits.derivative(order)
        if np.isfinite(limit).any():
            of_order = extremes(path, order)
            found += _sizes(quantity, limit, path.joints, of_order)
    if model is not None and parameters is not None:
        effort, every = limits.effort, replace(model, torque_joints=())
        if np.isfinite(effort).any():
            bounds = torque_bounds(path, every, parameters, effort=effort)
            found += _sizes("torque", effort, bounds.joints, bounds)
        found += _over_time(path, limits, every, parameters)
    found.sort(key=lambda margin: path.joints.index(margin.joint))
    return MotionMargins(tuple(found))


def _positions(limits: MotionLimits, seen: Extremes) -> Iterator[Margin]:
    for j, joint in enumerate(seen.joints):
        span = float(limits.upper[j] - limits.lower[j])
        for quantity, limit, bound, reached, time in (
            ("lower position", limits.lower, seen.lowest, seen.least, seen.least_time),
            ("upper position", limits.upper, seen.highest, seen.most, seen.most_time),
        ):
            yield Margin(
                joint,
                quantity,
                float(limit[j]),
                float(bound[j]),
                float(reached[j]),
                float(time[j]),
                span,
            )


def _over_time(
    path: JointPath, limits: MotionLimits, model: TorqueModel, parameters: ArrayLike
) -> Iterator[Margin]:
    """Yield the margins of torque rates and of torque's root mean square."""
    x = np.atleast_2d(np.asarray(parameters, dtype=float))
    if np.isfinite(limits.effort_rate).any():
        rates = torque_rate_bounds(path, model, x, limits.effort_rate)
        yield from _sizes("torque rate", limits.effort_rate, rates.joints, rates)
    if np.isfinite(limits.effort_rms).any():
        bound = torque_rms_bound(path, model, x)
        for joint, limit, rms in zip(
            path.joints, limits.effort_rms, bound, strict=True
        ):
            if np.isfinite(limit):
                most, size = float(limit), float(rms)
                # without a time: the whole path is used
                yield Margin(joint, "torque RMS", most, size, size, path.start, most)


def _sizes(
    quantity: str,
    limit: Vector,
    joints: tuple[str, ...],
    seen: Extremes | TorqueBounds,
) -> Iterator[Margin]:
    """Yield the margins of absolute values from finite limits."""
    for j, joint in enumerate(joints):
        if not np.isfinite(limit[j]):
            continue
        upwards = seen.most[j] >= -seen.least[j]
        reached = seen.most[j] if upwards else -seen.least[j]
        time = seen.most_time[j] if upwards else seen.least_time[j]
        most, size = float(limit[j]), float(seen.size[j])
        yield Margin(joint, quantity, most, size, float(reached), float(time), most)
