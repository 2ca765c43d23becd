"""The tree of a URDF's links: each link's parent, and the range of each joint.

A robot model may be a part of its file.  Links behind its tip, and other limbs, are
still there: see `consistent_id.motion.collisions.hanging`.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.robot.loaders.urdf_in_place import rotation_of
from consistent_id.robot.loaders.xml import Element

_SWINGS = ("revolute", "continuous")


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
