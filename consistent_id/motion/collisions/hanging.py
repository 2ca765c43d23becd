"""Bodies that hang on joints which a motion does not command, at all their positions.

A robot model that ends at a tip leaves out the fingers behind it, and other limbs of
the same file.  They are still there: `FileTree` has each link's parent and the range of
each joint.  A joint that is not part of the model may stand anywhere in its range, so
each of its bodies is replaced by a hull that covers the body at every position:

- a sliding joint: the hull of the body at both ends is exactly what it sweeps;
- a turning joint: corners at angles ``delta`` apart, and the same corners moved off the
  axis by ``1 / cos(delta / 2)``.  An arc lies between its chord and the tangents that
  end at the moved corners, so it is within the hull.

The joints behind one another are covered from the last one inwards.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.motion.collisions.bodies import Body, Box, Hull, Shape
from consistent_id.motion.collisions.scene import PairNote, Scene
from consistent_id.robot.kinematics import turn
from consistent_id.robot.loaders.urdf_in_place import rotation_of
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.model import RobotModel

_SWINGS = ("revolute", "continuous")

_STEP = np.pi / 12.0  # [rad]; largest angle between covered positions
_CORNERS = 160  # of a hull; with more, it is replaced by a coarser one around it
_DIRECTIONS = 96  # of the faces of the coarser hull
_OUTWARDS = 1e-9  # [m]; the faces are moved out by this, for rounding


@dataclass(frozen=True, slots=True, eq=False)
class FileJoint:
    """A joint of a URDF, with the positions that it can have.

    Parameters
    ----------
    name, kind : str
    parent, child : str
        Links.
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,), [m]
        The joint's frame in the parent's.
    axis : ndarray, shape (3,)
        Unit vector in the joint's frame.
    lower, upper : float, [rad or m]
        Range; infinite if the file states none.
    """

    name: str
    kind: str
    parent: str
    child: str
    rotation: Matrix
    translation: Vector
    axis: Vector
    lower: float
    upper: float

    @property
    def swings(self) -> bool:
        """Whether it turns about an axis."""
        return self.kind in _SWINGS


@dataclass(frozen=True, slots=True, eq=False)
class FileTree:
    """The links of a URDF and the joints between them.

    Parameters
    ----------
    joints : mapping of str to FileJoint
        By child link.
    """

    joints: Mapping[str, FileJoint]

    def to_root(self, link: str) -> list[str]:
        """Return a link and all that carry it, the root last."""
        way = [link]
        while way[-1] in self.joints and len(way) <= len(self.joints) + 1:
            way.append(self.joints[way[-1]].parent)
        return way

    def between(self, first: str, second: str) -> list[str]:
        """Return the links on the way from one to the other, without the two."""
        up, down = self.to_root(first), self.to_root(second)
        shared = next((link for link in up if link in down), None)
        if shared is None:
            return []
        way = [*up[: up.index(shared)], shared, *down[: down.index(shared)][::-1]]
        return way[1:-1]

    def connected(self, first: str, second: str, shaped: Collection[str]) -> bool:
        """Return whether no link with a shape is between two links."""
        return not any(link in shaped for link in self.between(first, second))


def file_tree(root: Element) -> FileTree:
    """Return the tree of a URDF's links.

    Followers (``<mimic>``) have the range that their leader's range gives them.
    """
    stated = {joint.name: joint for joint in root.all("joint")}
    found = {}
    for joint in root.all("joint"):
        parent, child = (_link(joint, end) for end in ("parent", "child"))
        origin = joint.child("origin") or Element("origin", {}, joint.line)
        axis = _numbers(joint.child("axis"), "xyz", (1.0, 0.0, 0.0))
        length = float(np.linalg.norm(axis))
        lower, upper = _range(joint, stated)
        found[child] = FileJoint(
            name=joint.name,
            kind=joint.attributes.get("type", ""),
            parent=parent,
            child=child,
            rotation=rotation_of(_numbers(origin, "rpy", (0.0, 0.0, 0.0)).tolist()),
            translation=_numbers(origin, "xyz", (0.0, 0.0, 0.0)),
            axis=axis / (length or 1.0),
            lower=lower,
            upper=upper,
        )
    return FileTree(found)


def _link(joint: Element, end: str) -> str:
    element = joint.child(end)
    return "" if element is None else element.attributes.get("link", "")


def _numbers(
    element: Element | None, name: str, default: tuple[float, float, float]
) -> Vector:
    text = "" if element is None else element.attributes.get(name, "")
    if not text.strip():
        return np.array(default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or element is None or not np.isfinite(values).all():
        line = 0 if element is None else element.line
        raise ModelError(f"line {line}: {name} is {text!r}, expected three numbers")
    return values


def _range(joint: Element, stated: Mapping[str, Element]) -> tuple[float, float]:
    """Return the range of a joint; a follower's is its leader's, transmitted."""
    own = _own_range(joint)
    mimic = joint.child("mimic")
    leader = None if mimic is None else stated.get(mimic.attributes.get("joint", ""))
    if mimic is None or leader is None:
        return own
    ratio = float(mimic.attributes.get("multiplier", "1"))
    offset = float(mimic.attributes.get("offset", "0"))
    ends = sorted(ratio * end + offset for end in _own_range(leader))
    return (ends[0], ends[1]) if np.isfinite(ends).all() else own


def _own_range(joint: Element) -> tuple[float, float]:
    limit = joint.child("limit")
    if joint.attributes.get("type") == "continuous" or limit is None:
        return -np.inf, np.inf
    # URDF: a missing end is zero
    lower, upper = (float(limit.attributes.get(k, "0")) for k in ("lower", "upper"))
    return min(lower, upper), max(lower, upper)


@dataclass(frozen=True, slots=True)
class Hanging:
    """The bodies of a file's links that a robot model does not have.

    Parameters
    ----------
    bodies : tuple of Body
        Hulls that cover the links at every position, fixed to links of the robot.
    joints : mapping of str to tuple of str
        By link: the joints that move it and do not belong to the robot.
    lost : tuple of (str, str)
        Links that cannot be covered, and the reasons.
    """

    bodies: tuple[Body, ...]
    joints: Mapping[str, tuple[str, ...]]
    lost: tuple[tuple[str, str], ...]

    def touching(self, scene: Scene) -> dict[str, str]:
        """Return the reasons why some of the bodies cannot be kept off, by name.

        In some of their positions they touch the robot, whatever its pose is.
        """
        found: dict[str, str] = {}
        for note in scene.notes:
            swept, other = self._swept_first(note)
            if swept in self.joints:
                found[swept] = (
                    f"{swept!r} hangs on joints that do not belong to the motion, and "
                    f"in some of their positions it touches {other!r} whatever the "
                    f"robot's pose is ({note.reason})"
                )
        return found

    def locks(self, bodies: Iterable[str]) -> str:
        """Return the options that lock the joints of some of the bodies."""
        joints = dict.fromkeys(j for name in bodies for j in self.joints[name])
        return f"--lock {' '.join(f'{joint}=POSITION' for joint in joints)}"

    def _swept_first(self, note: PairNote) -> tuple[str, str]:
        """Return the bodies of an unchecked pair, one of these bodies first."""
        if note.watched or note.wanted:
            return "", ""
        names = note.first, note.second
        return names if note.first in self.joints else names[::-1]


def hanging_bodies(
    tree: FileTree, robot: RobotModel, bodies: Iterable[Body]
) -> Hanging:
    """Return hulls of links that hang on a robot model's links.

    Parameters
    ----------
    tree : FileTree
    robot : RobotModel
        A part of the file's robot.
    bodies : iterable of Body
        Bodies of links that the robot does not have, in the links' frames.
    """
    of_link: dict[str, list[Body]] = {}
    for body in bodies:
        of_link.setdefault(body.frame or "", []).append(body)
    found, lost = [], []
    joints: dict[str, tuple[str, ...]] = {}
    for link, shapes in of_link.items():
        way = _way_to(tree, robot, link)
        if way is None:
            lost.append((link, "no joint of the file connects it to the robot"))
            continue
        endless = next((joint for joint in way if not _bounded(joint)), None)
        if endless is not None:
            lost.append((link, _endless(endless)))
            continue
        points = np.concatenate([_corners(body) for body in shapes])
        for joint in way:
            points = _fewer(_covered(points, joint))
            points = points @ joint.rotation.T + joint.translation
        found.append(Body(link, Hull(points), way[-1].parent))
        moving = (joint.name for joint in way[::-1] if joint.kind != "fixed")
        joints[link] = tuple(moving)
    return Hanging(tuple(found), joints, tuple(lost))


def _way_to(tree: FileTree, robot: RobotModel, link: str) -> list[FileJoint] | None:
    """Return the joints between a link and the robot, that link's own first."""
    way: list[FileJoint] = []
    for one in tree.to_root(link):
        if _has(robot, one):
            return way
        joint = tree.joints.get(one)
        if joint is None:
            return None
        way.append(joint)
    return None


