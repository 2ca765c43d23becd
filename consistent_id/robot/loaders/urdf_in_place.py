"""URDF text changed in place: only the bytes of changed values differ.

Comments, CDATA, white space, quotes, encodings and elements of other programs stay as
they are, because nothing is parsed and written anew: edits are cut into the bytes.
The inertial of a link is read with its place in the text, and written back there.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id.errors import ModelError
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.urdf_lint import INERTIA_ENTRIES, read_bytes
from consistent_id.robot.loaders.xml import Element, XmlFault, parse

_TAG = re.compile(rb"<[^\s/>]+")
_ATTRIBUTE = re.compile(rb"\s+([^\s=/>]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_END = re.compile(rb"\s*(/?)>")
_BLANK = re.compile(rb"\s*")
_INDENT = "  "


class Edit(NamedTuple):
    """Bytes ``start`` to ``stop`` become `text`; nothing is replaced if they agree."""

    start: int
    stop: int
    text: bytes


class Tag(NamedTuple):
    """A start tag: where attributes and their values stand, and where it ends.

    `whole` has attributes with the white space before them.  `last` is the end of what
    is written in it, `closed` whether it ends in ``/>``.
    """

    values: dict[str, tuple[int, int]]
    whole: dict[str, tuple[int, int]]
    last: int
    stop: int
    closed: bool


@dataclass(frozen=True, slots=True, eq=False)
class XmlText:
    """XML text with its elements, from which edits are made."""

    data: bytes
    root: Element

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file.

        Raises
        ------
        ModelError
            As `of`, and if the file cannot be read; with the file.
        """
        data = read_bytes(path)
        try:
            return cls.of(data)
        except XmlFault as fault:
            raise ModelError(f"{path}, {fault}") from None
        except ModelError as fault:
            raise ModelError(f"{path}: {fault}") from None

    @classmethod
    def of(cls, data: bytes) -> Self:
        """Parse text; its encoding must have ASCII's letters as single bytes.

        Raises
        ------
        ModelError
            If it is not XML, or in an encoding of two bytes per letter.
        """
        if b"\0" in data[:4]:
            raise ModelError(
                "the text is UTF-16 or UTF-32, in which nothing can be changed in "
                "place; save the file as UTF-8"
            )
        return cls(data, parse(data))

    def tag(self, element: Element) -> Tag:
        """Return the places of the parts of an element's start tag."""
        place = self._matched(_TAG, element.start).end()
        values: dict[str, tuple[int, int]] = {}
        whole: dict[str, tuple[int, int]] = {}
        while found := _ATTRIBUTE.match(self.data, place):
            group = 2 if found[2] is not None else 3
            name = found[1].decode("latin-1")
            values[name], whole[name] = found.span(group), found.span()
            place = found.end()
        end = self._matched(_END, place)
        return Tag(values, whole, place, end.end(), bool(end[1]))

    def set(self, element: Element, attributes: Mapping[str, str]) -> list[Edit]:
        """Return edits that give attributes their values, adding those that lack."""
        tag = self.tag(element)
        edits = [
            Edit(*tag.values[name], _ascii(value))
            for name, value in attributes.items()
            if name in tag.values and element.attributes[name] != value
        ]
        new = [f' {k}="{v}"' for k, v in attributes.items() if k not in tag.values]
        if new:
            edits.append(Edit(tag.last, tag.last, _ascii("".join(new))))
        return edits

    def drop(self, element: Element, attributes: Iterable[str]) -> list[Edit]:
        """Return edits that take attributes away, where an element has them."""
        whole = self.tag(element).whole
        return [Edit(*whole[name], b"") for name in attributes if name in whole]

    def insert(self, parent: Element, children: Sequence[Sequence[str]]) -> Edit:
        """Return the edit that puts children first into an element.

        Each child is a list of lines; all but its first and last are indented.
        """
        tag = self.tag(parent)
        if tag.closed:
            outer = self._line_start(parent.start)
            inner = outer + _INDENT if outer else ""
            end = f"{outer}</{parent.tag}>"
            text = ">" + _laid_out(children, inner) + end
            return Edit(tag.last, tag.stop, _ascii(text))
        blank = self._matched(_BLANK, tag.stop)
        inner = blank[0].decode()
        inner = inner[max(inner.rfind("\n"), 0) :] if "\n" in inner else ""
        if inner.startswith("\n") and b"\r\n" in blank[0]:
            inner = "\r" + inner
        if inner and blank.end() == parent.close:
            inner += _INDENT
        return Edit(tag.stop, tag.stop, _ascii(_laid_out(children, inner)))

    def spliced(self, edits: Iterable[Edit]) -> bytes:
        """Return the text with all edits made."""
        parts, place = [], 0
        for edit in sorted(edits):
            if edit.start < place:
                raise ValueError(f"edits overlap at byte {edit.start}")
            parts += [self.data[place : edit.start], edit.text]
            place = edit.stop
        return b"".join([*parts, self.data[place:]])

    def _line_start(self, place: int) -> str:
        """Return line break and indentation before a byte; empty if text precedes."""
        line = self.data.rfind(b"\n", 0, place)
        blank = self.data[line + 1 : place]
        if line < 0 or blank.strip():
            return ""
        newline = "\r\n" if self.data[line - 1 : line] == b"\r" else "\n"
        return newline + blank.decode()

    def _matched(self, pattern: re.Pattern[bytes], place: int) -> re.Match[bytes]:
        found = pattern.match(self.data, place)
        if found is None:  # the text is well-formed, so this cannot be
            raise ModelError(f"byte {place}: not as expected of well-formed XML")
        return found


