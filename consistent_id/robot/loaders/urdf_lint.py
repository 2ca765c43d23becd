"""A lint of URDF text, with line numbers: faults that Pinocchio accepts silently.

It looks at each link and joint, at how they hang together, and at joints that follow
others (``<mimic joint multiplier offset>``), before anything is loaded.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from consistent_id._support.files import LARGEST_MODEL, LARGEST_TREE, read_input
from consistent_id._support.run import current_run
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError
from consistent_id.robot.loaders.xml import Element, XmlFault, parse
from consistent_id.robot.model import Mimic
from consistent_id.robot.parameters import did_you_mean

INERTIA_ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NUMBERS = {
    ("mass", "value"): 1,
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("limit", "lower"): 1,
    ("limit", "upper"): 1,
    ("limit", "velocity"): 1,
    ("limit", "effort"): 1,
    ("mimic", "multiplier"): 1,
    ("mimic", "offset"): 1,
    **{("inertia", entry): 1 for entry in INERTIA_ENTRIES},
}
LARGEST_OF_A_BODY = 1e30  # kg, m or kg m^2: more than of any body
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_EXTENSIONS = ("visual", "collision", "gazebo", "ros2_control", "transmission")

_ONE_AXIS = ("revolute", "continuous", "prismatic")
_JOINTS = (*_ONE_AXIS, "fixed")
_UNIT = 1e-3  # a direction's length may be off by this much: three printed digits
_ROUNDED = 1e-6  # relative; by so much may printed moments break their inequalities
_POINT = 1e-6  # [m]; what is smaller has no extent, and its moments are rounding


@brief
@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """One fault or oddity of a model file.

    Parameters
    ----------
    line : int
        Counted from 1.
    severity : {"error", "warning"}
        With an error the robot cannot be loaded.  With a warning it can, and `sentence`
        says what is made of the oddity.
    sentence : str

    Examples
    --------
    >>> print(Finding(7, "error", "joint 'a': axis is zero, expected a direction"))
    line 7: joint 'a': axis is zero, expected a direction
    """

    line: int
    severity: Literal["error", "warning"]
    sentence: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.sentence}"


def lint_urdf(path: str | Path) -> tuple[Finding, ...]:
    """Find faults and oddities in a URDF file, in the order of its lines.

    Joints of more than one degree of freedom are errors here; a robot that is loaded
    without them may have them elsewhere.  Elements of other programs (Gazebo,
    ros2_control, transmissions) and shapes are not looked at.

    Raises
    ------
    ModelError
        If the file cannot be read at all.
    """
    try:
        root = parse(read_bytes(Path(path)))
    except XmlFault as fault:
        return (Finding(fault.line, "error", fault.sentence),)
    return urdf_findings(root, lambda joint: True)


def urdf_findings(root: Element, moves: Callable[[str], bool]) -> tuple[Finding, ...]:
    """Return all findings, where `moves` returns whether a named joint moves."""
    if root.tag != "robot":
        sentence = f"root element is <{root.tag}>, expected <robot>"
        return (Finding(root.line, "error", sentence),)
    found = [*unexpanded(root), *_name_findings(root), *_tree_findings(root)]
    found += _mimic_findings(root, moves)
    for element in root.children:
        if element.tag in ("link", "joint"):
            faulty = list(_number_findings(element))
            found += faulty
            if faulty:
                continue  # the numbers below could not be read
            if element.tag == "link":
                found += _link_findings(element)
            else:
                found += _joint_findings(element, moves(element.name))
    return tuple(sorted(found))


def unexpanded(root: Element) -> Iterator[Finding]:
    """Find macros that are not expanded: one finding for all."""
    for element in root.below(without=_EXTENSIONS):
        left = [f"{k}={v!r}" for k, v in element.attributes.items() if "${" in v]
        if element.tag.startswith("xacro:") or left:
            seen = " ".join([f"<{element.tag}", *left]) + ">"
            yield Finding(
                element.line,
                "error",
                f"{seen} has not been expanded; run xacro on the file first",
            )
            return


def _name_findings(root: Element) -> Iterator[Finding]:
    for tag in ("link", "joint"):
        first: dict[str, int] = {}
        for element in root.all(tag):
            name, line = element.name, element.line
            if not name:
                yield Finding(line, "error", f"<{tag}> has no name")
            elif name in first:
                sentence = f"{tag} {name!r} already stands on line {first[name]}"
                yield Finding(line, "error", sentence)
            else:
                first[name] = line


def _number_findings(element: Element) -> Iterator[Finding]:
    """Find invalid numbers; Pinocchio reads some as zero."""
    for part in element.below(without=_EXTENSIONS):
        for attribute, value in part.attributes.items():
            count = _NUMBERS.get((part.tag, attribute))
            most = inf if part.tag == "limit" else LARGEST_OF_A_BODY
            if count is not None and not readable_numbers(value, count, most):
                yield Finding(
                    part.line,
                    "error",
                    f"{element.tag} {element.name!r}: <{part.tag} {attribute}="
                    f"{value!r}>, expected {count} finite "
                    f"number{'s' if count > 1 else ''}, such as 0.5",
                )


def _link_findings(link: Element) -> Iterator[Finding]:
    """Find faults of a link's inertial with readable numbers."""
    where = f"link {link.name!r}"
    inertial = link.child("inertial")
    if inertial is None:
        return
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    if mass is None or "value" not in mass.attributes:
        sentence = f"{where}: <inertial> has no <mass value=...>"
        yield Finding(inertial.line, "error", sentence)
        return
    if inertia is None:
        yield Finding(inertial.line, "error", f"{where}: <inertial> has no <inertia>")
        return
    missing = [entry for entry in INERTIA_ENTRIES if entry not in inertia.attributes]
    if missing:
        yield Finding(
            inertia.line,
            "error",
            f"{where}: <inertia> lacks {', '.join(missing)}; without all six entries "
            f"the link would be read as massless",
        )
        return
    value = float(mass.attributes["value"])
    if value < 0.0:
        sentence = f"{where}: mass is {value:g} kg, expected 0 or more"
        yield Finding(mass.line, "error", sentence)
        return
    fault = _inertia_fault(
        value, [float(inertia.attributes[e]) for e in INERTIA_ENTRIES]
    )
    if fault:
        yield Finding(
            inertia.line,
            "warning",
            f"{where}: {fault}; this inertia is not physically consistent. It is only "
            "a nominal value: estimates do not depend on it, priors use a consistent "
            "inertia near it",
        )


