"""No file of an earlier design is left to be played as if it were of the new one."""

from pathlib import Path

import pytest

from consistent_id._support.files import remove_when_written, together, write_atomically
from consistent_id.cli import main
from consistent_id.excitation.earlier_files import earlier_files
from consistent_id.motion import write_trajectory
from consistent_id.motion.bernstein import PolynomialPath

RECORD = '{"format": "consistent_id design 1"}'


def _path(swing):
    control = [[0.0], [0.0], [0.0], [swing], [swing], [swing]]
    return PolynomialPath(("elbow",), control, 2.0)


@pytest.fixture
def folder(tmp_path):
    """A folder with a design in three formats, and one file that was edited."""
    write_atomically(tmp_path / "excitation.json", RECORD)
    for name in ("trajectory", "validation"):
        for ending in ("json", "csv", "npz"):
            write_trajectory(_path(0.2), tmp_path / f"{name}.{ending}", rate=50.0)
    write_atomically(tmp_path / "replay.html", "<!-- consistent-id: replay -->")
    with (tmp_path / "validation.npz").open("ab") as file:
        file.write(b"mine")
    return tmp_path


def _names(paths):
    return {path.name for path in paths}


def test_own_files_of_another_motion_are_removed_and_edited_ones_named(folder):
    moves = {"trajectory": _path(0.3), "validation": _path(0.4)}
    found = earlier_files(moves, folder, ["csv"])
    assert _names(found.removed) == {"trajectory.npz", "replay.html"}
    assert _names(found.kept) == {"validation.npz"}
    removed, kept = found.sentences()
    assert removed.startswith("removed, as of an earlier design: trajectory.npz")
    assert "validation.npz" in kept and "edited" in kept
    replayed = earlier_files(moves, folder, ["csv"], replayed=True)
    assert _names(replayed.removed) == {"trajectory.npz"}


def test_the_same_motion_keeps_its_files_of_other_formats(folder):
    moves = {"trajectory": _path(0.2), "validation": _path(0.2)}
    found = earlier_files(moves, folder, ["csv"])
    assert found.sentences() == () and found.record() == {}


def test_a_motion_that_the_new_design_lacks_loses_its_files(folder):
    found = earlier_files({"trajectory": _path(0.2)}, folder, ["csv"])
    assert _names(found.removed) == {"validation.json", "validation.csv"}


def test_nothing_is_removed_where_no_design_of_ours_lies(folder):
    """Other work with the package may have made a file of that name."""
    (folder / "excitation.json").write_text("{}")
    found = earlier_files({"trajectory": _path(0.3)}, folder, ["csv"])
    assert not found.removed and "trajectory.npz" in _names(found.kept)


def test_the_client_of_messages_goes_with_the_last_of_them(folder):
    client = write_atomically(folder / "follow.py", '"""consistent-id: motion."""')
    message = write_trajectory(_path(0.2), folder / "trajectory.yaml", rate=50.0)
    moves = {"trajectory": _path(0.3), "validation": _path(0.2)}
    assert {message, client} <= set(earlier_files(moves, folder, ["csv"]).removed)
    (folder / "other.yaml").write_text("{}")
    assert client not in earlier_files(moves, folder, ["csv"]).removed


def test_a_file_is_removed_when_the_others_are_there_unless_it_is_one_of_them(tmp_path):
    old, new = tmp_path / "old.csv", tmp_path / "new.csv"
    for path in (old, new):
        path.write_text("before")
    with pytest.raises(KeyboardInterrupt), together():
        remove_when_written([old, new])
        raise KeyboardInterrupt
    assert old.exists() and new.exists()
    with together():
        remove_when_written([old, new])
        write_atomically(new, "after")
        assert old.exists()
    assert not old.exists() and new.read_text() == "after"


@pytest.mark.slow
def test_a_second_design_in_a_folder_removes_the_files_of_the_first(tmp_path, capsys):
    problem = Path(__file__).parents[2] / "problems/rx60"
    call = ["excite", str(problem), "--time-limit", "0.3", "--starts", "1"]
    call += ["--workers", "1", "--harmonics", "3", "--output", str(tmp_path / "out")]
    assert main([*call, "--format", "yaml"]) == 0
    capsys.readouterr()
    assert main([*call, "--format", "csv", "--seed", "5"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("removed, as of an earlier design: trajectory.yaml")
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert "trajectory.csv" in left and not left & {"trajectory.yaml", "follow.py"}