def _has(robot: RobotModel, link: str) -> bool:
    try:
        robot.carrier(link)
    except ModelError:
        return False
    return True


def _bounded(joint: FileJoint) -> bool:
    if joint.kind == "prismatic":
        return bool(np.isfinite([joint.lower, joint.upper]).all())
    return joint.swings or joint.kind == "fixed"


def _endless(joint: FileJoint) -> str:
    how = "slides without limits" if joint.kind == "prismatic" else f"is {joint.kind}"
    return f"joint {joint.name} {how}; lock it with --lock {joint.name}=POSITION"


def _covered(points: Array, joint: FileJoint) -> Array:
    """Return points whose hull covers a hull at every position of a joint."""
    if joint.kind == "fixed":
        return points
    if joint.kind == "prismatic":
        ends = [points + end * joint.axis for end in (joint.lower, joint.upper)]
        return np.concatenate(ends)
    lower, span = joint.lower, joint.upper - joint.lower
    if not span < 2.0 * np.pi:
        lower, span = 0.0, 2.0 * np.pi
    return swept(points, joint.axis, lower, span)


def swept(points: Array, axis: Vector, lower: float, span: float) -> Array:
    """Return points whose hull covers a hull that turns about an axis.

    Parameters
    ----------
    points : ndarray, shape (points, 3), [m]
    axis : ndarray, shape (3,)
        Unit vector, through the origin.
    lower, span : float, [rad]
        It turns from `lower` to ``lower + span``.

    Examples
    --------
    >>> corners = swept(np.array([[1.0, 0, 0]]), np.array([0, 0, 1.0]), 0.0, np.pi)
    >>> bool(1.0 < np.linalg.norm(corners, axis=1).max() < 1.01)
    True
    """
    count = int(np.ceil(span / _STEP)) + 1
    angles = lower + np.linspace(0.0, span, count)
    step = span / max(count - 1, 1)
    along = (points @ axis)[:, None] * axis
    further = along + (points - along) / np.cos(step / 2.0)
    both = np.concatenate([points, further])
    return np.concatenate([both @ turn(axis, angle).T for angle in angles])


