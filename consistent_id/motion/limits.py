"""Limits of joints' motion that must be kept at all times."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector, array_default, freeze, freeze_arrays
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.robot.model import Joint, RobotModel, limits_with_followers
from consistent_id.robot.parameters import require_known

_ORDERS = ("velocity", "acceleration", "jerk")
_OVER_TIME = ("effort_rate", "effort_rms")
_EFFORTS = ("effort", *_OVER_TIME)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class MotionLimits:
    """Limits of each joint's motion and torque; infinite where there is none.

    Parameters
    ----------
    joints : tuple of str
    lower, upper : array_like, shape (joints,), [rad or m]
    velocity : array_like, shape (joints,), [rad/s or m/s]
    acceleration : array_like, shape (joints,), [rad/s^2 or m/s^2]
    jerk : array_like, shape (joints,), [rad/s^3 or m/s^3]
    effort : array_like, shape (joints,), [N m or N]
    effort_rate : array_like, shape (joints,), optional, [N m/s or N/s]
    effort_rms : array_like, shape (joints,), optional, [N m or N]
        Root mean square of the torque over a motion, which heats the motor.

    Raises
    ------
    ProblemError
        If a joint has no range to move in, or one that is not finite, or no limit that
        bounds its speed; the message names joint and limit.

    Examples
    --------
    >>> import consistent_id as ci
    >>> limits = ci.MotionLimits(("elbow",), [-1], [2], [1.5], [np.inf], [np.inf], [40])
    >>> limits.middle, limits.velocity
    (array([0.5]), array([1.5]))
    """

    joints: tuple[str, ...]
    lower: Vector
    upper: Vector
    velocity: Vector
    acceleration: Vector
    jerk: Vector
    effort: Vector
    effort_rate: Vector = array_default(np.inf)
    effort_rms: Vector = array_default(np.inf)

    def __post_init__(self) -> None:
        freeze(self, joints=tuple(self.joints))
        for name in _OVER_TIME:
            every = np.broadcast_to(getattr(self, name), (len(self.joints),))
            freeze(self, **{name: every})
        names = ("lower", "upper", *_ORDERS, *_EFFORTS)
        shapes = dict.fromkeys(names, (len(self.joints),))
        freeze_arrays(self, shapes, "limits", finite=False)
        faults: dict[str, dict[str, str]] = {}
        for j, joint in enumerate(self.joints):
            for kind, fault in self._faults(j):
                faults.setdefault(kind, {})[joint] = fault
        for found in faults.values():
            (joint, fault), *others = found.items()
            same = ", ".join(repr(name) for name, _ in others)
            same = same and f" (and likewise {same})"
            raise ProblemError(f"limits of joint {joint!r}{same}: {fault}")

    def _faults(self, j: int) -> Iterator[tuple[str, str]]:
        """Yield the kinds of a joint's faults, and what they are."""
        low, high = self.lower[j], self.upper[j]
        if not (np.isfinite(low) and np.isfinite(high)):
            yield (
                "endless",
                f"position between {low} and {high}, expected finite numbers; "
                "give its range",
            )
        elif not low < high:
            yield (
                "no range",
                f"lower {low:g} is not below upper {high:g}, so it cannot "
                "move; widen the range, or lock the joint in the model",
            )
        for name in (*_ORDERS, *_EFFORTS):
            value = getattr(self, name)[j]
            if not value > 0.0:
                yield (
                    name,
                    f"{name} is {value:g}, expected more than 0; correct it, "
                    "or lock the joint in the model",
                )
        if not min(getattr(self, name)[j] for name in _ORDERS) < np.inf:
            yield (
                "speed",
                "no limit bounds its speed; give velocity, acceleration or jerk",
            )

    @property
    def middle(self) -> Vector:
        """Middle of each joint's range [rad or m]."""
        return (self.lower + self.upper) / 2.0

    def derivative(self, order: int) -> Vector:
        """Return half the range, velocity, acceleration, jerk for order 0 to 3."""
        if order == 0:
            return (self.upper - self.lower) / 2.0
        return np.asarray(getattr(self, _ORDERS[order - 1]))

    def within(self, share: float) -> Self:
        """Return limits with the same middle, reduced to a share."""
        if not 0.0 < share <= 1.0:
            raise ProblemError(f"share of limits is {share}, expected above 0 up to 1")
        half = share * self.derivative(0)
        return replace(
            self,
            lower=self.middle - half,
            upper=self.middle + half,
            **{name: share * getattr(self, name) for name in (*_ORDERS, *_EFFORTS)},
        )

    def with_currents(
        self,
        current: ArrayLike | Mapping[str, float] | None,
        torque_constant: ArrayLike | Mapping[str, float] | None,
    ) -> Self:
        """Return limits whose efforts need no larger current.

        Parameters
        ----------
        current : array_like or mapping, optional, [A]
            Largest current; one for all joints, one each, or some by name.
        torque_constant : array_like or mapping, optional, [N m/A or N/A]
            Torque of the joint over current, gears included; given likewise.

        Raises
        ------
        ProblemError
            If only one of them is given, or a name is no joint's.
        """
        if current is None and torque_constant is None:
            return self
        if current is None or torque_constant is None:
            missing = "current" if current is None else "torque_constant"
            raise ProblemError(
                f"limits: {missing} is missing: a current [A] limits torque with the "
                "torque constant of the joint, gears included [N m/A]; give both"
            )
        unlimited = [np.inf] * len(self.joints)
        most = _each(current, unlimited, self.joints, "current")
        constant = _each(torque_constant, unlimited, self.joints, "torque_constant")
        known = np.isfinite(most) & np.isfinite(constant)
        torque = np.where(known, most * constant, np.inf)
        return replace(self, effort=np.minimum(self.effort, torque))


