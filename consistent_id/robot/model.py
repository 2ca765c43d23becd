"""The robot: a tree of joints and links, with what the datasheet says of them.

A joint may follow another one (`Mimic`): one generalised coordinate then moves both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Self, get_args

import numpy as np

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    array_default,
    freeze,
    freeze_arrays,
    frozen,
)
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.parameters import require_known, require_writable

JointKind = Literal["revolute", "continuous", "prismatic", "free"]

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
_ORTHONORMAL = 1e-9  # entries of R^T R - 1; what a double rotation chain accumulates


@brief
@dataclass(frozen=True, slots=True)
class JointLimits:
    """Bounds of a joint's motion; infinite where the source states none.

    `lower`, `upper` in rad or m, `velocity` in rad/s or m/s, `effort` in N m or N.
    """

    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf

    def __post_init__(self) -> None:
        if not self.lower <= self.upper:
            raise ModelError(f"joint limits: lower {self.lower} > upper {self.upper}")
        for name in ("velocity", "effort"):
            if not getattr(self, name) >= 0.0:
                raise ModelError(f"joint limits: {name} is {getattr(self, name)} < 0")


@brief
@dataclass(frozen=True, slots=True)
class Mimic:
    """The leader of a joint: ``q = multiplier q_leader + offset``.

    Such a joint has no drive of its own.  The torque of its links acts on its leader,
    `multiplier` times (virtual power).

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


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A joint that turns about, or slides along, a fixed axis; or a free one.

    A free joint moves its link in all six directions: the base of a robot that stands,
    walks or flies.  It has no drive, and is no generalised coordinate: its motion is
    given beside those of the others, see `BaseMotion`.

    Parameters
    ----------
    name : str
    kind : {"revolute", "continuous", "prismatic", "free"}
    parent : int
        Index of the link that carries the joint; -1 for the base.
    rotation : array_like, shape (3, 3)
        Orientation of the joint frame in the parent link's frame.
    translation : array_like, shape (3,), [m]
        Origin of the joint frame in the parent link's frame.
    axis : array_like, shape (3,)
        Unit vector in the joint frame, which moves with the child link; of a free
        joint it means nothing.
    limits : JointLimits
    mimic : Mimic, optional
        The joint that this one follows, if it does not move by itself.
    """

    name: str
    kind: JointKind
    parent: int
    rotation: Matrix
    translation: Vector
    axis: Vector
    limits: JointLimits = field(default_factory=JointLimits)
    mimic: Mimic | None = None

    def __post_init__(self) -> None:
        where = f"joint {self.name!r}"
        if self.kind not in get_args(JointKind):
            known = ", ".join(get_args(JointKind))
            raise ModelError(f"{where}: kind {self.kind!r}, expected one of {known}")
        rotation = _rotation(self.rotation, where)
        axis = frozen(self.axis, (3,), f"{where}: axis", ModelError)
        length = np.linalg.norm(axis)
        if length == 0.0:
            raise ModelError(f"{where}: axis is zero, expected a direction")
        freeze_arrays(self, {"translation": (3,)}, where, ModelError)
        freeze(self, rotation=rotation, axis=frozen(axis / length, (3,), "axis"))
        if self.kind == "free" and self.parent >= 0:
            raise ModelError(
                f"{where} is free, but link {self.parent} carries it; only the base of "
                "a robot is free"
            )

    @property
    def driven(self) -> bool:
        """Whether the joint is a generalised coordinate: neither follower nor free."""
        return self.mimic is None and self.kind != "free"


def _rotation(matrix: Matrix, where: str) -> Matrix:
    rotation = frozen(matrix, (3, 3), f"{where}: rotation", ModelError)
    if abs(rotation.T @ rotation - np.eye(3)).max() > _ORTHONORMAL:
        raise ModelError(f"{where}: rotation is not orthonormal")
    if np.linalg.det(rotation) < 0.0:
        raise ModelError(f"{where}: rotation is a reflection (determinant -1)")
    return rotation


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Datasheet:
    """Prior knowledge of a link.

    Parameters
    ----------
    mass : float, optional, [kg]
    mass_bounds : (float, float), optional, [kg]
    com : array_like, shape (3,), optional, [m]
        Centre of mass in the link frame.
    com_box : array_like, shape (2, 3), optional, [m]
        Lower and upper corner of a box that holds the centre of mass.
    """

    mass: float | None = None
    mass_bounds: tuple[float, float] | None = None
    com: Vector | None = None
    com_box: Matrix | None = None

    def __post_init__(self) -> None:
        if self.mass is not None and not 0.0 <= self.mass < np.inf:
            raise ModelError(f"datasheet mass is {self.mass} kg, expected 0 or more")
        if self.mass_bounds is not None:
            low, high = self.mass_bounds
            if not 0.0 <= low <= high:
                raise ModelError(
                    f"datasheet mass bounds are [{low}, {high}] kg, "
                    "expected 0 <= lower <= upper"
                )
        if self.com is not None:
            com = frozen(self.com, (3,), "datasheet com", ModelError)
            freeze(self, com=com)
        if self.com_box is not None:
            box = frozen(self.com_box, (2, 3), "datasheet com_box", ModelError)
            if (box[0] > box[1]).any():
                raise ModelError(f"datasheet com_box: lower {box[0]} > upper {box[1]}")
            freeze(self, com_box=box)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class FixedFrame:
    """The place of a link without a joint of its own, such as a tool.

    `rotation`, shape (3, 3), and `translation`, shape (3,) [m], place the frame in that
    of the link it is fixed to.

    Parameters
    ----------
    name : str
    rotation : array_like, shape (3, 3)
    translation : array_like, shape (3,), [m]
    """

    name: str
    rotation: Matrix
    translation: Vector

    def __post_init__(self) -> None:
        where = f"frame {self.name!r}"
        freeze_arrays(self, {"translation": (3,)}, where, ModelError)
        freeze(self, rotation=_rotation(self.rotation, where))


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A moving body: its name, nominal parameters if known, and datasheet.

    `merged` names the links of the model's file that are fixed to this one, and are
    part of it.
    """

    name: str
    nominal: InertialParameters | None = None
    datasheet: Datasheet = field(default_factory=Datasheet)
    merged: tuple[FixedFrame, ...] = ()


