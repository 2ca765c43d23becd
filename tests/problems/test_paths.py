"""What a problem file of a stranger may name."""

from shutil import copytree

import msgspec
import pytest
from logged import write_arm

from consistent_id import ProblemError, draft_problem, load_problem, load_problems
from consistent_id.problems.paths import moved


@pytest.fixture(scope="module")
def drafted(tmp_path_factory):
    """A folder with a problem, a robot and a log."""
    folder = tmp_path_factory.mktemp("drafted")
    urdf, log = write_arm(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("CONSISTENT_ID_DATASETS", raising=False)
        text = draft_problem(urdf, log, select=False, cutoff=10.0).text(folder)
    (folder / "problem.toml").write_text(text)
    return folder


@pytest.fixture
def here(drafted, tmp_path, monkeypatch):
    """A copy of that folder of the test's own, and no other data folder."""
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    return copytree(drafted, tmp_path / "study")


def changed(folder, old, new):
    file = folder / "problem.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_what_lies_beside_the_file_may_be_named(here):
    assert load_problem(here).training


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('urdf = "arm.urdf"', 'urdf = "../arm.urdf"', "model.urdf"),
        ('urdf = "arm.urdf"', 'urdf = "/etc/passwd"', "model.urdf"),
        ('file = "log.csv"', 'file = "../log.csv"', "data.recordings.file"),
        ("[data]\n", '[data]\nfolder = "/tmp"\n', "data.folder"),
        (
            "[constraints]\n",
            "[[constraints.density_on]]\nlink='fore'\nmesh='/x.stl'\n[constraints]\n",
            "mesh",
        ),
    ],
)
def test_what_lies_elsewhere_may_not_be_named(here, old, new, key):
    changed(here, old, new)
    with pytest.raises(ProblemError, match=rf"{key} leads to .*--trust"):
        load_problem(here)


def test_a_dollar_in_a_name_is_no_variable(tmp_path, monkeypatch):
    """A draft writes what is read: of a robot `$$`, of a log, which stands as it is."""
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    monkeypatch.setenv("HOME", "/nowhere")
    folder = tmp_path / "cost$HOME"
    folder.mkdir()
    urdf, log = (
        file.rename(file.with_name(f"5$HOME{file.name}")) for file in write_arm(folder)
    )
    draft = draft_problem(urdf, log, select=False, cutoff=10.0)
    (folder / "problem.toml").write_text(draft.text(folder))
    assert load_problem(folder).training
    (tmp_path / "problem.toml").write_text(draft.text(tmp_path))
    assert load_problem(tmp_path).training


def test_a_problem_that_is_moved_names_the_same_files(here, monkeypatch):
    changed(here, 'urdf = "arm.urdf"', 'urdf = "5$$.urdf"')
    (here / "arm.urdf").rename(here / "5$.urdf")
    other = here.parent / "other"
    other.mkdir()
    table = load_problem(here).table
    assert moved(table, here, other).model.urdf == "../study/5$$.urdf"
    away = msgspec.structs.replace(table.model, urdf="${CONSISTENT_ID_DATASETS}/a.urdf")
    table = msgspec.structs.replace(table, model=away)
    assert moved(table, here, other).model.urdf == away.urdf


def test_a_link_leads_where_it_leads(here):
    (here / "arm.urdf").rename(here.parent / "arm.urdf")
    (here / "arm.urdf").symlink_to(here.parent / "arm.urdf")
    with pytest.raises(ProblemError, match=r"model\.urdf leads to"):
        load_problem(here)
    assert load_problem(here, trust=True).training


def test_other_environment_variables_are_not_read(here, monkeypatch):
    monkeypatch.setenv("SECRET", str(here))
    changed(here, 'urdf = "arm.urdf"', 'urdf = "${SECRET}/arm.urdf"')
    with pytest.raises(ProblemError, match="environment variable SECRET"):
        load_problem(here)
    assert load_problem(here, trust=True).training
    (problem,) = load_problems(here, trust=True)
    assert problem.training


def test_the_folder_of_the_data_may_be_named(here, monkeypatch, tmp_path):
    monkeypatch.setenv("CONSISTENT_ID_DATASETS", str(tmp_path))
    (here / "arm.urdf").rename(tmp_path / "arm.urdf")
    changed(here, 'urdf = "arm.urdf"', 'urdf = "${CONSISTENT_ID_DATASETS}/arm.urdf"')
    assert load_problem(here).training
