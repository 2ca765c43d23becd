"""Robots made of others: joints locked, the chain from base to tip, free bodies.

Joints of limbs that mirror each other probably have motors of one type.  Limbs are
alike if their joints have the same names but for the side, the same kinds, and the same
geometry but for signs: a mirror changes signs of positions and axes only.
"""

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import FixedPlace, snapped, turn
from consistent_id.robot.model import (
    Datasheet,
    FixedFrame,
    Joint,
    Link,
    RobotModel,
    followers_at,
)
from consistent_id.robot.parameters import did_you_mean

_log = logging.getLogger(__name__)

FLOATING = "floating"
"""The base of a robot whose root link moves freely, where no link has this name."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The joints of a robot that move; see `load_urdf` for the fields."""

    base: str | None = None
    tip: str | None = None
    joints: Sequence[str] | None = None
    locked: Mapping[str, float] | None = None

    def moves(self, joint: str) -> bool:
        """Return whether a joint, if it is on the chain, is neither locked nor left."""
        kept = self.joints is None or joint in self.joints
        return kept and joint not in (self.locked or {})

    def floating(self, links: Iterable[str]) -> bool:
        """Return whether the root link is to move freely, given all links' names."""
        return self.base == FLOATING and FLOATING not in links

    def with_locked(self, positions: Mapping[str, float]) -> "Selection":
        """Return the selection with more locked joints."""
        return replace(self, locked={**positions, **(self.locked or {})})


def selected(robot: RobotModel, selection: Selection) -> RobotModel:
    """Return the robot with the joints that were selected.

    Raises
    ------
    ModelError
        If a name is unknown, or nothing that moves is left.
    """
    wanted, locked = selection.joints or (), selection.locked or {}
    every = _every(robot)
    for name in (*locked, *wanted):
        if name not in every:
            near = did_you_mean(name, every)
            raise ModelError(
                f"robot {robot.name!r}: no joint {name!r} to keep or lock; {near}"
            )
    leaders = {joint.name: joint.mimic.joint for joint in robot.joints if joint.mimic}
    for name in wanted:
        if name in leaders and not selection.moves(leaders[name]):
            raise ModelError(
                f"robot {robot.name!r}: joint {name!r} is kept, but follows "
                f"{leaders[name]!r}; keep that one, too"
            )
        if name in locked:
            raise ModelError(
                f"robot {robot.name!r}: joint {name!r} is both kept and locked"
            )
    still = {
        joint.name: locked.get(joint.name, 0.0)
        for joint in robot.joints
        if joint.name in locked or (joint.driven and not selection.moves(joint.name))
    }
    part = chain(held(robot, still), base=selection.base, tip=selection.tip)
    for name in wanted:
        if name not in _every(part):
            raise ModelError(
                f"robot {robot.name!r}: joint {name!r} is kept, but is not between "
                f"base {selection.base!r} and tip {selection.tip!r}"
            )
    return part


def held(robot: RobotModel, positions: Mapping[str, float]) -> RobotModel:
    """Return the robot with some joints at rest at `positions` [rad or m].

    The links behind such a joint become part of the link that carries the joint:
    nominal parameters, masses and centres of mass are combined.  Bounds of either part
    do not bound the whole, and are dropped.  Joints that follow one at rest are at rest
    too.

    Parameters
    ----------
    robot : RobotModel
    positions : mapping of str to float, [rad or m]
        By joint.

    Raises
    ------
    ModelError
        If a position is not finite, or no joint is left.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 1), DHRow(0, 1)])
    >>> part = held(arm, {"joint2": 0.5})
    >>> part.joint_names, part.links[0].merged[0].name
    (('joint1', 'joint3'), 'link2')
    """
    if not positions:
        return robot
    positions = dict(positions)
    following = followers_at(robot.joints, positions)
    if following:
        _log.warning("robot %r: %s", robot.name, _said_to_follow(following))
    positions |= following
    held_base = not robot.floating or robot.joints[0].name in positions
    if held_base and set(robot.joint_names) <= positions.keys():
        raise ModelError(
            f"robot {robot.name!r}: every joint is locked, so nothing moves"
        )
    joints: list[Joint] = []
    parts: list[list[_MovingPart]] = [[]]  # of the ground, then of each link
    places = {-1: FixedPlace(-1, np.eye(3), np.zeros(3))}
    for k, (joint, link) in enumerate(zip(robot.joints, robot.links, strict=True)):
        place = places[joint.parent].beyond(joint.rotation, joint.translation)
        if joint.name in positions:
            place = place.beyond(*_motion(joint, positions[joint.name]))
        else:
            where = (place.rotation, place.translation)
            joints.append(_placed(joint, place.link, *where))
            place = FixedPlace(len(joints) - 1, np.eye(3), np.zeros(3))
            parts.append([])
        places[k] = place
        parts[place.link + 1].append(_MovingPart(link, place))
    ground = tuple(frame for part in parts[0] for frame in part.frames)
    return replace(
        robot,
        joints=tuple(joints),
        links=tuple(_merged(of_link) for of_link in parts[1:]),
        ground=robot.ground + ground,
    )


