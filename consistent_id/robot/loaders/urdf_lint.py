"""What Pinocchio would swallow in silence: a lint of URDF text, with line numbers."""

import re
from collections.abc import Callable, Iterator
from math import inf, isfinite
from pathlib import Path

from consistent_id._support.inputs import LARGEST_MODEL, read_input
from consistent_id.errors import ModelError
from consistent_id.robot.loaders.urdf_finding import Finding
from consistent_id.robot.loaders.urdf_mimic import mimic_findings
from consistent_id.robot.loaders.urdf_parts import (
    INERTIA_ENTRIES,
    joint_findings,
    link_findings,
)
from consistent_id.robot.loaders.urdf_tree import tree_findings
from consistent_id.robot.loaders.xml import Element, XmlFault, parse

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


def lint_urdf(path: str | Path) -> tuple[Finding, ...]:
    """Find what is wrong or odd in a URDF file, in the order of its lines.

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


def read_bytes(path: Path) -> bytes:
    """Return a file's content, or raise a `ModelError` that names it."""
    return read_input(path, ModelError, LARGEST_MODEL)


def urdf_findings(root: Element, moves: Callable[[str], bool]) -> tuple[Finding, ...]:
    """Return all findings, where `moves` returns whether a named joint moves."""
    if root.tag != "robot":
        sentence = f"root element is <{root.tag}>, expected <robot>"
        return (Finding(root.line, "error", sentence),)
    found = [*unexpanded(root), *_names(root), *tree_findings(root)]
    found += mimic_findings(root, moves)
    for element in root.children:
        if element.tag in ("link", "joint"):
            faulty = list(_numbers(element))
            found += faulty
            if faulty:
                continue  # the numbers below could not be read
            if element.tag == "link":
                found += link_findings(element)
            else:
                found += joint_findings(element, moves(element.name))
    return tuple(sorted(found))


def unexpanded(root: Element) -> Iterator[Finding]:
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
            most = inf if part.tag == "limit" else LARGEST_OF_A_BODY
            if count is not None and not readable_numbers(value, count, most):
                yield Finding(
                    part.line,
                    "error",
                    f"{element.tag} {element.name!r}: <{part.tag} {attribute}="
                    f"{value!r}>, expected {count} finite "
                    f"number{'s' if count > 1 else ''}, such as 0.5",
                )


def readable_numbers(value: str, count: int, most: float = inf) -> bool:
    """Return whether text consists of so many finite decimal numbers, none too large.

    Limits may be as large as numbers get, in place of none at all; products of what a
    body states (`LARGEST_OF_A_BODY`) must be numbers, too.
    """
    words = value.split()
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    return len(words) == len(numbers) == count and all(
        isfinite(number) and abs(number) <= most for number in numbers
    )
