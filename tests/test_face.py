"""Public names: imported when asked for, and never hidden by a module of that name."""

import ast
import importlib
import subprocess
import sys
from doctest import DocTestFinder
from pathlib import Path

import pytest

import consistent_id
from consistent_id._support.face import ROOMS, homes

PACKAGE = Path(consistent_id.__file__).parent


def in_a_new_process(code):
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout


PACKAGES = [
    "consistent_id",
    *(
        ".".join(("consistent_id", *path.parent.relative_to(PACKAGE).parts))
        for path in PACKAGE.rglob("*/__init__.pyi")
    ),
]


def test_few_names_stand_at_the_top():
    assert 40 < len(consistent_id.__all__) <= 60


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_what_its_module_calls_so(package):
    owner = importlib.import_module(package)
    for name, module in homes(package).items():
        value = getattr(owner, name)
        assert value is getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("package", PACKAGES)
def test_the_stub_names_what_it_imports_and_nothing_else(package):
    owner = importlib.import_module(package)
    stub = ast.parse(Path(owner.__file__).with_suffix(".pyi").read_text())
    (listed,) = (
        ast.literal_eval(node.value)
        for node in stub.body
        if isinstance(node, ast.Assign)
    )
    assert sorted(listed) == owner.__all__ == sorted(homes(package))


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_has_the_name_of_something_public(package):
    owner = importlib.import_module(package)
    folder = Path(owner.__file__).parent
    modules = {path.stem for path in folder.glob("*.py")}
    modules |= {path.name for path in folder.iterdir() if path.is_dir()}
    assert not modules & set(owner.__all__)


def test_every_name_at_the_top_has_an_example_in_its_docstring():
    """They run with the tests of the modules (``--doctest-modules``)."""
    without = []
    for name in consistent_id.__all__:
        value = getattr(consistent_id, name)
        (found,) = [
            test
            for test in DocTestFinder(recurse=False).find(value, name, globs={})
            or [None]
        ]
        if found is None or not any(example.want for example in found.examples):
            without.append(name)
    assert not without


def test_a_name_that_moved_to_a_submodule_works_with_a_warning():
    for old, room in (("to_numpy", "export"), ("Fleet", "fleet")):
        says = rf"consistent_id\.{room}\.{old} now"
        with pytest.warns(DeprecationWarning, match=says):
            moved = getattr(consistent_id, old)
        owner = importlib.import_module(f"consistent_id.{room}")
        assert moved is getattr(owner, old)


@pytest.mark.parametrize("name", ["UNSET", "to_numpi"])
def test_a_name_that_is_not_ours_imports_no_submodule(name):
    """Pickle asks every module that is imported for the name of a value without one."""
    code = (
        "import sys, consistent_id;"
        f"print(hasattr(consistent_id, {name!r}),"
        " len([m for m in sys.modules if m.startswith('consistent_id')]) < 8)"
    )
    assert in_a_new_process(code) == "False True\n"


@pytest.mark.slow
def test_submodules_are_attributes_of_the_package():
    code = "import consistent_id as ci; print([getattr(ci, r).__name__ for r in ROOMS])"
    code = f"from consistent_id._support.face import ROOMS; {code}"
    assert eval(in_a_new_process(code))[0] == "consistent_id.robot"
    assert set(ROOMS) <= set(dir(consistent_id))


@pytest.mark.slow
def test_importing_a_module_does_not_change_what_a_public_name_means():
    code = (
        "import consistent_id.problems.study, consistent_id.report.results;"
        "import consistent_id as ci;"
        "print(all(callable(getattr(ci.comparison, n)) for n in"
        " ('bootstrap', 'shadow_prices', 'constraint_costs',"
        " 'base_feasibility')), callable(ci.compare), callable(ci.uncertainty))"
    )
    assert in_a_new_process(code) == "True True True\n"


def test_importing_the_package_imports_nothing_that_it_does_not_need():
    code = "import sys, consistent_id; print(*sys.modules)"
    loaded = in_a_new_process(code).split()
    assert "numpy" not in loaded
    assert [m for m in loaded if m.startswith("consistent_id")] == ["consistent_id"]


@pytest.mark.slow
def test_a_side_building_has_public_names_of_its_own():
    names = "lint_robot, repair_urdf, nearest_inertia, LintFinding, Repair"
    code = (
        f"from consistent_id.repair import {names}\n"
        "import sys\n"
        "print('scipy' in sys.modules)"
    )
    assert in_a_new_process(code) == "False\n"


def test_a_star_import_brings_every_public_name():
    names = {}
    exec("from consistent_id import *", names)
    assert set(consistent_id.__all__) <= set(names)
    assert set(consistent_id.__all__) <= set(dir(consistent_id))


def test_a_misspelt_name_is_an_attribute_error_and_a_failed_import():
    with pytest.raises(AttributeError, match="'consistent_id' has no attribute 'comp'"):
        consistent_id.comp  # noqa: B018
    with pytest.raises(ImportError):
        from consistent_id import comp  # noqa: F401


def test_a_name_that_is_gone_says_what_does_its_work():
    for name in ("comparison.cross_check", "estimation.smooth_least_squares"):
        room, own = name.split(".")
        module = importlib.import_module(f"consistent_id.{room}")
        with pytest.raises(AttributeError, match="certificate of an estimate proves"):
            getattr(module, own)
