"""Scenes from bodies, or from a robot's file: the choice of pairs."""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.given_values import require_type, require_types
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.bodies import Body, plane
from consistent_id.motion.collisions.farthest import (
    ROOM,
    always_touching,
    farthest_pose,
    not_so_far_apart,
    random_poses,
)
from consistent_id.motion.collisions.hanging import Hanging, file_tree, hanging_bodies
from consistent_id.motion.collisions.scene import (
    Pair,
    PairNote,
    Scene,
    joints_between,
    place_of,
)
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.collisions.urdf_bodies import (
    Elements,
    UrdfShapes,
    urdf_shapes,
)
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

_ALWAYS = 0.95  # share of random poses; a pair that touches in more is not checked
_USUALLY = 0.5  # share of poses; for pairs too near in more, only touching is checked

Connected = Callable[[Body, Body], bool]


def build_scene(
    robot: RobotModel,
    bodies: Iterable[Body],
    *,
    clearance: float = 0.0,
    relax: bool = True,
    extra: Mapping[str, float] | None = None,
    allowed: Sequence[tuple[str, str]] = (),
    connected: Connected = lambda first, second: True,
    poses: int = 200,
    seed: int = 0,
) -> Scene:
    """Return a scene with all pairs of bodies that can come together.

    Some pairs are not checked: bodies on the same link, on links that a single joint
    connects, and bodies of the robot that touch at nearly all random poses; these last
    are listed in `Scene.notes`.  If two bodies of the robot are nearer than required at
    more than half of these poses, only their contact is excluded.  The same is true of
    an obstacle that is nearer than required at all of them.  A distance that was stated
    (``relax=False``) is never relaxed.

    Parameters
    ----------
    robot : RobotModel
    bodies : iterable of Body
        Bodies of the robot, with a frame, and obstacles, without one.
    clearance : float, [m]
        Least distance of any two bodies.
    relax : bool
        Whether two bodies that are nearer at most random poses only must not touch.
        Without, the distance was stated: motion has to be found that keeps it.
    extra : mapping of str to float, optional, [m]
        Additional distance of a body, or of all bodies of a link, from all others: of a
        tool, for instance.
    allowed : sequence of (str, str)
        Pairs of bodies, or of links, that may touch.
    connected : callable
        From two bodies with one moving joint between them to whether it connects them
        directly, so that they are not checked; it does not connect a tool with the link
        before the last joint of the wrist.  By default it connects all such bodies.
    poses : int
        Number of random poses within the joints' limits.
    seed : int
        Seed of these poses.

    Raises
    ------
    ProblemError
        If a name is unknown, or an obstacle touches the robot in every pose, or,
        without `relax`, no pose keeps two bodies as far apart as required; with the
        pose in which they are farthest apart, and their distance there.
    """
    require_type(robot, RobotModel, "robot")
    bodies = tuple(bodies)
    require_types(bodies, Body, "bodies")
    extra_of = _extras(bodies, clearance, extra or {})
    free = {frozenset(names) for names in _expanded(bodies, allowed)}
    pairs, notes = [], []
    for i, j in _movable(robot, bodies, connected):
        names = bodies[i].name, bodies[j].name
        if frozenset(names) in free:
            notes.append(PairNote(*names, False, "may touch, by `allowed`", True))
        else:
            pairs.append(Pair(i, j, clearance + extra_of[i] + extra_of[j]))
    adjacent = _adjacent(robot, bodies, connected)
    scene = Scene(robot, bodies, tuple(pairs), tuple(notes), adjacent=adjacent)
    return _sifted(scene, random_poses(robot, poses, seed), relax) if pairs else scene


