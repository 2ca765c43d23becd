"""What Pinocchio would swallow in silence: a lint of URDF text, with line numbers."""

import re
from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.loaders._urdf_tree import tree_findings
from consistent_id.loaders._xml import Element, XmlFault, parse
from consistent_id.loaders.findings import Finding

_JOINTS = ("revolute", "continuous", "prismatic", "fixed")
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NUMBERS = {
    ("mass", "value"): 1,
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("limit", "lower"): 1,
    ("limit", "upper"): 1,
    ("limit", "velocity"): 1,
    ("limit", "effort"): 1,
    **{("inertia", entry): 1 for entry in _INERTIA},
}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_EXTENSIONS = ("visual", "collision", "gazebo", "ros2_control", "transmission")
_UNIT = 1e-3  # a direction's length may be off by this much: three printed digits
_ROUNDED = 1e-6  # relative; by so much may printed moments break their inequalities
_POINT = 1e-6  # [m]; what is smaller has no extent, and its moments are rounding


def lint_urdf(path: str | Path) -> tuple[Finding, ...]:
    """Find what is wrong or odd in a URDF file, in the order of its lines.

    Joints of more than one degree of freedom and mimic joints are errors here; a robot
    that is loaded without them may have them elsewhere.  Elements of other programmes
    (Gazebo, ros2_control, transmissions) and shapes are not looked at.

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


def read_bytes(path: Path) -> bytes:
    """Return a file's content, or raise a `ModelError` that names it."""
    try:
        return path.read_bytes()
    except OSError as cause:
        raise ModelError(f"{path}: cannot be read ({cause.strerror})") from None


def urdf_findings(root: Element, moves: Callable[[str], bool]) -> tuple[Finding, ...]:
    """Return all findings, where `moves` tells of a joint's name whether it moves."""
    if root.tag != "robot":
        sentence = f"root element is <{root.tag}>, expected <robot>"
        return (Finding(root.line, "error", sentence),)
    found = [*_xacro(root), *_names(root), *tree_findings(root)]
    for element in root.children:
        if element.tag in ("link", "joint"):
            faulty = list(_numbers(element))
            found += faulty
            if faulty:
                continue  # the numbers below could not be read
            if element.tag == "link":
                found += _link(element)
            else:
                found += _joint(element, moves(element.name))
    return tuple(sorted(found))


def _xacro(root: Element) -> Iterator[Finding]:
    """Find what a macro processor has left: one finding for all."""
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


def _names(root: Element) -> Iterator[Finding]:
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


def _numbers(element: Element) -> Iterator[Finding]:
    """Find numbers that are none; Pinocchio takes some for zero."""
    for part in element.below(without=_EXTENSIONS):
        for attribute, value in part.attributes.items():
            count = _NUMBERS.get((part.tag, attribute))
            if count is not None and not _readable(value, count):
                yield Finding(
                    part.line,
                    "error",
                    f"{element.tag} {element.name!r}: <{part.tag} {attribute}="
                    f"{value!r}>, expected {count} finite "
                    f"number{'s' if count > 1 else ''}, such as 0.5",
                )


def _readable(value: str, count: int) -> bool:
    words = value.split()
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    return len(words) == len(numbers) == count and all(map(isfinite, numbers))


def _link(link: Element) -> Iterator[Finding]:
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
    missing = [entry for entry in _INERTIA if entry not in inertia.attributes]
    if missing:
        yield Finding(
            inertia.line,
            "error",
            f"{where}: <inertia> lacks {', '.join(missing)}; without all six entries "
            "the link would be taken for massless",
        )
        return
    value = float(mass.attributes["value"])
    if value < 0.0:
        sentence = f"{where}: mass is {value:g} kg, expected 0 or more"
        yield Finding(mass.line, "error", sentence)
        return
    fault = _body_fault(value, [float(inertia.attributes[e]) for e in _INERTIA])
    if fault:
        yield Finding(
            inertia.line,
            "warning",
            f"{where}: {fault}; no body has this inertia. It is only a nominal value: "
            "estimates do not rest on it, priors take a body near it",
        )


def _body_fault(mass: float, entries: list[float]) -> str:
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


def _joint(joint: Element, moves: bool) -> Iterator[Finding]:
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
    elif kind in ("revolute", "continuous", "prismatic"):
        yield from _axis(joint)
        yield from _limit(joint, kind, moves)
        if moves and joint.child("mimic") is not None:
            yield Finding(
                joint.line,
                "error",
                f"{where}: mimic joints are not supported; make the joint fixed, or "
                "lock it",
            )


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
            "taken as a direction of length 1",
        )


def _limit(joint: Element, kind: str, moves: bool) -> Iterator[Finding]:
    where, limit = f"joint {joint.name!r}", joint.child("limit")
    if limit is None:
        if kind != "continuous":
            yield Finding(
                joint.line,
                "error",
                f"{where}: a {kind} joint needs <limit>; without limits it is "
                "continuous",
            )
        return
    missing = [key for key in ("effort", "velocity") if key not in limit.attributes]
    if missing:
        sentence = f"{where}: <limit> lacks {' and '.join(missing)}"
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
