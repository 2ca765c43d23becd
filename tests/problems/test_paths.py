"""What a problem file of a stranger may name."""

import logging
import os
import string
from pathlib import Path
from shutil import copy, copytree

import msgspec
import pytest
from logged import write_arm

from consistent_id import ProblemError, draft_problem, load_problem
from consistent_id.problems import load_problems
from consistent_id.problems.file import (
    DataTable,
    ModelTable,
    ProblemTable,
    RecordingTable,
    TrackTable,
    problem_table,
    read_problem_table,
)
from consistent_id.problems.kept_text import toml_text, write_problem
from consistent_id.problems.parameter_tables import ConstraintsTable, ShapeTable
from consistent_id.problems.paths import moved, names_outside, record_own
from consistent_id.problems.task_tables import ExcitationTable, SceneTable


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
            "[[constraints.density_on]]\nlink='fore'\nmesh='/etc/passwd'\n[constraints]\n",
            "mesh",
        ),
    ],
)
def test_what_lies_elsewhere_may_not_be_named(here, old, new, key):
    for name in ("arm.urdf", "log.csv"):
        copy(here / name, here.parent)
    changed(here, old, new)
    with pytest.raises(ProblemError, match=rf"{key} leads to .*--trust"):
        load_problem(here)


def test_a_file_that_is_gone_is_missed_not_mistrusted(here):
    """Trust would not bring it back."""
    (here / "arm.urdf").rename(here.parent / "arm.urdf")
    changed(here, 'urdf = "arm.urdf"', 'urdf = "../arm.urdf"')
    with pytest.raises(ProblemError, match=r"model\.urdf leads to .*--trust"):
        load_problem(here)
    (here.parent / "arm.urdf").unlink()
    with pytest.raises(ProblemError, match="no such file is there") as refused:
        load_problem(here)
    assert "trust" not in str(refused.value)


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


def test_a_mesh_is_checked_where_it_is_read(here, monkeypatch):
    """A dollar in its name is a dollar, whatever the variable after it leads to."""
    monkeypatch.setenv("CONSISTENT_ID_DATASETS", str(here))
    (here / "${CONSISTENT_ID_DATASETS}").symlink_to("/etc")
    mesh = "link='fore'\nmesh='${CONSISTENT_ID_DATASETS}/x.stl'\n[constraints]\n"
    changed(here, "[constraints]\n", f"[[constraints.density_on]]\n{mesh}")
    with pytest.raises(ProblemError, match=r"density_on\.mesh leads to"):
        load_problem(here)


# What a run of this user has written -------------------------------------------------


@pytest.fixture
def own(here, monkeypatch, tmp_path):
    """A folder with a problem that a run of this user wrote, of inputs elsewhere."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "results" / "robot"
    write_problem(text_of(here, folder), folder / "problem.toml")
    return folder


def text_of(here, folder):
    return toml_text(moved(load_problem(here).table, here, folder), {})


def test_what_was_written_here_opens_again_wherever_its_inputs_lie(own):
    assert 'urdf = "../../study/arm.urdf"' in (own / "problem.toml").read_text()
    assert load_problem(own).training


def test_without_the_record_it_is_a_strangers(own, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "other"))
    with pytest.raises(ProblemError, match=r"urdf leads to .*no run of yours"):
        load_problem(own)
    assert load_problem(own, trust=True).training


def test_its_user_may_go_on_editing_it(own):
    changed(own, "name = ", "# mine\nname = ")
    changed(own, "[drive]\n", "[drive]\nspring = true\n")
    assert load_problem(own).table.drive.spring


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("study/arm.urdf", "study/log.csv", "model.urdf"),
        ("study/arm.urdf", "study/../study2/arm.urdf", "model.urdf"),
        ('folder = "../../study"', 'folder = "../.."', "data.folder"),
        ('file = "log.csv"', 'file = "../secret.csv"', "data.recordings.file"),
        ('file = "log.csv"', 'file = "../study/arm.urdf"', "data.recordings.file"),
        (
            "[model]",
            "[excitation.scene]\npackages=['../../study']\n[model]",
            "packages",
        ),
        (
            "[model]",
            "[[constraints.density_on]]\nlink='fore'\nmesh='../../study/arm.urdf'\n"
            "[model]",
            "mesh",
        ),
    ],
)
def test_another_place_or_the_same_under_another_key_is_refused(own, old, new, key):
    study = own.parent.parent / "study"
    copytree(study, study.parent / "study2")
    copy(study / "log.csv", study.parent / "secret.csv")
    changed(own, old, new)
    with pytest.raises(ProblemError, match=rf"{key} leads to .*--trust"):
        load_problem(own)


@pytest.mark.parametrize(
    "make",
    [copytree, lambda a, b: a.rename(b), lambda a, b: b.mkdir() or copy_to(a, b)],
)
def test_the_same_file_in_another_folder_is_refused(own, make):
    make(own, own.parent / "other")
    with pytest.raises(ProblemError, match=r"model\.urdf leads to"):
        load_problem(own.parent / "other")


def copy_to(folder, other):
    copy(folder / "problem.toml", other / "problem.toml")


def test_the_same_file_under_another_name_is_refused(own):
    copy(own / "problem.toml", own / "other.toml")
    with pytest.raises(ProblemError, match=r"model\.urdf leads to"):
        load_problem(own / "other.toml")


def test_a_link_to_a_file_of_ones_own_is_a_file_where_the_link_is(own, tmp_path):
    """Its names count from the link's folder."""
    other = tmp_path / "strangers" / "robot"
    other.mkdir(parents=True)
    (other / "problem.toml").symlink_to(own / "problem.toml")
    with pytest.raises(ProblemError, match=r"model\.urdf leads to"):
        load_problem(other)


