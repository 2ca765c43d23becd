"""A robot's surroundings, pairs that must stay apart, and bounds of their approach.

The change of the distance of two bodies while joints move a little is bounded: if one
joint turns by ``s``, the bodies on its far side turn rigidly about its axis, or, seen
from them, those on its near side.  So the distance of two bodies on different sides
changes by at most ``s min(R_a, R_b)``, with ``R`` the largest distance of a body from
the axis; if the joint slides, by at most ``s``.  For directions, all axes go through
one point, and a sliding joint changes nothing.

Let the joints between bodies a and b move one after another, those next to a first. For
each joint, the reach of b is as before, and that of a has grown by at most the motion
of the joints before it:

    change <= sum_j s_j min(R_bj, R_aj + sum over k before j of s_k R_ak).

The final position does not depend on the order, so the bound is also valid for joints
that move together, and for the opposite order; the smaller of the two bounds is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, freeze
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import Body
from consistent_id.robot.kinematics import (
    FixedPlace,
    LinkPlaces,
    ancestors,
    fixed_place,
)
from consistent_id.robot.model import RobotModel

NEIGHBOURS = "neighbours, whose shapes overlap at their joint by design"
"""Pairs of bodies that one joint connects, and why they are not checked."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two bodies of a scene, by their indices, and their required distance.

    `wanted` in m: the bodies' distance may not be less at any time.
    """

    first: int
    second: int
    wanted: float = 0.0


@dataclass(frozen=True, slots=True)
class PairNote:
    """Two bodies that are not checked, or not as requested, and the reason.

    `wanted` says that the user named the pair: it may touch.
    """

    first: str
    second: str
    watched: bool
    reason: str
    wanted: bool = False

    def __str__(self) -> str:
        how = "watched" if self.watched else "not watched"
        return f"{self.first} and {self.second}, {how}: {self.reason}"


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A robot's bodies, its obstacles, and the pairs that must stay apart.

    `build_scene` and `scene_from_urdf` choose the pairs.

    Parameters
    ----------
    robot : RobotModel
    bodies : tuple of Body
    pairs : tuple of Pair
    notes : tuple of PairNote
        Pairs that are not checked, except those on one link or adjacent ones.
    dropped : tuple of (str, str)
        Links of the file that are not checked, and the reasons.
    swept : tuple of str
        Links that hang on joints which the robot model does not have; their bodies
        cover all positions of these joints.
    adjacent : tuple of (str, str)
        Neighbours: the robot's bodies on links that one joint connects, not checked.

    Attributes
    ----------
    carried : CarriedBodies
        What is the same of the bodies in all poses.
    """

    robot: RobotModel
    bodies: tuple[Body, ...]
    pairs: tuple[Pair, ...]
    notes: tuple[PairNote, ...] = ()
    dropped: tuple[tuple[str, str], ...] = ()
    swept: tuple[str, ...] = ()
    adjacent: tuple[tuple[str, str], ...] = ()
    carried: "CarriedBodies" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("bodies", "pairs", "notes", "dropped", "swept", "adjacent"):
            freeze(self, **{name: tuple(getattr(self, name))})
        names = [body.name for body in self.bodies]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ProblemError(f"scene: names of bodies repeat: {', '.join(twice)}")
        for pair in self.pairs:
            if not (0 <= pair.first < len(names) and 0 <= pair.second < len(names)):
                raise ProblemError(f"scene: {pair} of {len(names)} bodies")
            if self.bodies[pair.first].turning != self.bodies[pair.second].turning:
                raise ProblemError(
                    f"scene: {names[pair.first]!r} and {names[pair.second]!r}: a "
                    f"direction and a position have no distance"
                )
            if not 0.0 <= pair.wanted < np.inf:
                raise ProblemError(
                    f"scene: required distance of {names[pair.first]!r} and "
                    f"{names[pair.second]!r} is {pair.wanted} m, expected 0 or more"
                )
        freeze(self, carried=_carried_bodies(self.robot, self.bodies))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Pairs that are not checked, with reasons, as sentences."""
        adjacent = (
            f"{NEIGHBOURS}, are not checked; only the range of that joint keeps them "
            f"apart: {'; '.join(' and '.join(names) for names in self.adjacent)}"
        )
        return (
            *([adjacent] if self.adjacent else []),
            *(str(note) for note in self.notes),
            *(
                f"link {name} hangs on a joint that does not belong to the motion; it "
                "is kept off at all positions of that joint"
                for name in self.swept
            ),
            *(f"link {name} is not checked: {why}" for name, why in self.dropped),
        )

    @property
    def left_out(self) -> tuple[tuple[str, str, str], ...]:
        """Pairs of bodies that are not checked: both names, and the reason."""
        return (
            *((*names, NEIGHBOURS) for names in self.adjacent),
            *((n.first, n.second, n.reason) for n in self.notes if not n.watched),
        )

    @property
    def unchecked(self) -> tuple[str, ...]:
        """Bodies and pairs that could not be checked, with reasons.

        Pairs that one joint connects are not among them, nor those that may touch.
        """
        links = (f"link {name} ({why})" for name, why in self.dropped)
        pairs = (
            f"{note.first} and {note.second} ({note.reason})"
            for note in self.notes
            if not note.watched and not note.wanted
        )
        return (*links, *pairs)

    def names(self, pair: Pair) -> tuple[str, str]:
        """Return the names of a pair's bodies."""
        return self.bodies[pair.first].name, self.bodies[pair.second].name