def _inertia_fault(mass: float, entries: list[float]) -> str:
    xx, xy, xz, yy, yz, zz = entries
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    largest = float(abs(moments).max())
    stated = ", ".join(f"{moment:.4g}" for moment in moments)
    if mass == 0.0 and largest > 0.0:
        return f"mass is zero, but the principal moments are {stated} kg m^2"
    if largest <= mass * _POINT**2:
        return ""
    if moments[0] < -_ROUNDED * largest:
        return f"the principal moments are {stated} kg m^2, one of them negative"
    if moments[0] + moments[1] < moments[2] - _ROUNDED * largest:
        return (
            f"the principal moments are {stated} kg m^2, one of them more than the sum "
            "of the others"
        )
    return ""


def _joint_findings(joint: Element, moves: bool) -> Iterator[Finding]:
    """Find faults of a joint, and whether it can move if it must."""
    where, kind = f"joint {joint.name!r}", joint.attributes.get("type", "")
    for end in ("parent", "child"):
        element = joint.child(end)
        if element is None or not element.attributes.get("link"):
            sentence = f"{where}: <{end} link=...> is missing"
            yield Finding(joint.line, "error", sentence)
    loose = kind in ("floating", "planar")
    if kind not in _JOINTS and (moves or not loose):
        advice = "; make it fixed, or choose a base beyond it" if loose else ""
        yield Finding(
            joint.line,
            "error",
            f"{where}: type is {kind!r}, expected one of {', '.join(_JOINTS)}{advice}",
        )
    elif kind in _ONE_AXIS:
        yield from _axis(joint)
        yield from _limit(joint, kind, moves)


def _axis(joint: Element) -> Iterator[Finding]:
    axis = joint.child("axis")
    if axis is None:
        return
    numbers = axis.attributes.get("xyz", "1 0 0")
    length = float(np.linalg.norm([float(x) for x in numbers.split()]))
    if length == 0.0:
        sentence = f"joint {joint.name!r}: axis is zero, expected a direction"
        yield Finding(axis.line, "error", sentence)
    elif abs(length - 1.0) > _UNIT:
        yield Finding(
            axis.line,
            "warning",
            f"joint {joint.name!r}: axis {numbers!r} has length {length:.6g}; it is "
            f"normalised to length 1",
        )


def _limit(joint: Element, kind: str, moves: bool) -> Iterator[Finding]:
    where, limit = f"joint {joint.name!r}", joint.child("limit")
    if limit is None:
        if kind != "continuous":
            yield Finding(
                joint.line,
                "warning",
                f"{where}: a {kind} joint needs <limit>; it is read as unlimited; "
                "other readers of URDF refuse it",
            )
        return
    missing = [key for key in ("effort", "velocity") if key not in limit.attributes]
    if missing:
        yield Finding(
            limit.line,
            "warning",
            f"{where}: <limit> lacks {' and '.join(missing)}; it is read as "
            f"unlimited; other readers of URDF refuse it",
        )
    for key in ("effort", "velocity"):
        if float(limit.attributes.get(key, 0.0)) < 0.0:
            sentence = f"{where}: limit {key} is {limit.attributes[key]} < 0"
            yield Finding(limit.line, "error", sentence)
    if kind == "continuous":
        return
    lower, upper = (float(limit.attributes.get(k, 0.0)) for k in ("lower", "upper"))
    if lower > upper and moves:
        sentence = f"{where}: limits are reversed, lower {lower:g} > upper {upper:g}"
        yield Finding(limit.line, "error", sentence)
    elif lower == upper and moves:
        yield Finding(
            limit.line,
            "warning",
            f"{where}: lower and upper limit are both {lower:g}, so it could not move",
        )


