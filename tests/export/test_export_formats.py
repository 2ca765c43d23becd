"""The table of export formats is what is exported, offered and documented."""

import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from estimates import random_estimate
from robots import random_robot

from consistent_id import ProblemError, to_json, to_urdf
from consistent_id.export.export_formats import EXPORT_FORMATS, exported

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def estimate():
    rng = np.random.default_rng(4)
    _, robot = random_robot(rng, 2)
    return random_estimate(rng, robot)


@pytest.mark.parametrize("known", EXPORT_FORMATS, ids=lambda known: known.name)
def test_every_entry_exports_and_takes_a_source_if_it_says_so(known, estimate):
    if known.name == "mjcf":
        pytest.importorskip("mujoco")
    export = exported(estimate, known.name)
    assert export.format == known.name and len(export.content) > 100
    module = import_module(f"consistent_id.export.{known.module}")
    signature = inspect.signature(getattr(module, known.function))
    assert ("source" in signature.parameters) == known.takes_source


def test_a_format_says_the_same_by_name_and_by_its_function(estimate, tmp_path):
    assert exported(estimate, "json") == to_json(estimate)
    source = to_urdf(estimate).save(tmp_path / "robot.urdf")
    assert exported(estimate, "urdf", source=source) == to_urdf(estimate, source)


def test_a_source_for_other_formats_and_unknown_formats_are_refused(estimate):
    with pytest.raises(ProblemError, match="a source is for URDF and MJCF, not for c"):
        exported(estimate, "c", source=Path("robot.urdf"))
    with pytest.raises(ProblemError, match="no format 'jason'; known: json"):
        exported(estimate, "jason")


@pytest.mark.parametrize("known", EXPORT_FORMATS, ids=lambda known: known.name)
def test_every_format_is_documented(known):
    assert f"`{known.name}`" in (ROOT / "docs" / "exports.md").read_text()


def test_the_table_imports_no_array_library():
    code = "import sys, consistent_id.export.export_formats; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "consistent_id.export.export_formats" in found.stdout.split()
    assert "numpy" not in found.stdout.split()
