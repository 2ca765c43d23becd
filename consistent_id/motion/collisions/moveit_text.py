"""MoveIt's ``.scene`` files: objects as the motion planner's window saves them.

(name)
* id
x y z                  pose of the object; not in older files
qx qy qz qw
number of shapes, of each: kind, sizes, x y z, qx qy qz qw, four of colour
number of subframes, of each: name, pose; not in older files
.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.moveit_objects import (
    PlacedShape,
    Pose,
    SceneObject,
    beyond,
    pose_of,
    shape_of,
)

_T = TypeVar("_T")
_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2}
_MOST = 1_000_000  # numbers of one mesh; more are a mistake in the file


def objects_of_text(text: str, where: Path) -> list[SceneObject]:
    """Return the objects of a ``.scene`` file.

    Raises
    ------
    ProblemError
        With the line of the first fault.
    """
    reader = _Reader(text.splitlines(), where)
    reader.line()  # the scene's name
    found = []
    while (head := reader.line()) != ".":
        if not head.startswith("*"):
            raise reader.fault(f"{head[:40]!r}, expected '* NAME' of an object, or '.'")
        found.append(_object(reader, head[1:].strip()))
    return found


def _object(reader: "_Reader", name: str) -> SceneObject:
    posed = reader.ahead() > 1  # older files go on with the number of shapes
    frame = reader.pose() if posed else None
    shapes = []
    for _ in range(reader.count()):
        shapes += _shapes(reader)
    if posed:
        for _ in range(reader.count()):
            reader.line()
            reader.numbers(7)
    if frame is not None:
        shapes = [beyond(frame, placed) for placed in shapes]
    return SceneObject(name, "", tuple(shapes))


def _shapes(reader: "_Reader") -> list[PlacedShape]:
    kind = reader.line()
    if kind == "mesh":
        vertices, triangles = reader.count(), reader.count()
        points = reader.numbers(3 * vertices).reshape(-1, 3)
        reader.numbers(3 * triangles)
        shape = reader.made(shape_of, "mesh", points)
    elif kind in _SIZES:
        sizes = reader.numbers(_SIZES[kind])
        shape = reader.made(shape_of, kind, sizes)
    else:
        known = ", ".join((*_SIZES, "mesh"))
        raise reader.fault(f"shape {kind[:40]!r}, expected one of {known}")
    placed = PlacedShape(shape, *reader.pose())
    reader.numbers(4)
    return [placed]


@dataclass(slots=True)
class _Reader:
    """Lines, and the numbers in them, one after another."""

    lines: list[str]
    where: Path
    number: int = 0
    words: list[str] = field(default_factory=list)

    def line(self) -> str:
        """Return the next line that is not empty."""
        while self.number < len(self.lines):
            text = self.lines[self.number].strip()
            self.number += 1
            if text:
                return text
        raise self.fault("it ends here, expected a last line '.'")

    def ahead(self) -> int:
        """Return how many words the next line has."""
        left = (text.split() for text in self.lines[self.number :])
        return len(next((words for words in left if words), []))

    def numbers(self, count: int) -> Array:
        """Return so many numbers, in whatever lines."""
        if count > _MOST:
            raise self.fault(f"{count} numbers, expected {_MOST} at most")
        while len(self.words) < count:
            self.words += self.line().split()
        taken, self.words = self.words[:count], self.words[count:]
        try:
            values = np.array([float(word) for word in taken])
        except ValueError as cause:
            raise self.fault(f"{cause}, expected {count} numbers") from None
        if not np.isfinite(values).all():
            raise self.fault(f"{taken}, expected finite numbers")
        return values

    def count(self) -> int:
        """Return a number that counts something."""
        (value,) = self.numbers(1)
        if value < 0 or value != int(value):
            raise self.fault(f"{value:g}, expected how many shapes there are")
        return int(value)

    def pose(self) -> Pose:
        """Return a position and a quaternion as a pose."""
        return self.made(pose_of, self.numbers(3), self.numbers(4))

    def made(self, make: Callable[..., _T], *given: Any) -> _T:
        """Return what a function makes of numbers; its errors name the line."""
        try:
            return make(*given)
        except ProblemError as cause:
            raise self.fault(str(cause)) from None

    def fault(self, text: str) -> ProblemError:
        return ProblemError(f"{self.where}, line {self.number}: {text}")