def _tree_findings(root: Element) -> Iterator[Finding]:
    """Find links and joints that are not part of one tree."""
    joints = sum(1 for _ in root.all("joint"))
    if joints > LARGEST_TREE and not current_run().large_files:
        yield Finding(
            root.line,
            "error",
            f"{joints} joints, expected at most {LARGEST_TREE}; use --large-files "
            f"(in Python: with consistent_id.large_files()) if this is intended",
        )
        return
    links = {link.name: link for link in root.all("link")}
    if not links:
        yield Finding(root.line, "error", "the robot has no <link>")
        return
    carried: dict[str, Element] = {}
    for joint in root.all("joint"):
        where = f"joint {joint.name!r}"
        for end in ("parent", "child"):
            name = _end(joint, end)
            if name and name not in links:
                near = did_you_mean(name, links)
                sentence = f"{where}: no {end} link named {name!r}; {near}"
                yield Finding(joint.line, "error", sentence)
        child = _end(joint, "child")
        if child in carried:
            first = carried[child]
            yield Finding(
                joint.line,
                "error",
                f"{where}: link {child!r} already hangs on joint {first.name!r} (line "
                f"{first.line}); closed loops are not supported, cut one of the two",
            )
        elif child:
            carried[child] = joint
    yield from _root_findings(links, carried)


def _root_findings(
    links: dict[str, Element], carried: dict[str, Element]
) -> Iterator[Finding]:
    roots = [link for name, link in links.items() if name not in carried]
    for extra in roots[1:]:
        yield Finding(
            extra.line,
            "error",
            f"link {extra.name!r} hangs on no joint, and neither does "
            f"{roots[0].name!r} (line {roots[0].line}); a robot has one root",
        )
    above = {name: _end(joint, "parent") for name, joint in carried.items()}
    for name, joint in carried.items():
        path = [name]
        while path[-1] in above and len(path) <= len(above):
            path.append(above[path[-1]])
            if path[-1] == name:
                break
        if path[-1] == name and len(path) > 1 and name == min(path):
            loop = " < ".join(path)
            sentence = f"joint {joint.name!r}: its links carry one another: {loop}"
            yield Finding(joint.line, "error", sentence)


def _mimic_findings(root: Element, moves: Callable[[str], bool]) -> Iterator[Finding]:
    """Find joints that follow missing joints, or one another."""
    joints = {joint.name: joint for joint in root.all("joint")}
    for name, joint in joints.items():
        mimic, path = joint.child("mimic"), _leaders(joints, name)
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


class Followers(NamedTuple):
    """The followers of a file.

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
        path = _leaders(joints, name)
        if len(path) == 1 or path[-1] in path[:-1] or path[-1] not in joints:
            continue
        ratio, offset = 1.0, 0.0
        for follower in path[:-1]:
            multiplier, shift = _stated_line(joints[follower])
            ratio, offset = ratio * multiplier, offset + ratio * shift
        if ratio != 0.0 and _moves(joints[path[-1]]):
            mimics[name] = Mimic(path[-1], ratio, offset)
        else:
            still[name] = offset
    return Followers(mimics, still)


def joints_between(root: Element, base: str | None, tip: str | None) -> frozenset[str]:
    """Return the names of the joints from `base` to `tip`, or to all that it carries.

    Links that are fixed to one another count as one.
    """
    joints = {_end(joint, "child"): joint for joint in root.all("joint")}
    above = {link: _end(joint, "parent") for link, joint in joints.items()}
    start = base
    for _ in above:  # links that carry one another are found by the lint
        if start in above and joints[start].attributes.get("type") == "fixed":
            start = above[start]
    found: set[str] = set()
    for link in [tip] if tip is not None else list(above):
        names: list[str] = []
        while link != start and link in above and len(names) < len(above):
            names.append(joints[link].name)
            link = above[link]
        if start is None or link == start:
            found |= set(names)
    return frozenset(found)


def readable_numbers(value: str, count: int, most: float = inf) -> bool:
    """Return whether text consists of so many finite decimal numbers, none too large.

    Limits may be as large as numbers get, in place of none at all. Products of a body's
    values (`LARGEST_OF_A_BODY`) must be finite, too.
    """
    words = value.split()
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    return len(words) == len(numbers) == count and all(
        isfinite(number) and abs(number) <= most for number in numbers
    )


def read_bytes(path: Path) -> bytes:
    """Return a file's content, or raise a `ModelError` that names it."""
    return read_input(path, ModelError, LARGEST_MODEL)


def _end(joint: Element, end: str) -> str:
    element = joint.child(end)
    return "" if element is None else element.attributes.get("link", "")


def _leaders(joints: dict[str, Element], name: str) -> list[str]:
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


def _stated_line(joint: Element) -> tuple[float, float]:
    mimic = joint.child("mimic")
    stated = {} if mimic is None else mimic.attributes
    return float(stated.get("multiplier", 1.0)), float(stated.get("offset", 0.0))
