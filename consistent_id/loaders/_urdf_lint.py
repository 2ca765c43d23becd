"""What Pinocchio would swallow in silence: a lint of URDF text, with line numbers."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from xml.parsers import expat

from consistent_id.errors import ModelError

_JOINTS = ("revolute", "continuous", "prismatic", "fixed")
_NUMBERS = {
    ("mass", "value"): 1,
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("limit", "lower"): 1,
    ("limit", "upper"): 1,
    ("limit", "velocity"): 1,
    ("limit", "effort"): 1,
    **{("inertia", f"i{axes}"): 1 for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
}


@dataclass(slots=True)
class _Element:
    """An XML element with the line on which it starts."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list["_Element"] = field(default_factory=list)

    def child(self, tag: str) -> "_Element | None":
        return next((c for c in self.children if c.tag == tag), None)


def lint(text: bytes, path: Path, moves: Callable[[str], bool]) -> None:
    """Raise a `ModelError` that names file and line for the first fault found.

    `moves` tells of a joint's name whether the joint is not locked.
    """
    root = _parse(text, path)

    def fail(element: _Element, message: str) -> None:
        raise ModelError(f"{path}, line {element.line}: {message}")

    if root.tag != "robot":
        fail(root, f"root element is <{root.tag}>, expected <robot>")
    names: dict[tuple[str, str], int] = {}
    for element in root.children:
        if element.tag not in ("link", "joint"):
            continue
        name = element.attributes.get("name", "")
        if not name:
            fail(element, f"<{element.tag}> has no name")
        first = names.setdefault((element.tag, name), element.line)
        if first != element.line:
            fail(element, f"{element.tag} {name!r} already stands on line {first}")
        for part in _below(element):
            for attribute, count in _faulty_numbers(part):
                fail(
                    part,
                    f"{element.tag} {name!r}: <{part.tag} {attribute}="
                    f"{part.attributes[attribute]!r}>, expected {count} finite "
                    f"number{'s' if count > 1 else ''}",
                )
        message = _link_fault(element) if element.tag == "link" else _fault(element)
        if not message and element.child("mimic") is not None and moves(name):
            message = "mimic joints are not supported; make the joint fixed, or lock it"
        if message:
            fail(element, f"{element.tag} {name!r}: {message}")


def _parse(text: bytes, path: Path) -> _Element:
    parser = expat.ParserCreate()
    top = _Element("", {}, 0)
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Element(tag, attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def refuse_dtd(*_: object) -> None:
        raise ModelError(
            f"{path}, line {parser.CurrentLineNumber}: a document type declaration "
            "stands here; entities are not expanded, remove it"
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse_dtd
    try:
        parser.Parse(text, True)
    except expat.ExpatError as cause:
        raise ModelError(f"{path}: not well-formed XML: {cause}") from None
    return top.children[0]


def _below(element: _Element) -> Iterator[_Element]:
    """Descendants that bear on the dynamics."""
    for child in element.children:
        if child.tag not in ("visual", "collision"):
            yield child
            yield from _below(child)


def _faulty_numbers(element: _Element) -> Iterator[tuple[str, int]]:
    for attribute, value in element.attributes.items():
        count = _NUMBERS.get((element.tag, attribute))
        if count is not None:
            try:
                numbers = [float(part) for part in value.split()]
            except ValueError:
                yield attribute, count
                continue
            if len(numbers) != count or not all(map(isfinite, numbers)):
                yield attribute, count


def _link_fault(link: _Element) -> str:
    inertial = link.child("inertial")
    if inertial is None:
        return ""
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    if mass is None or "value" not in mass.attributes:
        return "<inertial> has no <mass value=...>"
    if float(mass.attributes["value"]) < 0.0:
        return f"mass is {mass.attributes['value']} kg, expected 0 or more"
    if inertia is None:
        return "<inertial> has no <inertia>"
    missing = {"ixx", "iyy", "izz"} - inertia.attributes.keys()
    return f"<inertia> lacks {', '.join(sorted(missing))}" if missing else ""


def _fault(joint: _Element) -> str:
    kind = joint.attributes.get("type", "")
    if kind not in _JOINTS:
        return f"type is {kind!r}, expected one of {', '.join(_JOINTS)}"
    for end in ("parent", "child"):
        element = joint.child(end)
        if element is None or "link" not in element.attributes:
            return f"<{end} link=...> is missing"
    axis = joint.child("axis")
    if kind != "fixed" and axis is not None:
        if not any(float(x) for x in axis.attributes.get("xyz", "1 0 0").split()):
            return "axis is zero, expected a direction"
    if kind in ("revolute", "prismatic") and joint.child("limit") is None:
        return f"a {kind} joint needs <limit>; without limits it is continuous"
    return ""