def chain(
    robot: RobotModel, *, base: str | None = None, tip: str | None = None
) -> RobotModel:
    """Return the robot between two links.

    Parameters
    ----------
    robot : RobotModel
    base : str, optional
        This link and all that carry it stand still, their joints at zero; links that it
        does not carry are dropped.
    tip : str, optional
        Links that do not carry this one are dropped.  Links fixed to a kept link stay
        part of it.

    Raises
    ------
    ModelError
        If a link is unknown, or no moving joint is between the two.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 1), DHRow(0, 1)])
    >>> chain(arm, base="link1", tip="link2").joint_names
    ('joint2',)
    """
    start = -1 if base is None else robot.carrier(base)
    end = None if tip is None else robot.carrier(tip)
    kept = [
        k
        for k in (range(len(robot.joints)) if end is None else _path(robot, end))
        if start < 0 or (k != start and start in _path(robot, k))
    ]
    if not kept:
        raise ModelError(
            f"robot {robot.name!r}: no moving joint between base {base!r} and tip "
            f"{tip!r}"
        )
    names = [robot.joints[k].name for k in kept]
    below = [] if start < 0 else _path(robot, start)
    still = {robot.joints[k].name: 0.0 for k in below}
    robot = held(robot, still | _without_leader(robot, names))
    return _only(robot, [name for name in names if name in _every(robot)])


@lru_cache(maxsize=64)
def branches_with(robot: RobotModel, joints: tuple[str, ...]) -> RobotModel:
    """Return a robot's branches from the base on which some joints are.

    Torque of other branches does not depend on the motion of these joints.  A branch
    has also the joints that follow one of its own, or that one of its own follows; a
    floating base has one branch.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 1)])
    >>> branches_with(arm, ("joint2",)) is arm
    True
    """
    roots: list[int] = []
    for k, joint in enumerate(robot.joints):
        roots.append(k if joint.parent < 0 else roots[joint.parent])
    of = dict(zip(_every(robot), roots, strict=True))
    for joint in robot.joints:
        if joint.mimic is not None:  # its branch and its leader's become one
            one, other = of[joint.name], of[joint.mimic.joint]
            of = {name: one if root == other else root for name, root in of.items()}
    wanted = {of[name] for name in joints}
    names = [name for name in _every(robot) if of[name] in wanted]
    return robot if len(names) == len(robot.joints) else _only(robot, names)


def free_bodies(
    name: str, bodies: Mapping[str, InertialParameters | None]
) -> RobotModel:
    """Return a robot of bodies that are not connected, for a regressor that is given.

    Each body is a link with ten parameters in a frame of its own.

    Parameters
    ----------
    name : str
    bodies : mapping of str to InertialParameters or None
        Nominal parameters by link, where they are known.

    Examples
    --------
    >>> pair = free_bodies("pair", {"upper": None, "lower": None})
    >>> pair.link_names, len(pair), pair.connected
    (('upper', 'lower'), 0, False)
    """
    joints = tuple(
        Joint(f"{link}_free", "free", -1, np.eye(3), np.zeros(3), np.eye(3)[2])
        for link in bodies
    )
    links = tuple(
        Link(link, nominal, Datasheet() if nominal is None else _sheet_of_body(nominal))
        for link, nominal in bodies.items()
    )
    return RobotModel(name, joints, links)


