"""Draw the rooms of the package and what each imports: writes ``rooms.svg``.

``python docs/rooms.py`` makes the drawing again; a test checks that it is current. The
arrows come from the imports, the words from the first line of each room's docstring.
An arrow that follows from others is left out (transitive reduction).
"""

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from html import escape
from itertools import pairwise
from pathlib import Path

DOCS = Path(__file__).parent
DRAWING = DOCS / "rooms.svg"
_PACKAGE = DOCS.parent / "consistent_id"
_TOP = "cli"  # every other room is below this one

_BOX, _ROW, _TEXT = 34, 52, 14  # height of a box, of a row, of a letter [px]
_LEFT, _RIGHT, _WIDTH = 70, 810, 880  # sides of the boxes, width of the drawing [px]
_WORDS, _LANE = 132, 18  # where a box's words start, distance of two lanes [px]
_STYLE = """
text { font: 14px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; fill: #24292f }
.name { font: 600 14px ui-monospace, Menlo, Consolas, monospace; fill: #0b4f8a }
.page { fill: #ffffff }
.box { fill: #f3f7fb; stroke: #7d9db8 }
.arrow { fill: none; stroke: #54728c; stroke-width: 1.6; marker-end: url(#head) }
.head { fill: #54728c }
"""


@dataclass(frozen=True, slots=True)
class Arc:
    """An arrow from row ``start`` past other rows to row ``end``."""

    start: int
    end: int

    def crosses(self, other: "Arc") -> bool:
        """Return whether one of two arcs starts inside the other and ends outside."""
        first, last = sorted((self, other), key=lambda arc: (arc.start, -arc.end))
        return first.start < last.start < first.end < last.end


@cache
def modules() -> dict[Path, ast.Module]:
    """Return the modules of the package, by their paths in it."""
    return {
        file.relative_to(_PACKAGE): ast.parse(file.read_text(encoding="utf-8"))
        for file in _PACKAGE.rglob("*.py")
    }


def statements(block: ast.AST) -> Iterator[ast.AST]:
    """Return the statements of a block and of the blocks in it."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(block, name, ()):
            yield inner
            yield from statements(inner)


def rooms() -> dict[str, str]:
    """Return the first line of each room's docstring."""
    found = {}
    for file, tree in sorted(modules().items(), key=lambda item: item[0]):
        first = len(file.parts) == 2 and file.name == "__init__.py"
        if first or file == Path("errors.py"):
            words = ast.get_docstring(tree) or ""
            found[_room(file)] = words.partition("\n")[0].replace("`", "")
    return found


def _room(file: Path) -> str:
    return file.parts[0].removesuffix(".py")


def imports(names: Iterable[str]) -> dict[str, set[str]]:
    """Return the other rooms that each room imports, inside functions too."""
    found: dict[str, set[str]] = {name: set() for name in names}
    for file, tree in modules().items():
        if (room := _room(file)) in found:
            found[room] |= {below for below in _imported(tree) if below in found}
    return {room: below - {room} for room, below in found.items()}


def _imported(tree: ast.AST) -> Iterator[str]:
    for node in statements(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").count("."):
            package, room = str(node.module).split(".")[:2]
            if package == _PACKAGE.name:
                yield room


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return a graph without cycles less the edges that follow from others."""
    below = {room: _reached(graph, room) for room in graph}
    return {
        room: {b for b in direct if not any(b in below[other] for other in direct)}
        for room, direct in graph.items()
    }


def _reached(graph: dict[str, set[str]], room: str) -> set[str]:
    return set().union(*({b} | _reached(graph, b) for b in graph[room]))


def order(graph: dict[str, set[str]]) -> list[str]:
    """Return the rooms, each after what it imports, the longest chain unbroken."""
    placed: list[str] = []

    def place(room: str) -> None:
        if room not in placed:
            for below in sorted(graph[room], key=lambda b: (-_height(graph, b), b)):
                place(below)
            placed.append(room)

    place(_TOP)
    return placed


def _height(graph: dict[str, set[str]], room: str) -> int:
    return 1 + max((_height(graph, below) for below in graph[room]), default=0)


def sides(arcs: Iterable[Arc]) -> tuple[list[Arc], list[Arc]]:
    """Return the arcs of the left and of the right side, so that few cross."""
    both: tuple[list[Arc], list[Arc]] = ([], [])
    for arc in sorted(arcs, key=lambda arc: arc.start):
        min(both, key=lambda side: sum(map(arc.crosses, side))).append(arc)
    return both


def drawing() -> str:
    """Return the drawing as SVG."""
    words = rooms()
    graph = reduced(imports(words))
    names = order(graph)
    row = {name: place for place, name in enumerate(names)}
    edges = [Arc(row[b], row[a]) for a in names for b in graph[a]]
    left, right = sides(edge for edge in edges if edge.end - edge.start > 1)
    steps = [
        place for place, step in enumerate(pairwise(names)) if step[0] in graph[step[1]]
    ]
    height = _ROW * len(names) + _ROW - _BOX
    parts = [
        *(_step(place) for place in steps),
        *(_curve(arc, left, _LEFT, -1) for arc in left),
        *(_curve(arc, right, _RIGHT, 1) for arc in right),
        *(_box(name, words[name], row[name]) for name in names),
    ]
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" '
            f'width="{_WIDTH}" height="{height}" role="img">',
            "<title>The rooms of consistent_id; an arrow leads from a room to one that "
            "imports it</title>",
            f"<style>{_STYLE}</style>",
            '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" '
            'markerWidth="8" markerHeight="8" markerUnits="userSpaceOnUse" '
            'orient="auto"><path class="head" d="M0 0L8 4L0 8Z"/></marker></defs>',
            f'<rect class="page" width="{_WIDTH}" height="{height}" rx="8"/>',
            *parts,
            "</svg>\n",
        )
    )


def _top(row: int) -> int:
    return _ROW * row + _ROW - _BOX


def _step(row: int) -> str:
    x, y = _LEFT + 40, _top(row) + _BOX
    return f'<path class="arrow" d="M{x} {y}V{y + _ROW - _BOX}"/>'


def _curve(arc: Arc, side: list[Arc], x: int, away: int) -> str:
    """Return an arrow beside the boxes, farther out than those that it encloses."""
    inside = [a for a in side if a != arc and arc.start <= a.start and a.end <= arc.end]
    out = x + away * (24 + _LANE * len(inside))
    y, end = _top(arc.start) + _BOX - 9, _top(arc.end) + 9
    bend = away * 10
    return (
        f'<path class="arrow" d="M{x} {y}H{out - bend}Q{out} {y} {out} {y + 10}'
        f'V{end - 10}Q{out} {end} {out - bend} {end}H{x}"/>'
    )


def _box(name: str, words: str, row: int) -> str:
    y = _top(row)
    base = y + _BOX // 2 + _TEXT // 3 + 1
    return (
        f'<rect class="box" x="{_LEFT}" y="{y}" width="{_RIGHT - _LEFT}" '
        f'height="{_BOX}" rx="7"/>'
        f'<text class="name" x="{_LEFT + 14}" y="{base}">{name}</text>'
        f'<text x="{_LEFT + _WORDS}" y="{base}">{escape(words)}</text>'
    )


if __name__ == "__main__":
    DRAWING.write_text(drawing(), encoding="utf-8")