class Transmission(NamedTuple):
    """The coordinate of a joint: ``q_joint = ratio q[coordinate] + offset``."""

    coordinate: int
    ratio: float
    offset: float


@brief
@dataclass(frozen=True, slots=True, eq=False)
class RobotModel:
    """An immutable tree of moving links; joint ``k`` moves link ``k``.

    Fixed joints are merged when a model is loaded, so every link here moves.  Its
    generalised coordinates, and its length, are the joints that move by themselves;
    the others follow them (`Joint.mimic`).

    Parameters
    ----------
    name : str
    joints : tuple of Joint
        Parents come before their children.
    links : tuple of Link
    gravity : array_like, shape (3,), [m/s^2]
        Gravitational acceleration in the base frame.
    ground : tuple of FixedFrame
        Links of the model's file that do not move.

    Attributes
    ----------
    driven, joint_names : tuple
        Joints that move by themselves, the generalised coordinates; and their names.

    Raises
    ------
    ModelError
        If names repeat or have control characters, a parent does not precede its child,
        a joint follows none that moves by itself, or nothing moves.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> len(arm), arm.joint_names, arm.link_names
    (1, ('joint1',), ('link1',))
    """

    name: str
    joints: tuple[Joint, ...]
    links: tuple[Link, ...]
    gravity: Vector = array_default(STANDARD_GRAVITY)
    ground: tuple[FixedFrame, ...] = ()
    driven: tuple[Joint, ...] = field(init=False, repr=False)
    joint_names: tuple[str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.joints:
            raise ModelError(f"robot {self.name!r} has no moving joint")
        if len(self.joints) != len(self.links):
            raise ModelError(
                f"robot {self.name!r}: {len(self.joints)} joints, but "
                f"{len(self.links)} links; each joint moves one link"
            )
        every = tuple(joint.name for joint in self.joints)
        for what, names in (("joint", every), ("link", self.link_names)):
            require_writable(names, f"robot {self.name!r}: {what}", ModelError)
            repeated = sorted({name for name in names if names.count(name) > 1})
            if repeated:
                raise ModelError(f"robot {self.name!r}: {what} names repeat {repeated}")
        for k, joint in enumerate(self.joints):
            if not -1 <= joint.parent < k:
                raise ModelError(
                    f"joint {joint.name!r} (index {k}) has parent link {joint.parent}, "
                    "expected one that comes before it"
                )
        free = [joint.kind == "free" for joint in self.joints]
        if any(free[1:]) and not all(free):
            second = self.joints[1 + free[1:].index(True)].name
            raise ModelError(
                f"robot {self.name!r}: joint {second!r} is free; only the first joint "
                "of a robot is, or all joints of bodies that are not connected"
            )
        _require_leaders(self.joints)
        gravity = frozen(self.gravity, (3,), "gravity", ModelError)
        driven = tuple(joint for joint in self.joints if joint.driven)
        names = tuple(joint.name for joint in driven)
        freeze(self, gravity=gravity, driven=driven, joint_names=names)

    def __len__(self) -> int:
        return len(self.driven)

    @property
    def floating(self) -> bool:
        """Whether the base moves freely; it is then the first link."""
        return self.joints[0].kind == "free"

    @property
    def connected(self) -> bool:
        """Whether all links are of one tree, so that their motion can be computed."""
        return sum(joint.kind == "free" for joint in self.joints) <= 1

    @property
    def transmissions(self) -> tuple[Transmission, ...]:
        """Transmission of each of `joints`: a coordinate, its ratio and an offset."""
        return transmissions(self.joints)

    @property
    def joint_rates(self) -> Matrix:
        """``G`` with ``dq_joints = G dq``, shape (joints, coordinates)."""
        G = np.zeros((len(self.joints), len(self)))
        for row, moved in zip(G, self.transmissions, strict=True):
            if moved.ratio:
                row[moved.coordinate] = moved.ratio
        return G

    def joint_positions(self, q: Array) -> Array:
        """Return positions of all joints from those of the coordinates.

        Parameters
        ----------
        q : ndarray, shape (samples, coordinates), [rad or m]

        Returns
        -------
        ndarray, shape (samples, joints)
        """
        offsets = [moved.offset for moved in self.transmissions]
        return q if len(self) == len(self.joints) else q @ self.joint_rates.T + offsets

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the moving links, in order."""
        return tuple(link.name for link in self.links)

    @property
    def nominal(self) -> Array | None:
        """Nominal inertial parameters, shape (10 links,), or None if any is unknown."""
        known = [link.nominal.vector for link in self.links if link.nominal is not None]
        return np.concatenate(known) if len(known) == len(self.links) else None

    def with_datasheet(self, datasheets: dict[str, Datasheet]) -> Self:
        """Return the model with the datasheets of the named links replaced.

        Raises
        ------
        ModelError
            If a name is not that of a moving link.
        """
        require_known(datasheets, self.link_names, "no moving link named", ModelError)
        if not datasheets:
            return self
        links = tuple(
            replace(link, datasheet=datasheets.get(link.name, link.datasheet))
            for link in self.links
        )
        return replace(self, links=links)

    def carrier(self, name: str) -> int:
        """Return the index of the moving link that `name` is, or is fixed to.

        It is -1 for links that do not move.

        Raises
        ------
        ModelError
            If the model has no such link.
        """
        carriers = {frame.name: -1 for frame in self.ground}
        for k, link in enumerate(self.links):
            carriers |= {frame.name: k for frame in link.merged}
        carriers |= {link: k for k, link in enumerate(self.link_names)}
        what = f"robot {self.name!r}: no link named"
        require_known([name], carriers, what, ModelError)
        return carriers[name]


def _require_leaders(joints: Sequence[Joint]) -> None:
    """Refuse joints that follow what is no joint, or follows another one itself.

    Raises
    ------
    ModelError
        With the joint's name.
    """
    driven = [joint.name for joint in joints if joint.driven]
    for joint in joints:
        if joint.mimic is not None:
            what = f"joint {joint.name!r} has to follow one that moves by itself, not"
            require_known([joint.mimic.joint], driven, what, ModelError)


def transmissions(joints: Sequence[Joint]) -> tuple[Transmission, ...]:
    """Return the leader of each joint; joints without `Mimic` are the coordinates.

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


def followers_at(
    joints: Sequence[Joint], positions: dict[str, float]
) -> dict[str, float]:
    """Return the places of joints that follow one of those at `positions`."""
    return {
        joint.name: joint.mimic.position(positions[joint.mimic.joint])
        for joint in joints
        if joint.mimic is not None
        and joint.mimic.joint in positions
        and joint.name not in positions
    }


def limits_with_followers(joints: Sequence[Joint]) -> tuple[JointLimits, ...]:
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
            narrowed[leader] = _narrowed(narrowed[leader], joint, joint.mimic)
    return tuple(narrowed.values())


def _narrowed(limits: JointLimits, follower: Joint, mimic: Mimic) -> JointLimits:
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
