"""Scenes from bodies, or from a robot's file: the choice of pairs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.bodies import Body, plane
from consistent_id.motion.collisions.scene import (
    Pair,
    PairNote,
    Scene,
    joints_between,
    place_of,
)
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.collisions.urdf_bodies import Elements, urdf_bodies
from consistent_id.robot.model import Joint, RobotModel
from consistent_id.robot.parameters import did_you_mean

_ALWAYS = 0.95  # share of random poses; a pair that touches in more is not checked
_USUALLY = 0.5  # share of poses; for pairs too near in more, only touching is checked
_ANYWHERE = 1.0  # [m]; motion of a sliding joint without limits, either way


def build_scene(
    robot: RobotModel,
    bodies: Iterable[Body],
    *,
    clearance: float = 0.0,
    extra: Mapping[str, float] | None = None,
    allowed: Sequence[tuple[str, str]] = (),
    poses: int = 200,
    seed: int = 0,
) -> Scene:
    """Return a scene with all pairs of bodies that can come together.

    Some pairs are not checked: bodies on the same link, on links that a single joint
    connects, and bodies of the robot that touch at nearly all random poses; these last
    are listed in `Scene.notes`.  If two bodies of the robot are nearer than required at
    more than half of these poses, they only must not touch.

    Parameters
    ----------
    robot : RobotModel
    bodies : iterable of Body
        Bodies of the robot, with a frame, and obstacles, without one.
    clearance : float, [m]
        Least distance of any two bodies.
    extra : mapping of str to float, optional, [m]
        Additional distance of a body, or of all bodies of a link, from all others: of a
        tool, for instance.
    allowed : sequence of (str, str)
        Pairs of bodies, or of links, that may touch.
    poses : int
        Number of random poses within the joints' limits.
    seed : int
        Of these poses.

    Raises
    ------
    ProblemError
        If a name is unknown, or an obstacle touches the robot at every random pose.
    """
    bodies = tuple(bodies)
    extra_of = _extras(bodies, clearance, extra or {})
    free = {frozenset(names) for names in _expanded(bodies, allowed)}
    pairs, notes = [], []
    for i, j in _movable(robot, bodies):
        names = bodies[i].name, bodies[j].name
        if frozenset(names) in free:
            notes.append(PairNote(*names, False, "may touch, by `allowed`"))
        else:
            pairs.append(Pair(i, j, clearance + extra_of[i] + extra_of[j]))
    adjacent = _adjacent(robot, bodies)
    scene = Scene(robot, bodies, tuple(pairs), tuple(notes), adjacent=adjacent)
    return _sifted(scene, random_poses(robot, poses, seed)) if pairs else scene


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
    extra: Mapping[str, float] | None = None,
    allowed: Sequence[tuple[str, str]] = (),
) -> Scene:
    """Return a scene of a robot's bodies, from its URDF, and of obstacles.

    A body has the name of its link; if a link has several shapes, they are
    ``link:1``, ``link:2``, ...  Meshes become convex hulls, which are never smaller.

    Parameters
    ----------
    path : str or Path
    robot : RobotModel
        Of the same file, or a part of it; joints that it locks stay where they are.
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

    Raises
    ------
    ModelError
        If the file or a mesh cannot be read, or no shape is of a link of the robot.
    ProblemError
        If a name is unknown, or an obstacle touches the robot at every random pose.
    """
    path = Path(path)
    found = urdf_bodies(path, package_dirs, elements, pieces)
    bodies = [body for body in found if _has(robot, body)]
    if not bodies:
        raise ModelError(
            f"{path}: {len(found)} shapes, none of a link of robot {robot.name!r}; "
            "load the robot from the same file, or build the scene by hand"
        )
    known = {body.name for body in bodies}
    dropped = tuple(body.name for body in found if body.name not in known)
    floor = [] if ground is None else [plane(ground)]
    scene = build_scene(
        robot,
        [*floor, *added, *bodies],
        clearance=clearance,
        extra=extra,
        allowed=allowed,
    )
    return replace(scene, dropped=dropped)


def random_poses(robot: RobotModel, poses: int, seed: int) -> Array:
    """Return poses within the joints' limits, shape (poses, joints), [rad or m]."""
    low, high = np.array([_range(joint) for joint in robot.joints]).T
    return np.random.default_rng(seed).uniform(low, high, (poses, len(robot)))


def _has(robot: RobotModel, body: Body) -> bool:
    try:
        place_of(robot, body)
    except ModelError:
        return False
    return True


def _range(joint: Joint) -> tuple[float, float]:
    low, high = joint.limits.lower, joint.limits.upper
    if np.isfinite([low, high]).all():
        return low, high
    reach = _ANYWHERE if joint.kind == "prismatic" else np.pi
    return max(low, -reach), min(high, reach)


def _movable(robot: RobotModel, bodies: tuple[Body, ...]) -> Iterable[tuple[int, int]]:
    """Yield pairs that move against one another and are not adjacent."""
    links = [place_of(robot, body).link for body in bodies]
    for i, j in combinations(range(len(bodies)), 2):
        between = joints_between(robot, links[i], links[j])
        obstacle = bodies[i].frame is None or bodies[j].frame is None
        if len(between) > 1 or (between and obstacle):
            yield i, j


def _adjacent(robot: RobotModel, bodies: tuple[Body, ...]) -> int:
    """Return the number of pairs of the robot's bodies on links of one joint."""
    links = [place_of(robot, body).link for body in bodies if body.frame is not None]
    return sum(len(joints_between(robot, *two)) == 1 for two in combinations(links, 2))


def _sifted(scene: Scene, q: ArrayLike) -> Scene:
    """Leave out pairs that nearly always touch; relax those that are always near."""
    largest = max(pair.wanted for pair in scene.pairs)
    near = nearest(scene, q, within=largest)
    pairs, notes = [], list(scene.notes)
    for k, pair in enumerate(scene.pairs):
        names, distance = scene.names(pair), near.distance[:, k]
        touching = int(np.count_nonzero(distance <= 0.0))
        obstacle = any(scene.bodies[b].frame is None for b in (pair.first, pair.second))
        if touching > _ALWAYS * len(distance):
            seen = f"they touch at {touching} of {len(distance)} random poses"
            if obstacle and touching == len(distance):
                raise ProblemError(
                    f"scene: bodies {names[0]!r} and {names[1]!r}: {seen}; move the "
                    "obstacle, or name the pair in `allowed`"
                )
            if not obstacle:
                notes.append(PairNote(*names, False, seen))
                continue
        near_by = int(np.count_nonzero(distance < pair.wanted))
        if not obstacle and near_by > _USUALLY * len(distance):
            seen = (
                f"nearer than {pair.wanted * 1e3:.1f} mm at {near_by} of "
                f"{len(distance)} random poses"
            )
            notes.append(PairNote(*names, True, f"{seen}; so they only must not touch"))
            pair = Pair(pair.first, pair.second, 0.0)
        pairs.append(pair)
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
