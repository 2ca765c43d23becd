"""What a motion on feet asks of a robot, as shares of what it has."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.standing.ground_forces import GroundForces
from consistent_id.excitation.standing.ground_shares import ground_shares
from consistent_id.excitation.standing.stance import JointMotion, Stance
from consistent_id.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class StandingLimits:
    """Limits of a motion on feet, over those of the robot's file.

    Parameters
    ----------
    friction : float
        Coefficient between feet and ground.
    friction_share : float
        Of it, how much may be used.
    least_press : float
        Of its share of the weight, with how much each foot is pressed at least.
    effort_share : float
        Of the effort limits: the rest is for friction in the joints and for the
        controller.
    velocity, effort : float or mapping of str to float, optional
        Of all joints or by name [rad/s or m/s], [N m or N], over the file's.
    """

    friction: float = 0.6
    friction_share: float = 0.7
    least_press: float = 0.2
    effort_share: float = 0.6
    velocity: float | Mapping[str, float] | None = field(default=None, hash=False)
    effort: float | Mapping[str, float] | None = field(default=None, hash=False)

    def __post_init__(self) -> None:
        for name in ("friction", "friction_share", "least_press", "effort_share"):
            value = getattr(self, name)
            top = np.inf if name == "friction" else 1.0
            if not 0.0 < value <= top:
                raise ProblemError(
                    f"{name} is {value}, expected a positive number"
                    + (", at most 1" if top == 1.0 else "")
                )

    def of(self, robot: RobotModel, what: str) -> Vector:
        """Return the limit of each joint: ``velocity`` or ``effort``."""
        given = getattr(self, what)
        driven = [joint for joint in robot.joints if joint.driven]
        own = {joint.name: getattr(joint.limits, what) for joint in driven}
        if given is None:
            return np.array([v if v > 0.0 else np.inf for v in own.values()])
        if isinstance(given, Mapping):
            return np.array([given.get(name, v) for name, v in own.items()])
        return np.array([min(given, v) if v > 0.0 else given for v in own.values()])


@dataclass(frozen=True, slots=True)
class Use:
    """The largest share of a limit that is used, of which, and when [s]."""

    what: str
    of: str
    share: float
    time: float


def uses(
    stance: Stance,
    limits: StandingLimits,
    time: Vector,
    moved: JointMotion,
    ground: GroundForces,
) -> tuple[Use, ...]:
    """Return how much of each limit a motion uses: at most 1, if it keeps it.

    Position counts from the pose of the stance, forces from equal shares of the weight,
    torque from zero.
    """
    robot, names = stance.robot, stance.robot.joint_names
    driven = [joint for joint in robot.joints if joint.driven]
    upper = np.array([joint.limits.upper for joint in driven]) - stance.pose
    lower = np.array([joint.limits.lower for joint in driven]) - stance.pose
    away = moved.q - stance.pose
    room = np.where(away > 0, upper, -lower)
    position = abs(away) / np.where(away == 0.0, 1.0, np.maximum(room, 1e-9))
    speed = abs(moved.dq) / limits.of(robot, "velocity")
    torque = abs(ground.torque) / (limits.effort_share * limits.of(robot, "effort"))
    used = limits.friction_share * limits.friction
    of_feet = ground_shares(stance, ground, used, limits.least_press)
    kinds = dict.fromkeys(one.what for one in of_feet)
    feet = {what: [one for one in of_feet if one.what == what] for what in kinds}
    asked: list[tuple[str, Sequence[str], Matrix]] = [
        ("position", names, position),
        ("velocity", names, speed),
        ("torque", names, torque),
        *(
            (what, [one.foot for one in every], np.array([x.share for x in every]).T)
            for what, every in feet.items()
        ),
    ]
    return tuple(
        _largest(what, of, np.nan_to_num(shares, posinf=1e6), time)
        for what, of, shares in asked
    )


def _largest(what: str, of: Sequence[str], shares: Matrix, time: Vector) -> Use:
    k, j = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return Use(what, of[int(j)], float(shares[k, j]), float(time[k]))