def _corners(body: Body) -> Array:
    """Return points, in the link's frame, whose hull covers a body."""
    points = _shape_corners(body.shape)
    return np.asarray(points @ np.asarray(body.rotation).T + body.translation)


def _shape_corners(shape: Shape) -> Array:
    if isinstance(shape, Hull):
        return np.asarray(shape.points)
    if isinstance(shape, Box):
        signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 3)
        return np.asarray(signs * np.array(shape.size))
    return _around(shape.farthest)


def _fewer(points: Array) -> Array:
    """Return fewer points whose hull covers that of the given ones."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points  # flat: `Hull` refuses it, if it stays so
    if len(corners) <= _CORNERS:
        return np.asarray(corners)

    def farthest(directions: Matrix) -> Array:
        return np.asarray(corners[(directions @ corners.T).argmax(axis=1)])

    return _around(farthest)


def _around(farthest: Callable[[Array], Array]) -> Array:
    """Return corners of a polytope with many faces around a convex set."""
    from scipy.spatial import HalfspaceIntersection

    normals = _directions()
    points = farthest(normals)
    reach = np.einsum("ni,ni->n", normals, points) + _OUTWARDS
    faces = np.column_stack([normals, -reach])
    middle = points.mean(axis=0)
    return np.asarray(HalfspaceIntersection(faces, middle).intersections)


def _directions() -> Matrix:
    """Return unit vectors spread evenly (a spiral with the golden angle), and axes."""
    k = np.arange(_DIRECTIONS) + 0.5
    height = 1.0 - 2.0 * k / _DIRECTIONS
    angle = np.pi * (3.0 - np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - height**2)
    spiral = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height])
    return np.concatenate([spiral, np.eye(3), -np.eye(3)])