def scene_from_urdf(
    path: str | Path,
    robot: RobotModel,
    *,
    package_dirs: Iterable[str | Path] = (),
    elements: Elements = "collision",
    pieces: int = 4,
    ground: float | None = None,
    added: Iterable[Body] = (),
    clearance: float = 0.0,
    relax: bool = True,
    extra: Mapping[str, float] | None = None,
    allowed: Sequence[tuple[str, str]] = (),
    readable_only: bool = False,
) -> Scene:
    """Return a scene of a robot's bodies, from its URDF, and of obstacles.

    A body has the name of its link; if a link has several shapes, they are
    ``link:1``, ``link:2``, ...  Meshes become convex hulls, which are never smaller.

    If the robot is a part of the file's, the other links hang on it: fingers behind its
    tip, another arm.  They are kept off, too, at all positions of the joints that the
    robot does not have; lock these joints to keep off fewer.

    Parameters
    ----------
    path : str or Path
    robot : RobotModel
        Robot of the same file, or a part of it; joints that it locks do not move.
    package_dirs : iterable of str or Path
        Folders in which ``package://name/...`` is searched for as ``name/...``; so are
        the folders above the file.
    elements : {"collision", "visual"}
        Kind of shapes to read; for a link without them, the other kind is read.
    pieces : int
        Most convex pieces of a mesh whose hull is too large; 1 for plain hulls.
    ground : float, optional, [m]
        Height of a level floor above the robot's base frame.
    added : iterable of Body
        Additional bodies, such as obstacles, or a tool that is not in the file.
    clearance, extra, allowed
        See `build_scene`.
    readable_only : bool
        Leave out links whose shapes cannot be read, and those that hang on the robot
        and touch it at all poses; `Scene.unchecked` names them.

    Raises
    ------
    ModelError
        If the file or a mesh cannot be read, or no shape is of a link of the robot.
    ProblemError
        If a name is unknown, or an obstacle, or a body that hangs on the robot, touches
        it in every pose; or as `build_scene`, if a distance is not possible.
    """
    require_type(robot, RobotModel, "robot")
    path = Path(path)
    shapes = urdf_shapes(path, package_dirs, elements, pieces)
    bodies = [body for body in shapes.bodies if _has(robot, body)]
    _require_bodies(path, robot, shapes, bodies, elements, readable_only)
    tree = file_tree(shapes.root)
    others = (body for body in shapes.bodies if not _has(robot, body))
    hanging = hanging_bodies(tree, robot, others)
    shaped = {body.frame or "" for body in shapes.bodies}
    swept = tuple(body.name for body in hanging.bodies)
    added = [*([] if ground is None else [plane(ground)]), *added]

    def connected(first: Body, second: Body) -> bool:
        ends = [b.name if b.name in swept else b.frame or "" for b in (first, second)]
        return tree.connected(ends[0], ends[1], shaped)

    def with_hanging(left_out: Container[str]) -> Scene:
        others = [body for body in hanging.bodies if body.name not in left_out]
        return build_scene(
            robot,
            [*added, *bodies, *others],
            clearance=clearance,
            relax=relax,
            extra=extra,
            allowed=allowed,
            connected=connected,
        )

    scene = with_hanging(())
    touching = hanging.touching(scene)
    if touching and not readable_only:
        raise _touching_whatever_the_pose(hanging, touching)
    if touching:
        scene = with_hanging(touching)
    swept = tuple(name for name in swept if name not in touching)
    return replace(scene, dropped=_dropped(shapes, hanging, touching), swept=swept)


def _touching_whatever_the_pose(
    hanging: Hanging, touching: Mapping[str, str]
) -> ProblemError:
    """Return the error of hanging bodies that touch the robot in all its poses."""
    return ProblemError(
        f"{next(iter(touching.values()))}. Lock them where they stand: "
        f"{hanging.locks(touching)}, or [model] locked"
    )


def _dropped(
    shapes: UrdfShapes, hanging: Hanging, touching: Mapping[str, str]
) -> tuple[tuple[str, str], ...]:
    """Return the links that are not in a scene, and the reasons."""
    unread = ((link.name, link.reason) for link in shapes.unread)
    at_large = (
        (name, f"{why}: {hanging.locks([name])}") for name, why in touching.items()
    )
    return (*unread, *shapes.bare, *hanging.lost, *at_large)


def _require_bodies(
    path: Path,
    robot: RobotModel,
    shapes: UrdfShapes,
    bodies: Sequence[Body],
    elements: Elements,
    readable_only: bool,
) -> None:
    """Refuse shapes that cannot be read, and a file without any of the robot's.

    Parameters
    ----------
    bodies : sequence of Body
        Those of the robot's links.
    readable_only : bool
        Whether unreadable shapes may be left out, if others are there.
    """
    if shapes.unread and not (readable_only and bodies):
        raise shapes.unread[0].cause
    if bodies:
        return
    if not shapes.bodies:
        raise ModelError(
            f"{path}: no link has a shape, expected <{elements}> elements; build the "
            "scene by hand (build_scene, or `bodies` of [excitation.scene]), or design "
            "without a scene (--no-collisions)"
        )
    raise ModelError(
        f"{path}: {len(shapes.bodies)} shapes, none of a link of robot {robot.name!r}; "
        "load the robot from the same file, or build the scene by hand"
    )


