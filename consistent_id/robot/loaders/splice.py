"""XML text changed in place: only the bytes of what changes differ.

Comments, CDATA, white space, quotes, encodings and elements of other programs stay as
they are, because nothing is parsed and written anew: edits are cut into the bytes.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

from consistent_id.errors import ModelError
from consistent_id.robot.loaders.urdf_lint import read_bytes
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
        """Return where the parts of an element's start tag stand."""
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