def motion_limits(
    robot: RobotModel,
    *,
    position: Mapping[str, tuple[float, float]] | None = None,
    velocity: ArrayLike | Mapping[str, float] | None = None,
    acceleration: ArrayLike | Mapping[str, float] | None = None,
    jerk: ArrayLike | Mapping[str, float] | None = None,
    effort: ArrayLike | Mapping[str, float] | None = None,
    effort_rate: ArrayLike | Mapping[str, float] | None = None,
    effort_rms: ArrayLike | Mapping[str, float] | None = None,
) -> MotionLimits:
    """Return a robot's limits; given values replace those of its file.

    Parameters
    ----------
    robot : RobotModel
        A continuous joint without a range gets one turn, from -pi to pi, which winds
        no cable.
    position : mapping from joint to (lower, upper), optional, [rad or m]
    velocity, acceleration, jerk : array_like or mapping, optional
    effort, effort_rate, effort_rms : array_like or mapping, optional
        One number for all joints, one each in the robot's order, or some by name.
        Robot files state velocity and effort at most.

    Raises
    ------
    ProblemError
        If a joint name is unknown, or a joint's limits allow no motion or any motion.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.robot import JointLimits
    >>> arm = from_modified_dh("arm", [DHRow(0, 0, limits=JointLimits(-1, 2))])
    >>> motion_limits(arm, velocity=1.5).middle.tolist()
    [0.5]
    """
    require_type(robot, RobotModel, "robot")
    names, own = robot.joint_names, limits_with_followers(robot.joints)
    span = {
        joint.name: _own_range(replace(joint, limits=limits))
        for joint, limits in zip(robot.driven, own, strict=True)
    }
    position = {} if position is None else position
    require_known(position, names, "limits: position: no joint")
    span |= position
    unlimited = [np.inf] * len(names)
    return MotionLimits(
        joints=names,
        lower=np.array([span[name][0] for name in names]),
        upper=np.array([span[name][1] for name in names]),
        velocity=_each(velocity, [x.velocity for x in own], names, "velocity"),
        acceleration=_each(acceleration, unlimited, names, "acceleration"),
        jerk=_each(jerk, unlimited, names, "jerk"),
        effort=_each(effort, [x.effort for x in own], names, "effort"),
        effort_rate=_each(effort_rate, unlimited, names, "effort_rate"),
        effort_rms=_each(effort_rms, unlimited, names, "effort_rms"),
    )


def _own_range(joint: Joint) -> tuple[float, float]:
    low, high = joint.limits.lower, joint.limits.upper
    if joint.kind == "continuous" and not np.isfinite([low, high]).all():
        return -np.pi, np.pi
    return low, high


def _each(
    given: ArrayLike | Mapping[str, float] | None,
    own: list[float],
    names: tuple[str, ...],
    what: str,
) -> Vector:
    """Return one number per joint, from any of the input forms."""
    if given is None:
        return np.array(own)
    if isinstance(given, Mapping):
        require_known(given, names, f"limits: {what}: no joint")
        return np.array(
            [given.get(n, value) for n, value in zip(names, own, strict=True)]
        )
    values = np.asarray(given, dtype=float)
    if values.shape not in ((), (len(names),)):
        raise ProblemError(
            f"limits: {what} has shape {values.shape}, expected one number or "
            f"{len(names)}"
        )
    return np.broadcast_to(values, (len(names),))
