"""Imports run one way, room by room, and heavy libraries are imported where used."""

import ast
import runpy
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import consistent_id

PACKAGE = Path(consistent_id.__file__).parent
DOCS = Path(__file__).parent.parent / "docs"

# The core: a module imports from its own room and from those before it.
CORE = (
    "errors _support robot recordings regression constraints motion estimation "
    "export comparison diagnosis problems report excitation"
).split()

# Side buildings import the core.  Only the shell tool's commands import them, inside
# functions, so that nobody waits for what only some need.
SIDE = "laboratory rollout fleet standing repair service".split()

# Which other side buildings one imports, with the reason beside it.
NEIGHBOURS: dict[str, set[str]] = {}

ROOMS = (*CORE, *SIDE, "cli")

HEAVY = set(
    "cvxpy casadi pinocchio scipy matplotlib pyarrow h5py rosbags apsw sqlite3 pandas "
    "xarray clarabel coal mujoco viser trimesh".split()
)

# Subclasses of a heavy library's classes; imported inside functions alone.
LAZY = "consistent_id.excitation.callbacks"


def _imported(tree: ast.AST) -> list[str]:
    names = []
    for node in _statements(tree):
        if isinstance(node, ast.ImportFrom):
            names.append(node.module or "")
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return names


@cache
def _statements(tree: ast.AST) -> list[ast.AST]:
    """Return all statements of a module, those inside others too."""
    return list(_rooms()["statements"](tree))


@cache
def _rooms() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "rooms.py"))


@cache
def _modules() -> dict[Path, ast.Module]:
    return _rooms()["modules"]()


def test_imports_run_one_way_room_by_room():
    rooms = {name: place for place, name in enumerate(ROOMS)}
    for path, tree in _modules().items():
        room = path.parts[0].removesuffix(".py")
        if room in ("__init__", "__main__", "signals"):  # the package's face
            continue
        for imported in _imported(tree):
            if imported.startswith("consistent_id."):
                other = imported.split(".")[1]
                assert rooms[other] <= rooms[room], f"{path} imports {imported}"


def _side_buildings(nodes: Iterable[ast.AST]) -> set[str]:
    """Return the side buildings that statements import, the package's names too."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            module = node.module or ""
            names = [f"{module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        parts = [name.split(".") for name in names]
        found |= {p[1] for p in parts if p[0] == "consistent_id" and len(p) > 1}
    return found & set(SIDE)


def test_side_buildings_are_imported_by_commands_alone():
    for path, tree in _modules().items():
        room = path.parts[0].removesuffix(".py")
        others = _side_buildings(_statements(tree)) - {room}
        if room in SIDE:
            assert others <= NEIGHBOURS.get(room, set()), f"{path} imports {others}"
        elif room != "cli":
            assert not others, f"{path} imports {others}"


def test_commands_import_side_buildings_inside_functions():
    for path, tree in _modules().items():
        if path.parts[0] == "cli":
            assert not _side_buildings(tree.body), path


def test_heavy_libraries_are_not_imported_at_the_top_of_a_module():
    for path, tree in _modules().items():
        if path.name == "callbacks.py":
            continue
        top = [
            node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)
        ]
        for imported in _imported(ast.Module(body=top, type_ignores=[])):
            assert imported.split(".")[0] not in HEAVY, f"{path} imports {imported}"
            assert imported != LAZY, path


def _needed(path: Path, tree: ast.Module) -> Iterator[str]:
    """What has to be imported before a module, packages that are not its own too."""
    own = path.with_suffix("").parts
    for node in tree.body:
        if not isinstance(node, ast.ImportFrom):
            continue
        parts = tuple((node.module or "").split("."))[1:]
        for size in range(1, len(parts) + 1):
            if parts[:size] != own[:size]:
                yield ".".join(parts[:size])


def test_any_module_can_be_imported_first():
    graph = {}
    for path, tree in _modules().items():
        parts = path.with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        graph[name] = set(_needed(path, tree)) - {name}
    TopologicalSorter(graph).prepare()


def test_no_modules_import_each_other_in_a_circle():
    """Imports inside functions and for types count: nothing is hidden by them."""
    names = {
        ".".join(part for part in path.with_suffix("").parts if part != "__init__")
        for path in _modules()
    }
    graph = {}
    for path, tree in _modules().items():
        parts = [part for part in path.with_suffix("").parts if part != "__init__"]
        own, found = ".".join(parts), set()
        for node in _statements(tree):
            if not isinstance(node, ast.ImportFrom) or node.module is None:
                continue
            module = node.module.removeprefix("consistent_id").removeprefix(".")
            inner = {f"{module}.{alias.name}".strip(".") for alias in node.names}
            found |= (inner & names) or ({module} & names)
        graph[own] = found - {own}
    TopologicalSorter(graph).prepare()


def test_estimators_do_not_know_casadi():
    for path, tree in _modules().items():
        if path.parts[0] == "estimation":
            assert "casadi" not in _imported(tree)


def test_the_drawing_of_the_rooms_is_current():
    shown = _rooms()["DRAWING"].read_text()
    assert shown == _rooms()["drawing"](), "draw it again: python docs/rooms.py"


def test_the_drawing_leaves_out_what_follows_from_other_arrows():
    reduced = _rooms()["reduced"]
    graph = {"a": set(), "b": {"a"}, "c": {"a", "b"}, "d": {"a"}, "e": {"c", "d", "a"}}
    assert reduced(graph) == {
        "a": set(),
        "b": {"a"},
        "c": {"b"},
        "d": {"a"},
        "e": {"c", "d"},
    }


def test_files_that_the_page_of_the_rooms_names_exist():
    page = (DOCS / "architecture.md").read_text()
    named = [word for word in page.split("`")[1::2] if "/" in word and " " not in word]
    roots = (PACKAGE, DOCS.parent)
    assert len(named) > 9
    assert not [n for n in named if not any((root / n).exists() for root in roots)]


def test_a_class_name_means_one_thing():
    places: dict[str, list[str]] = {}
    for path, tree in _modules().items():
        for node in _statements(tree):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name.lstrip("_"), []).append(str(path))
    assert len(places) > 300
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_a_file_name_means_one_thing():
    """A command's file has the name of the command, whatever else has it."""
    places: dict[str, list[str]] = {}
    for path in _modules():
        if path.name != "__init__.py" and path.parts[0] != "cli":
            places.setdefault(path.name, []).append(str(path))
    assert len(places) > 300
    assert not {name: where for name, where in places.items() if len(where) > 1}