def kept_off(scene: Scene, body: Body, others: Sequence[Body], where: str) -> Scene:
    """Return a scene with a body of the robot and others that it must not touch.

    Raises
    ------
    ModelError
        If the robot has no such link.
    ProblemError
        If the body's link does not move; `where` begins the message.
    """
    if place_of(scene.robot, body).link < 0:
        raise ProblemError(f"{where}: this link does not move")
    first = len(scene.bodies)
    pairs = (Pair(first, first + 1 + k) for k in range(len(others)))
    return replace(
        scene,
        bodies=(*scene.bodies, body, *others),
        pairs=(*scene.pairs, *pairs),
    )


@dataclass(frozen=True, slots=True, eq=False)
class BodyPlaces:
    """The positions of a scene's bodies, at many poses.

    Attributes
    ----------
    bodies : tuple of Body
    links : LinkPlaces
    carriers : tuple of int
        The link that carries each body; -1 for none.
    rotation : ndarray, shape (samples, bodies, 3, 3)
    translation : ndarray, shape (samples, bodies, 3), [m]
    centre : ndarray, shape (samples, bodies, 3), [m]
        Centre of a ball around each body.
    radius : ndarray, shape (bodies,), [m]
    turning : ndarray of bool, shape (bodies,)
        Whether only the link's orientation moves it.
    """

    bodies: tuple[Body, ...]
    links: LinkPlaces
    carriers: tuple[int, ...]
    rotation: Array
    translation: Array
    centre: Array
    radius: Array
    turning: BoolArray


def body_places(scene: Scene, links: LinkPlaces) -> BodyPlaces:
    """Return the positions of the bodies for given positions of the links."""
    n, bodies = len(links), len(scene.bodies)
    rotation, translation = np.empty((n, bodies, 3, 3)), np.empty((n, bodies, 3))
    fixed = scene.carried
    for b, place in enumerate(fixed.places):
        frame = links.of(place)
        rotation[:, b], translation[:, b] = frame.rotation, frame.translation
        if scene.bodies[b].turning and place.link >= 0:
            translation[:, b] -= links.translation[:, place.link]
    return BodyPlaces(
        bodies=scene.bodies,
        links=links,
        carriers=fixed.carriers,
        rotation=rotation,
        translation=translation,
        centre=np.einsum("nbij,bj->nbi", rotation, fixed.middle) + translation,
        radius=fixed.radius,
        turning=fixed.turning,
    )