@dataclass(frozen=True, slots=True, eq=False)
class _MovingPart:
    """A link of the robot as it was, in its place on one of the robot as it will be."""

    link: Link
    place: FixedPlace

    @property
    def nominal(self) -> InertialParameters | None:
        body = self.link.nominal
        where = (self.place.rotation, self.place.translation)
        return None if body is None else body.transformed(*where)

    @property
    def mass(self) -> float | None:
        """Mass of the datasheet; zero where the nominal one is zero."""
        sheet, body = self.link.datasheet, self.link.nominal
        massless = body is not None and body.mass == 0.0
        return 0.0 if sheet.mass is None and massless else sheet.mass

    @property
    def com(self) -> Vector | None:
        com = self.link.datasheet.com
        place = self.place
        return None if com is None else place.rotation @ com + place.translation

    @property
    def frames(self) -> Iterable[FixedFrame]:
        own = FixedFrame(self.link.name, np.eye(3), np.zeros(3))
        for frame in (own, *self.link.merged):
            place = self.place.beyond(frame.rotation, frame.translation)
            yield FixedFrame(frame.name, snapped(place.rotation), place.translation)


def _said_to_follow(following: Mapping[str, float]) -> str:
    """Return the joints that follow joints at rest, with their positions, in words."""
    if len(following) == 1:
        ((name, position),) = following.items()
        return (
            f"joint {name!r} follows one that does not move; it is locked at "
            f"{position:.6g}"
        )
    places = ", ".join(f"{name!r} at {at:.6g}" for name, at in following.items())
    return f"{len(following)} joints follow ones that do not move; locked: {places}"


def _motion(joint: Joint, position: float) -> tuple[Matrix, Vector]:
    if not np.isfinite(position):
        raise ModelError(f"joint {joint.name!r} is locked at {position}")
    if joint.kind == "free" and position != 0.0:
        raise ModelError(
            f"joint {joint.name!r} is free; locked, it stands at 0, not at {position:g}"
        )
    if joint.kind == "revolute" and abs(position) > 2.0 * np.pi:
        raise ModelError(
            f"joint {joint.name!r} is locked at {position:g} rad, more than a full "
            "turn. If these are degrees, convert them"
        )
    if joint.kind == "prismatic":
        return np.eye(3), position * joint.axis
    return turn(joint.axis, position), np.zeros(3)


def _placed(joint: Joint, parent: int, rotation: Matrix, translation: Vector) -> Joint:
    return replace(
        joint, parent=parent, rotation=snapped(rotation), translation=translation
    )


def _merged(parts: list[_MovingPart]) -> Link:
    first, *others = parts
    if not others:
        return first.link
    nominals = [part.nominal for part in parts]
    bodies = [body.vector for body in nominals if body is not None]
    whole = len(bodies) == len(parts)
    nominal = InertialParameters(np.sum(bodies, axis=0)) if whole else None
    frames = tuple(frame for part in others for frame in part.frames)
    merged = first.link.merged + frames
    return Link(first.link.name, nominal, _sheet(parts), merged)


def _sheet(parts: list[_MovingPart]) -> Datasheet:
    masses = [part.mass for part in parts]
    total = 0.0
    for mass in masses:
        if mass is None:
            return Datasheet()
        total += mass
    if total == 0.0:
        return Datasheet()
    moment = np.zeros(3)
    for mass, part in zip(masses, parts, strict=True):
        if mass:
            if part.com is None:
                return Datasheet(mass=total)
            moment += mass * part.com
    return Datasheet(mass=total, com=moment / total)


def _path(robot: RobotModel, k: int) -> list[int]:
    """Links from the base to link ``k``."""
    path: list[int] = []
    while k >= 0:
        path.insert(0, k)
        k = robot.joints[k].parent
    return path


def _every(robot: RobotModel) -> list[str]:
    """Names of all joints, also of those that follow others."""
    return [joint.name for joint in robot.joints]