def _has(robot: RobotModel, body: Body) -> bool:
    try:
        place_of(robot, body)
    except ModelError:
        return False
    return True


def _movable(
    robot: RobotModel, bodies: tuple[Body, ...], connected: Connected
) -> Iterable[tuple[int, int]]:
    """Yield pairs that move against one another and are not directly connected."""
    links = [place_of(robot, body).link for body in bodies]
    for i, j in combinations(range(len(bodies)), 2):
        between = joints_between(robot, links[i], links[j])
        two = bodies[i], bodies[j]
        obstacle = any(body.frame is None for body in two)
        if len(between) > 1 or (between and (obstacle or not connected(*two))):
            yield i, j


def _adjacent(
    robot: RobotModel, bodies: tuple[Body, ...], connected: Connected
) -> tuple[tuple[str, str], ...]:
    """Return the names of the robot's bodies that one joint connects, pair by pair."""
    own = [(place_of(robot, b).link, b) for b in bodies if b.frame is not None]
    return tuple(
        (first.name, second.name)
        for (one, first), (other, second) in combinations(own, 2)
        if len(joints_between(robot, one, other)) == 1 and connected(first, second)
    )


def _sifted(scene: Scene, q: Array, relax: bool) -> Scene:
    """Leave out pairs that nearly always touch; relax those that are always near.

    Unless `relax` is given, the distances were stated, and are refused where no pose
    keeps them.
    """
    largest = max(pair.wanted for pair in scene.pairs)
    distance = nearest(scene, q, within=largest + ROOM).distance
    _require_possible(scene, q, distance, relax)
    pairs, kept, notes = [], [], list(scene.notes)
    for k, pair in enumerate(scene.pairs):
        names, obstacle = scene.names(pair), _of_obstacle(scene, pair)
        touching = int(np.count_nonzero(distance[:, k] <= 0.0))
        if touching > _ALWAYS * len(q) and not obstacle:
            seen = f"they touch at {touching} of {len(q)} random poses"
            notes.append(PairNote(*names, False, seen))
            continue
        near_by = int(np.count_nonzero(distance[:, k] < pair.wanted))
        usual = len(q) - 1 if obstacle else _USUALLY * len(q)
        if relax and near_by > usual and pair.wanted > 0.0:
            seen = (
                f"nearer than {pair.wanted * 1e3:.1f} mm at {near_by} of {len(q)} "
                "random poses"
            )
            notes.append(PairNote(*names, True, f"{seen}; so only contact is excluded"))
            pair = Pair(pair.first, pair.second, 0.0)
        pairs.append(pair)
        kept.append(k)
    sifted = replace(scene, pairs=tuple(pairs), notes=tuple(notes))
    if not relax:
        return sifted
    distance = distance[:, kept]
    locked = _interlocked(sifted, distance)
    left = [k for k in range(len(sifted.pairs)) if k not in locked]
    sifted = replace(
        sifted,
        pairs=tuple(sifted.pairs[k] for k in left),
        notes=(*sifted.notes, *locked.values()),
    )
    return _with_room(sifted, distance[:, left])


def _of_obstacle(scene: Scene, pair: Pair) -> bool:
    return any(scene.bodies[k].frame is None for k in (pair.first, pair.second))


def _require_possible(scene: Scene, q: Array, distance: Array, relax: bool) -> None:
    """Refuse obstacles that always touch, and stated distances that no pose keeps."""
    touching, lacking = [], []
    for k, pair in enumerate(scene.pairs):
        its, obstacle = distance[:, k], _of_obstacle(scene, pair)
        always = np.count_nonzero(its <= 0.0) > _ALWAYS * len(q)
        stated = not relax and pair.wanted > 0.0 and (obstacle or not always)
        most = float(its.max())
        if (obstacle and most <= 0.0) or (stated and most < pair.wanted + ROOM):
            found = farthest_pose(scene, pair, q, its)
            if obstacle and found.distance <= 0.0:
                touching.append(found)
            elif stated and found.impossible:
                lacking.append(found)
    if touching:
        raise always_touching(scene, touching)
    if lacking:
        raise not_so_far_apart(scene, lacking)


