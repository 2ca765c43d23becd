"""Notebooks of the documentation run from their first cell to their last one."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells(path):
    return json.loads(path.read_text())["cells"]


def code(path):
    return ["".join(c["source"]) for c in cells(path) if c["cell_type"] == "code"]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_in_one_namespace(path, tmp_path, monkeypatch, capsys):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = {}
    for number, cell in enumerate(code(path)):
        exec(compile(cell, f"{path.name}, cell {number}", "exec"), names)
    pyplot.close("all")
    assert capsys.readouterr().out


def test_notebooks_are_stored_without_outputs():
    assert len(NOTEBOOKS) == 4
    for path in NOTEBOOKS:
        for cell in cells(path):
            assert not cell.get("outputs"), path.name
            assert cell.get("execution_count") is None, path.name


def test_the_page_of_notebooks_names_each():
    page = (ROOT / "docs" / "notebooks.md").read_text()
    assert [p.name for p in NOTEBOOKS if f"(notebooks/{p.name})" not in page] == []
