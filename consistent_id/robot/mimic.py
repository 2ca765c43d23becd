"""Joints that follow others: one generalised coordinate moves several of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.robot.parameters import did_you_mean

if TYPE_CHECKING:
    from consistent_id.robot.model import Joint, JointLimits


@dataclass(frozen=True, slots=True)
class Mimic:
    """What a joint follows: ``q = multiplier q_leader + offset``.

    Such a joint has no drive of its own.  What its link asks of it is felt by its
    leader, `multiplier` times (virtual power).

    Parameters
    ----------
    joint : str
        The leader, which follows no other joint.
    multiplier : float
        Not zero: a joint that does not move is no joint.
    offset : float, [rad or m]

    Examples
    --------
    >>> Mimic("left_finger", -1.0)
    Mimic(joint='left_finger', multiplier=-1.0, offset=0.0)
    """

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.multiplier) and self.multiplier != 0.0):
            raise ModelError(
                f"a joint follows {self.joint!r} with multiplier {self.multiplier}, "
                "expected a finite number but zero; lock the joint instead"
            )
        if not np.isfinite(self.offset):
            raise ModelError(f"a joint follows {self.joint!r} at {self.offset}")

    def __str__(self) -> str:
        shift = f" {self.offset:+.6g}" if self.offset else ""
        return f"{self.multiplier:.6g} {self.joint}{shift}"

    def position(self, leader: float) -> float:
        """Return the joint's position for the leader's."""
        return self.multiplier * leader + self.offset


class Transmission(NamedTuple):
    """What moves a joint: ``q_joint = ratio q[coordinate] + offset``."""

    coordinate: int
    ratio: float
    offset: float


def transmissions(joints: Sequence["Joint"]) -> tuple[Transmission, ...]:
    """Return what moves each joint; joints without `Mimic` are the coordinates.

    No coordinate moves a free joint: its ratio is zero.
    """
    driven = [joint.name for joint in joints if joint.driven]
    found = []
    for joint in joints:
        if (mimic := joint.mimic) is not None:
            leader = driven.index(mimic.joint)
            found.append(Transmission(leader, mimic.multiplier, mimic.offset))
        elif joint.driven:
            found.append(Transmission(driven.index(joint.name), 1.0, 0.0))
        else:
            found.append(Transmission(-1, 0.0, 0.0))
    return tuple(found)


def require_leaders(joints: Sequence["Joint"]) -> None:
    """Refuse joints that follow what is no joint, or follows another one itself.

    Raises
    ------
    ModelError
        With the joint's name.
    """
    driven = [joint.name for joint in joints if joint.driven]
    for joint in joints:
        if joint.mimic is not None and joint.mimic.joint not in driven:
            near = did_you_mean(joint.mimic.joint, driven)
            raise ModelError(
                f"joint {joint.name!r} follows {joint.mimic.joint!r}, expected a joint "
                f"that moves by itself; {near}"
            )


def followers_at(
    joints: Sequence["Joint"], positions: dict[str, float]
) -> dict[str, float]:
    """Return where joints stand that follow one of those at `positions`."""
    return {
        joint.name: joint.mimic.position(positions[joint.mimic.joint])
        for joint in joints
        if joint.mimic is not None
        and joint.mimic.joint in positions
        and joint.name not in positions
    }


def limits_with_followers(joints: Sequence["Joint"]) -> tuple["JointLimits", ...]:
    """Return the limits of the joints that move by themselves.

    They are so narrow that no follower leaves its own range or exceeds its own speed.

    Raises
    ------
    ModelError
        If a follower's range leaves its leader none.
    """
    narrowed = {joint.name: joint.limits for joint in joints if joint.driven}
    for joint in joints:
        if joint.mimic is not None:
            leader = joint.mimic.joint
            narrowed[leader] = _within(narrowed[leader], joint, joint.mimic)
    return tuple(narrowed.values())


def _within(limits: "JointLimits", follower: "Joint", mimic: Mimic) -> "JointLimits":
    from consistent_id.robot.model import JointLimits

    own = follower.limits
    ends = (np.array([own.lower, own.upper]) - mimic.offset) / mimic.multiplier
    lower, upper = max(limits.lower, ends.min()), min(limits.upper, ends.max())
    if lower > upper:
        raise ModelError(
            f"joint {follower.name!r} follows {mimic.joint!r}, but its range "
            f"[{own.lower:g}, {own.upper:g}] leaves that joint's "
            f"[{limits.lower:g}, {limits.upper:g}] no position; correct the limits"
        )
    velocity = min(limits.velocity, own.velocity / abs(mimic.multiplier))
    return JointLimits(float(lower), float(upper), velocity, limits.effort)