def joined(edits: Iterable[Edit]) -> Iterator[Edit]:
    """Yield edits, insertions at the same place as one."""
    found: dict[tuple[int, int], bytes] = {}
    for start, stop, text in edits:
        found[start, stop] = found.get((start, stop), b"") + text
    for (start, stop), text in found.items():
        yield Edit(start, stop, text)


def _laid_out(children: Sequence[Sequence[str]], inner: str) -> str:
    """Return children, each line after a line break and its indentation, if any."""
    lines = []
    for child in children:
        for k, line in enumerate(child):
            deeper = inner and 0 < k < len(child) - 1
            lines.append(inner + (_INDENT if deeper else "") + line)
    return "".join(lines)


def _ascii(text: str) -> bytes:
    return text.encode("ascii", "replace")


_PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of `INERTIA_ENTRIES`

_LARGE = 1e15  # integers from here on are not all numbers
_ROUNDED = 1e-14  # relative; a sum and a product later, that is the same number


def number(value: float) -> str:
    """Return the shortest text that reads back as the same number."""
    value = float(value) + 0.0  # no negative zero
    whole = value.is_integer() and abs(value) < _LARGE
    return repr(int(value)) if whole else repr(value)


def numbers(text: str) -> Array:
    """Return the numbers of an attribute."""
    return np.array([float(word) for word in text.split()])


def rotation_of(rpy: Sequence[float]) -> Matrix:
    """Return ``Rz(yaw) Ry(pitch) Rx(roll)``, of angles about fixed axes [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def inertia_matrix(entries: Sequence[float]) -> Matrix:
    """Return the symmetric matrix of ``ixx, ixy, ixz, iyy, iyz, izz``."""
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(entries, _PLACES, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def inertia_attributes(matrix: Matrix) -> dict[str, float]:
    """Return the six attributes of an inertia matrix."""
    return {
        entry: float(matrix[place])
        for entry, place in zip(INERTIA_ENTRIES, _PLACES, strict=True)
    }


def body_of(link: Element) -> InertialParameters:
    """Return a link's parameters in its frame, zero if it has no inertial.

    The numbers must have been found readable.
    """
    inertial = link.child("inertial")
    if inertial is None:
        return InertialParameters(np.zeros(10))
    origin, mass = inertial.child("origin"), inertial.child("mass")
    inertia = inertial.child("inertia")
    where = {} if origin is None else origin.attributes
    turned = rotation_of(numbers(where.get("rpy", "0 0 0")).tolist())
    moments = {} if inertia is None else inertia.attributes
    entries = [float(moments.get(entry, 0.0)) for entry in INERTIA_ENTRIES]
    return InertialParameters.from_central(
        0.0 if mass is None else float(mass.attributes.get("value", 0.0)),
        numbers(where.get("xyz", "0 0 0")),
        turned @ inertia_matrix(entries) @ turned.T,
    )


def set_numbers(
    document: XmlText, element: Element, values: dict[str, Sequence[float]]
) -> list[Edit]:
    """Return edits of attributes that are numbers; equal ones keep their text."""
    changed = {}
    for name, wanted in values.items():
        stated = element.attributes.get(name)
        if stated is None or not _same(numbers(stated), np.array(wanted)):
            changed[name] = " ".join(number(value) for value in wanted)
    return document.set(element, changed)


def _same(stated: Array, wanted: Array) -> bool:
    """Return whether numbers differ by no more than rounding."""
    if stated.shape != wanted.shape:
        return False
    return bool(np.allclose(stated, wanted, rtol=_ROUNDED, atol=0.0))


def set_body(document: XmlText, link: Element, body: InertialParameters) -> list[Edit]:
    """Return edits that set a link's inertial: centre of mass in the link's axes.

    There are none if the link has these parameters already, in whatever axes.
    """
    stated = body_of(link).vector
    if np.allclose(stated, body.vector, rtol=0.0, atol=_ROUNDED * abs(stated).max()):
        return []
    parts = _parts(body, link)
    inertial = link.child("inertial")
    if inertial is None:
        lines = [_element(tag, values) for tag, values in parts.items()]
        child = ["<inertial>", *lines, "</inertial>"]
        return [document.insert(link, [child])]
    edits, missing = [], []
    for tag, values in parts.items():
        element = inertial.child(tag)
        if element is None:
            missing.append([_element(tag, values)])
            continue
        if tag == "origin" and "rpy" not in element.attributes:
            del values["rpy"]
        edits += set_numbers(document, element, values)
    if missing:
        edits.append(document.insert(inertial, missing))
    return edits


def _parts(
    body: InertialParameters, link: Element
) -> dict[str, dict[str, Sequence[float]]]:
    """Return elements of an inertial and their numbers; massless links keep theirs."""
    if body.mass == 0.0:
        com, inertia = body_com(link), body.inertia
    else:
        com, inertia = body.com, body.central_inertia
    entries = inertia_attributes(inertia)
    return {
        "origin": {"xyz": com.tolist(), "rpy": (0.0, 0.0, 0.0)},
        "mass": {"value": (body.mass,)},
        "inertia": {entry: (value,) for entry, value in entries.items()},
    }


def body_com(link: Element) -> Array:
    """Return where the file puts a link's centre of mass, its origin by default."""
    inertial = link.child("inertial")
    origin = None if inertial is None else inertial.child("origin")
    return numbers("0 0 0" if origin is None else origin.attributes.get("xyz", "0 0 0"))


def _element(tag: str, values: dict[str, Sequence[float]]) -> str:
    pairs = [
        f'{name}="{" ".join(number(v) for v in value)}"'
        for name, value in values.items()
    ]
    return f"<{tag} {' '.join(pairs)}/>"