def _without_leader(robot: RobotModel, names: list[str]) -> dict[str, float]:
    """Return the positions of joints whose leader, at zero, is not among the named."""
    return {
        joint.name: joint.mimic.position(0.0)
        for joint in robot.joints
        if joint.mimic is not None
        and joint.name in names
        and joint.mimic.joint not in names
    }


def _only(robot: RobotModel, names: list[str]) -> RobotModel:
    """Drop all joints but the named ones, none of which another one carries."""
    kept = [_every(robot).index(name) for name in names]
    place = {old: new for new, old in enumerate(kept)} | {-1: -1}
    return replace(
        robot,
        joints=tuple(
            replace(robot.joints[k], parent=place[robot.joints[k].parent]) for k in kept
        ),
        links=tuple(robot.links[k] for k in kept),
    )


def _sheet_of_body(nominal: InertialParameters) -> Datasheet:
    if nominal.mass <= 0.0:
        return Datasheet()
    return Datasheet(mass=nominal.mass, com=nominal.com)


_SIDES = frozenset(
    "l r left right f b front back rear hind fl fr rl rr lf rf lh rh lb rb bl br hl hr "
    "lm rm ml mr mid middle".split()
)
"""Parts of names that say which limb of several a joint belongs to."""

_ALIKE = 1e-3  # m, and of unit vectors: lengths and axes of equal limbs differ less


def mirrored_motors(robot: RobotModel) -> tuple[tuple[str, ...], ...]:
    """Return groups of joints at the same place of limbs that mirror each other.

    Only driven joints are in them; a joint without a counterpart is in none.
    """
    limbs = _limbs(robot)
    groups: dict[tuple[str, ...], list[list[int]]] = {}
    for limb in limbs:
        names = tuple(without_side(robot.joints[k].name) for k in limb)
        groups.setdefault(names, []).append(limb)
    found: list[tuple[str, ...]] = []
    for alike in groups.values():
        first = alike[0]
        same = [first, *(other for other in alike[1:] if _mirror(robot, first, other))]
        if len(same) < 2:
            continue
        for place in range(len(first)):
            joints = [robot.joints[limb[place]] for limb in same]
            if all(joint.driven for joint in joints):
                found.append(tuple(joint.name for joint in joints))
    return tuple(found)


def without_side(name: str) -> str:
    """Return a joint's name without the parts that say which limb it is of."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", name)
    parts = [part for part in re.split(r"[^A-Za-z0-9]+", spaced) if part]
    return "_".join(p for part in parts if (p := part.lower()) not in _SIDES)


def _limbs(robot: RobotModel) -> list[list[int]]:
    """Return the joints of each limb, parents first, in the order of the robot.

    A limb begins at the base, or where the links that carry others branch.
    """
    children: dict[int, list[int]] = {}
    for k, joint in enumerate(robot.joints):
        children.setdefault(joint.parent, []).append(k)
    starts = [
        k
        for k, joint in enumerate(robot.joints)
        if joint.kind != "free" and len(children[joint.parent]) > 1
    ]
    limbs = []
    for start in starts:
        limb = [start]
        while len(after := children.get(limb[-1], [])) == 1:
            limb.append(after[0])
        limbs.append(limb)
    return limbs


def _mirror(robot: RobotModel, one: Sequence[int], other: Sequence[int]) -> bool:
    """Return whether two limbs have equal geometry but for signs."""
    first, second = ([robot.joints[k] for k in limb] for limb in (one, other))
    if [joint.kind for joint in first] != [joint.kind for joint in second]:
        return False
    for place, (a, b) in enumerate(zip(first, second, strict=True)):
        if not np.allclose(
            abs(a.rotation @ a.axis), abs(b.rotation @ b.axis), atol=_ALIKE
        ):
            return False
        # Where limbs are attached is free: arms may hang at different heights.
        if place and not np.allclose(
            abs(a.translation), abs(b.translation), atol=_ALIKE
        ):
            return False
    return True


def last_links(robot: RobotModel) -> list[Link]:
    """Return the moving links that carry no other link."""
    carrying = {joint.parent for joint in robot.joints}
    return [link for k, link in enumerate(robot.links) if k not in carrying]