class CarriedBodies(NamedTuple):
    """What is the same of a scene's bodies in all poses; see `BodyPlaces`.

    Attributes
    ----------
    places : tuple of FixedPlace
        On the links that carry them.
    middle : ndarray, shape (bodies, 3), [m]
        Centres of the balls around them, in their own frames.
    """

    places: tuple[FixedPlace, ...]
    carriers: tuple[int, ...]
    middle: Array
    radius: Array
    turning: BoolArray


def _carried_bodies(robot: RobotModel, bodies: tuple[Body, ...]) -> CarriedBodies:
    places = tuple(place_of(robot, body) for body in bodies)
    balls = [body.shape.ball for body in bodies]
    return CarriedBodies(
        places,
        tuple(place.link for place in places),
        np.array([ball[0] for ball in balls]).reshape(len(bodies), 3),
        np.array([ball[1] for ball in balls]),
        np.array([body.turning for body in bodies], dtype=bool),
    )


def place_of(robot: RobotModel, body: Body) -> FixedPlace:
    """Return a body's pose on the link that carries it, or in the base frame."""
    base = FixedPlace(-1, np.eye(3), np.zeros(3))
    frame = base if body.frame is None else fixed_place(robot, body.frame)
    if body.turning:
        frame = FixedPlace(frame.link, frame.rotation, np.zeros(3))
    return frame.beyond(np.asarray(body.rotation), np.asarray(body.translation))


def joints_between(robot: RobotModel, first: int, second: int) -> tuple[int, ...]:
    """Return the joints by which two links move against each other, in order.

    From the first link, or the base, which is -1, to the second.
    """
    up, down = ancestors(robot, first), ancestors(robot, second)
    return (
        *(joint for joint in up if joint not in down),
        *reversed([joint for joint in down if joint not in up]),
    )


def moving_pairs(scene: Scene) -> BoolArray:
    """Return which coordinates move which pairs' bodies, (pairs, coordinates)."""
    robot = scene.robot
    between = _between(robot, scene.carried.carriers, _ends(scene.pairs))
    return np.asarray(between @ abs(robot.joint_rates) > 0.0)


def _ends(pairs: Sequence[Pair]) -> IntArray:
    """Return the bodies of pairs, shape (pairs, 2)."""
    ends = np.array([(p.first, p.second) for p in pairs], dtype=np.intp)
    return ends.reshape(-1, 2)


def _between(robot: RobotModel, carriers: Sequence[int], ends: IntArray) -> Array:
    """Return 1 where a joint moves a pair's bodies, else 0; shape (pairs, joints).

    These joints move one of the bodies and not the other.
    """
    joints = len(robot.joints)
    moves = np.zeros((joints + 1, joints), dtype=bool)  # the last row: no link at all
    for link in range(joints):
        moves[link, list(ancestors(robot, link))] = True
    first, second = np.asarray(carriers, dtype=np.intp)[ends].T
    return np.asarray(moves[first] ^ moves[second], dtype=float)


def largest_change(
    places: BodyPlaces, pair: Pair, sample: IntArray, steps: Array
) -> Array:
    """Bound the change of a pair's distance while joints move by at most `steps`.

    Parameters
    ----------
    places : BodyPlaces
        Positions at the poses from which the joints move.
    sample : ndarray, shape (queries,)
        Number of the pose.
    steps : ndarray, shape (queries, coordinates), [rad or m], 0 or more
        Largest distance of each joint that moves by itself from its position in the
        pose.

    Returns
    -------
    ndarray, shape (queries,), [m]
    """
    links = places.links
    between = joints_between(
        links.robot, places.carriers[pair.first], places.carriers[pair.second]
    )
    step = _steps(links.robot, steps)[:, between].T
    near = _reaches(places, pair.first, between, sample)
    far = _reaches(places, pair.second, between, sample)
    return np.minimum(
        _moved(step, near, far), _moved(step[::-1], far[::-1], near[::-1])
    )