def _interlocked(scene: Scene, distance: Array) -> dict[int, PairNote]:
    """Return pairs that one coordinate moves, and that are never apart all together.

    The hulls of a gripper's linkage overlap at any opening, if not always the same.
    Those that overlap where fewest do are left out, so that there are clear poses.
    """
    robot, touching = scene.robot, distance < ROOM
    groups: dict[int, list[int]] = {}
    for k, pair in enumerate(scene.pairs):
        both = scene.bodies[pair.first], scene.bodies[pair.second]
        links = [place_of(robot, body).link for body in both]
        rates = robot.joint_rates[list(joints_between(robot, *links))]
        moving = np.flatnonzero(rates.any(axis=0))
        if len(moving) == 1 and all(body.frame is not None for body in both):
            groups.setdefault(int(moving[0]), []).append(k)
    found = {}
    for places in groups.values():
        together = touching[:, places]
        if not together.any(axis=1).all():
            continue
        for i in np.flatnonzero(together[together.sum(axis=1).argmin()]):
            k = places[i]
            seen = (
                f"nearer than {ROOM * 1e3:.0f} mm at {int(touching[:, k].sum())} of "
                f"{len(touching)} random poses, and other pairs that the same joint "
                "moves at all others"
            )
            found[k] = PairNote(*scene.names(scene.pairs[k]), False, seen)
    return found


def _with_room(scene: Scene, distance: Array) -> Scene:
    """Relax distances between the robot's bodies if no random pose keeps all of them.

    Relaxed are those that are too small in the pose in which fewest are; this happens
    to small robots, whose links are hardly larger than the distance.
    """
    wanted = np.array([pair.wanted for pair in scene.pairs])
    own = np.array(
        [
            scene.bodies[p.first].frame is not None
            and scene.bodies[p.second].frame is not None
            for p in scene.pairs
        ],
        dtype=bool,
    )
    near = distance < wanted + ROOM
    may = ~(near & ~own).any(axis=1) & (distance > 0.0).all(axis=1)
    if not len(scene.pairs) or not (near & own).any(axis=1).all() or not may.any():
        return scene
    k = int(np.where(may, near.sum(axis=1), len(own) + 1).argmin())
    pairs, notes = list(scene.pairs), list(scene.notes)
    for i in np.flatnonzero(near[k] & (wanted > 0.0)):
        names = scene.names(pairs[i])
        seen = (
            "no random pose keeps the robot's bodies, with room to move, "
            f"{wanted[i] * 1e3:.1f} mm apart"
        )
        notes.append(PairNote(*names, True, f"{seen}; so only contact is excluded"))
        pairs[i] = replace(pairs[i], wanted=0.0)
    return replace(scene, pairs=tuple(pairs), notes=tuple(notes))


def _extras(
    bodies: tuple[Body, ...], clearance: float, extra: Mapping[str, float]
) -> list[float]:
    """Distance beyond the clearance that each body must keep."""
    for name, value in {"clearance": clearance, **extra}.items():
        if not 0.0 <= value < np.inf:
            raise ProblemError(f"scene: {name} is {value} m, expected 0 or more")
    more = {body.name: 0.0 for body in bodies}
    for name, value in extra.items():
        for body in _named(bodies, name):
            more[body] += value
    return [more[body.name] for body in bodies]


def _expanded(
    bodies: tuple[Body, ...], pairs: Sequence[tuple[str, str]]
) -> Iterable[tuple[str, str]]:
    for first, second in pairs:
        for one in _named(bodies, first):
            yield from ((one, other) for other in _named(bodies, second))


def _named(bodies: tuple[Body, ...], name: str) -> list[str]:
    """Names of the body with this name, or of the bodies on the link."""
    found = [body.name for body in bodies if name in (body.name, body.frame)]
    if not found:
        known = {body.name for body in bodies} | {b.frame for b in bodies if b.frame}
        near = did_you_mean(name, sorted(known))
        raise ProblemError(
            f"scene: no body, and none on a link, named {name!r}; {near}"
        )
    return found
