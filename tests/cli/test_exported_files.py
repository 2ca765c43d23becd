"""All files that `export` writes are listed: formats times files."""

import pytest
from commanded_leg import write_leg
from schemas import parsed

from consistent_id import Study, load_problem
from consistent_id.cli import main
from consistent_id.export.export_formats import EXPORT_FORMATS

pytest.importorskip("mujoco")
pytestmark = pytest.mark.slow

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture(scope="module")
def leg(tmp_path_factory):
    """A problem of a leg with a mesh, and an estimate."""
    folder = tmp_path_factory.mktemp("leg")
    write_leg(folder)
    (folder / "shapes").mkdir()
    (folder / "shapes" / "thigh.obj").write_text(OBJ)
    text = (folder / "leg.xml").read_text()
    asset = '<asset><mesh name="m" file="shapes/thigh.obj"/></asset><worldbody>'
    body = '<body name="thigh" pos="0 0 0">'
    geom = '<geom type="mesh" mesh="m" contype="0" conaffinity="0" mass="0"/>'
    text = text.replace("<worldbody>", asset).replace(body, body + geom)
    (folder / "leg.xml").write_text(text)
    study = Study(load_problem(folder))
    return folder, study.recommended.estimate.save(folder / "estimate.json")


def export(leg, form, file, *more):
    folder, estimate = leg
    options = ["--format", form, "--output", str(file), "--copy-files", "--json"]
    accepted = ["--accept", "misfit", "--estimate", str(estimate)]
    return main(["export", str(folder), *options, *accepted, *more])


@pytest.mark.parametrize("form", [known.name for known in EXPORT_FORMATS])
def test_the_files_of_the_answer_are_those_in_the_folder(form, leg, tmp_path, capsys):
    assert export(leg, form, tmp_path / "leg.out") == 0
    record = parsed(capsys.readouterr().out, "export-1")
    there = {str(file) for file in tmp_path.rglob("*") if file.is_file()}
    assert set(record["files"]) == there
    assert len(record["files"]) == len(there)
    assert record["files"][0] == record["written"]
    assert record["files"][-1] == record["readme"]
    beside = {"mjcf": "thigh.obj", "urdf": "leg.drives.json", "c": "leg.h"}
    assert any(beside.get(form, "README.md") in file for file in there)


def test_nothing_is_listed_where_nothing_is_written(leg, tmp_path, capsys):
    assert export(leg, "urdf", tmp_path / "leg.urdf", "--dry-run") == 0
    assert parsed(capsys.readouterr().out, "export-1")["files"] == []
    assert not list(tmp_path.iterdir())
