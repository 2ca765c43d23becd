"""Joints of a URDF that follow others: ``<mimic joint multiplier offset>``."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from consistent_id.robot.loaders.urdf_finding import Finding
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.mimic import Mimic
from consistent_id.robot.parameters import did_you_mean

_ONE_AXIS = ("revolute", "continuous", "prismatic")


class Followers(NamedTuple):
    """What follows what in a file.

    `mimics` of joints that move with one that moves by itself, chains of followers
    resolved; `still`, the positions of those that follow what never moves.
    """

    mimics: dict[str, Mimic]
    still: dict[str, float]


def followers_of(root: Element) -> Followers:
    """Return the followers of a file, but for those with a finding."""
    joints = {joint.name: joint for joint in root.all("joint")}
    mimics: dict[str, Mimic] = {}
    still: dict[str, float] = {}
    for name in joints:
        path = _path(joints, name)
        if len(path) == 1 or path[-1] in path[:-1] or path[-1] not in joints:
            continue
        ratio, offset = 1.0, 0.0
        for follower in path[:-1]:
            multiplier, shift = _numbers(joints[follower])
            ratio, offset = ratio * multiplier, offset + ratio * shift
        if ratio != 0.0 and _moves(joints[path[-1]]):
            mimics[name] = Mimic(path[-1], ratio, offset)
        else:
            still[name] = offset
    return Followers(mimics, still)


def mimic_findings(root: Element, moves: Callable[[str], bool]) -> Iterator[Finding]:
    """Find joints that follow what there is not, or one another."""
    joints = {joint.name: joint for joint in root.all("joint")}
    for name, joint in joints.items():
        mimic, path = joint.child("mimic"), _path(joints, name)
        if mimic is None or len(path) == 1 or not moves(name):
            continue
        where = f"joint {name!r}"
        if path[-1] in path[:-1]:
            loop = " follows ".join(path)
            sentence = f"{where}: joints follow one another: {loop}"
            yield Finding(mimic.line, "error", sentence)
        elif path[-1] not in joints:
            near = did_you_mean(path[-1], joints)
            sentence = (
                f"{where}: follows {path[-1]!r}, but there is none; {near}. Correct "
                "the name, or lock the joint"
            )
            yield Finding(mimic.line, "error", sentence)
        elif not _moves(joints[path[-1]]):
            yield Finding(
                mimic.line,
                "warning",
                f"{where}: follows {path[-1]!r}, which never moves, so it is locked",
            )


def _path(joints: dict[str, Element], name: str) -> list[str]:
    """Return a joint, its leader, that one's, and so on, until one comes again."""
    path = [name]
    while path[-1] in joints and path[-1] not in path[:-1]:
        mimic = joints[path[-1]].child("mimic")
        if mimic is None or not _moves(joints[path[-1]]):
            break
        path.append(mimic.attributes.get("joint", ""))
    return path


def _moves(joint: Element) -> bool:
    return joint.attributes.get("type") in _ONE_AXIS


def _numbers(joint: Element) -> tuple[float, float]:
    mimic = joint.child("mimic")
    stated = {} if mimic is None else mimic.attributes
    return float(stated.get("multiplier", 1.0)), float(stated.get("offset", 0.0))
