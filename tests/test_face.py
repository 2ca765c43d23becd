"""Public names: imported when asked for, and never hidden by a module of that name."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import consistent_id
from consistent_id._face import homes

PACKAGE = Path(consistent_id.__file__).parent


def in_a_new_process(code):
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout


def test_every_public_name_is_what_its_module_calls_so():
    assert len(homes()) > 150
    for name, module in homes().items():
        value = getattr(consistent_id, name)
        assert value is getattr(importlib.import_module(module), name)


def test_the_stub_names_what_it_imports_and_nothing_else():
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    (listed,) = (
        ast.literal_eval(node.value)
        for node in stub.body
        if isinstance(node, ast.Assign)
    )
    assert sorted(listed) == consistent_id.__all__ == sorted(homes())


def test_no_module_has_the_name_of_something_public():
    modules = {path.stem for path in PACKAGE.glob("*.py")}
    modules |= {path.name for path in PACKAGE.iterdir() if path.is_dir()}
    assert not modules & set(consistent_id.__all__)


def test_importing_a_module_does_not_change_what_a_public_name_means():
    code = (
        "import consistent_id.problems.study, consistent_id.cli.results;"
        "import consistent_id as ci;"
        "print(all(callable(getattr(ci, n)) for n in"
        " ('bootstrap', 'uncertainty', 'cross_check', 'shadow_prices',"
        " 'constraint_costs', 'base_feasibility', 'diagnose', 'compare')))"
    )
    assert in_a_new_process(code) == "True\n"


def test_importing_the_package_imports_nothing_that_it_does_not_need():
    code = "import sys, consistent_id; print(*sys.modules)"
    loaded = in_a_new_process(code).split()
    assert "numpy" not in loaded
    assert [m for m in loaded if m.startswith("consistent_id")] == ["consistent_id"]


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