def test_a_name_whose_link_was_turned_elsewhere_is_refused(own, here, tmp_path):
    here.rename(tmp_path / "hidden")
    (tmp_path / "study").symlink_to(tmp_path / "hidden")
    with pytest.raises(ProblemError, match=r"model\.urdf leads to"):
        load_problem(own)


def test_another_way_to_the_same_folder_is_the_same_file(own, tmp_path, monkeypatch):
    (tmp_path / "way").symlink_to(own.parent)
    assert load_problem(tmp_path / "way" / "robot").training
    monkeypatch.chdir(own)
    assert load_problem(".").training


def test_a_folder_of_data_that_is_no_longer_stated_is_still_where_it_was(
    own, here, monkeypatch, tmp_path
):
    folder = tmp_path / "results" / "second"
    monkeypatch.setenv("CONSISTENT_ID_DATASETS", str(here))
    write_problem(text_of(here, folder), folder / "problem.toml")
    monkeypatch.delenv("CONSISTENT_ID_DATASETS")
    assert load_problem(folder).training


def test_a_variable_counts_with_what_it_was_when_the_file_was_written(
    own, here, monkeypatch, tmp_path
):
    monkeypatch.setenv("ROBOTS", str(here))
    text = (own / "problem.toml").read_text()
    text = text.replace("../../study/arm.urdf", "${ROBOTS}/arm.urdf")
    write_problem(text, own / "problem.toml")
    assert load_problem(own).training
    other = copytree(here, tmp_path / "robots")
    monkeypatch.setenv("ROBOTS", str(other))
    with pytest.raises(ProblemError, match="environment variable ROBOTS"):
        load_problem(own)
    monkeypatch.setenv("ROBOTS2", str(here))
    changed(own, "${ROBOTS}", "${ROBOTS2}")
    with pytest.raises(ProblemError, match="environment variable ROBOTS2"):
        load_problem(own)


def test_a_variable_that_leads_into_the_files_own_folder_is_recorded_too(
    own, here, monkeypatch
):
    monkeypatch.setenv("ROBOTS", str(own))
    copy(here / "arm.urdf", own)
    text = (own / "problem.toml").read_text()
    text = text.replace("../../study/arm.urdf", "${ROBOTS}/arm.urdf")
    (own / "problem.toml").write_text(text)
    with pytest.raises(ProblemError, match="environment variable ROBOTS"):
        load_problem(own)
    write_problem(text, own / "problem.toml")
    assert load_problem(own).training


def test_a_variable_that_leads_to_the_same_place_as_a_plain_name_is_another_name(
    own, here, monkeypatch
):
    monkeypatch.setenv("HOME_OF_ALL", str(here))
    changed(own, "../../study/arm.urdf", "${HOME_OF_ALL}/arm.urdf")
    with pytest.raises(ProblemError, match="environment variable HOME_OF_ALL"):
        load_problem(own)


def test_a_state_folder_that_cannot_be_written_leaves_the_file_a_strangers(
    own, here, monkeypatch, tmp_path, caplog
):
    (tmp_path / "full").write_text("no folder")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "full"))
    folder = tmp_path / "results" / "second"
    with caplog.at_level(logging.WARNING):
        write_problem(text_of(here, folder), folder / "problem.toml")
    assert "second/problem.toml is not recorded" in caplog.text
    with pytest.raises(ProblemError, match="--trust"):
        load_problem(folder)


# Moved -------------------------------------------------------------------------------