_ENDLESS = 1e9  # m; reach of a half-space


class PairChange:
    """Bounds of the change of all pairs' distances from one pose to another.

    Of the bounds above, those in which one body's reach is never enlarged:
    ``min(sum_j s_j R_aj, sum_j s_j R_bj)``.
    """

    def __init__(self, places: BodyPlaces, pairs: Sequence[Pair]) -> None:
        self._robot, ends = places.links.robot, _ends(pairs)
        between = _between(self._robot, places.carriers, ends)
        self._joints = np.flatnonzero(between.any(axis=0))
        self._between = between[:, self._joints]
        bodies, own = np.unique(ends, return_inverse=True)
        self._ends = own.reshape(-1, 2)
        self._reach = self._reaches(places, bodies)

    def _reaches(self, places: BodyPlaces, bodies: IntArray) -> Array:
        """Return reaches of bodies from joints' axes, (samples, joints, bodies)."""
        links, still = places.links, np.where(places.turning[bodies], 0.0, 1.0)
        centre, radius = places.centre[:, bodies], places.radius[bodies]
        found = np.empty((len(links), len(self._joints), len(bodies)))
        for k, j in enumerate(self._joints):
            if self._robot.joints[j].kind == "prismatic":
                found[:, k] = still
                continue
            arm = centre - links.translation[:, j, None] * still[:, None]
            along = np.einsum("nbi,ni->nb", arm, links.axis[:, j])
            square = np.einsum("nbi,nbi->nb", arm, arm) - along**2
            found[:, k] = np.sqrt(np.maximum(square, 0.0)) + radius
        return np.minimum(found, _ENDLESS)

    def between(self, q: Array, here: IntArray, there: IntArray) -> Array:
        """Return the bounds for poses ``q[here]`` to ``q[there]``, (poses, pairs)."""
        steps = _steps(self._robot, abs(q[there] - q[here]))[:, self._joints]
        moved = steps[:, :, None] * self._reach[here]  # (poses, joints, bodies)
        sums = [
            np.einsum("njk,kj->nk", moved[:, :, self._ends[:, side]], self._between)
            for side in (0, 1)
        ]
        return np.asarray(np.minimum(*sums))


def _steps(robot: RobotModel, steps: Array) -> Array:
    """Return the steps of all joints, of followers by their leaders' steps."""
    if len(robot) == len(robot.joints):
        return steps
    return np.asarray(steps @ abs(robot.joint_rates).T)


def _moved(step: Array, near: Array, far: Array) -> Array:
    """Change of distance if the joints move in order, shape (queries,)."""
    if np.isinf(near).any():  # a half-space: its reach is infinite
        return np.asarray((step * far).sum(axis=0))
    done = step * near
    before = np.cumsum(done, axis=0) - done
    return np.asarray((step * np.minimum(far, near + before)).sum(axis=0))


def _reaches(
    places: BodyPlaces, body: int, joints: tuple[int, ...], sample: IntArray
) -> Array:
    """Largest distance of a body from joints' axes, shape (joints, queries)."""
    turning = bool(places.turning[body])
    reaches = np.full((len(joints), len(sample)), 0.0 if turning else 1.0)
    for i, joint in enumerate(joints):
        if places.links.robot.joints[joint].kind != "prismatic":
            arm = places.centre[sample, body]
            if not turning:
                arm = arm - places.links.translation[sample, joint]
            off = _off_axis(places.links, joint, sample, arm)
            reaches[i] = off + places.radius[body]
    return reaches


def _off_axis(links: LinkPlaces, joint: int, sample: IntArray, arm: Array) -> Array:
    off = np.linalg.norm(np.cross(arm, links.axis[sample, joint]), axis=1)
    return np.asarray(off)