FILES = sorted(
    [*Path("problems").glob("*/*.toml"), *Path("benchmarks").glob("*/*.toml")]
)
# One of each key; a wrong one would lead elsewhere, or nowhere.
ALL = ProblemTable(
    name="all",
    model=ModelTable(urdf="a/arm.urdf", mjcf="$$HOME/arm.xml"),
    data=DataTable(
        folder="logs",
        recordings=[
            RecordingTable(
                file="$HOME.csv",
                role="training",
                tracks=[TrackTable(file="../t.csv", channel="torque", column="x")],
            )
        ],
    ),
    constraints=ConstraintsTable(
        centre_of_mass_in=[ShapeTable(link="a", mesh="a/$HOME.stl")],
        density_on=[ShapeTable(link="a", mesh="b.stl"), ShapeTable(link="b")],
    ),
    excitation=ExcitationTable(
        scene=SceneTable(packages=["a", "../packages"], planning_scene="scene.yaml")
    ),
)
PATH_KEYS = ("urdf", "mjcf", "folder", "mesh", "packages", "planning_scene", "file")


def leaves(value, key=""):
    """Yield the key and value of everything in a table."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from leaves(inner, f"{key}.{name}")
    elif isinstance(value, list | tuple):
        for place, inner in enumerate(value):
            yield from leaves(inner, f"{key}.{place}")
    else:
        yield key, value


def is_path(key, value):
    named = [part for part in key.split(".") if not part.isdigit()][-1] in PATH_KEYS
    return named and isinstance(value, str)


def place_of(key, value, folder, data):
    """Return where a path leads, as `Problem.file` and the readers find it."""
    if key.endswith(".file"):
        return (folder / string.Template(data).substitute(os.environ) / value).resolve()
    literal = key.endswith(".mesh")
    found = value if literal else string.Template(value).substitute(os.environ)
    return (folder / found).resolve()


@pytest.mark.parametrize("file", [*FILES, None], ids=str)
def test_a_problem_that_is_moved_names_the_same_and_says_the_same(
    file, tmp_path, monkeypatch
):
    monkeypatch.setenv("CONSISTENT_ID_DATASETS", "/data")
    old = ALL if file is None else read_problem_table(file)
    before, after = Path("problems/rx60") if file is None else file.parent, tmp_path
    text = toml_text(moved(old, before, after), {})
    new = problem_table(text, after / "problem.toml")
    was, now = (dict(leaves(msgspec.to_builtins(table))) for table in (old, new))
    assert was.keys() == now.keys()
    assert {k: v for k, v in was.items() if not is_path(k, v)} == {
        k: v for k, v in now.items() if not is_path(k, v)
    }
    paths = [key for key, value in was.items() if is_path(key, value)]
    assert len(paths) == 10 if file is None else paths or old.model.modified_dh
    for key in paths:
        places = (
            place_of(key, said[key], folder, said.get(".data.folder"))
            for said, folder in ((was, before), (now, after))
        )
        assert next(places) == next(places), key


def test_every_path_of_a_table_is_looked_at(tmp_path):
    """Of the table with all keys, each path leads out when its folder is moved."""
    table = moved(ALL, Path("problems/rx60"), tmp_path)
    said = [
        name.sentence.split()[0] for name in names_outside(table, tmp_path / "x.toml")
    ]
    keys = [
        ".".join(p for p in key.split(".") if p and not p.isdigit())
        for key, value in leaves(msgspec.to_builtins(ALL))
        if is_path(key, value)
    ]
    assert sorted(said) == sorted(keys)
    record_own(table, tmp_path / "x.toml")
    assert not list(names_outside(table, tmp_path / "x.toml"))


def test_no_key_of_the_file_sounds_like_a_path_and_is_none():
    """A key that is added for a file has to be known to `moved`."""
    known = {
        key for key, value in leaves(msgspec.to_builtins(ALL)) if is_path(key, value)
    }
    known = {
        ".".join(p for p in key.split(".") if p and not p.isdigit()) for key in known
    }
    assert {
        key for key in keys_of(ProblemTable) if key.split(".")[-1] in PATH_KEYS
    } == (known)


def keys_of(kind, before=""):
    """Yield the key of every field of a table, and of the tables in it."""
    for field in msgspec.structs.fields(kind):
        yield f"{before}{field.encode_name}"
        for inner in tables_in(field.type):
            yield from keys_of(inner, f"{before}{field.encode_name}.")


def tables_in(kind):
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [kind]
    return [
        inner for part in getattr(kind, "__args__", ()) for inner in tables_in(part)
    ]
