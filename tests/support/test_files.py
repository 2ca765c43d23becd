"""Files that are written: several at once, never over inputs or others' files."""

import os
import subprocess
import sys

import pytest

from consistent_id._support import files
from consistent_id._support.files import require_replaceable, together, write_atomically
from consistent_id._support.run import Run, note_input, running
from consistent_id.errors import ProblemError


@pytest.fixture
def run():
    with running(Run(force=False)) as run:
        yield run


def test_outside_of_a_run_files_are_replaced(tmp_path):
    (tmp_path / "x.csv").write_text("mine")
    write_atomically(tmp_path / "x.csv", "new")
    assert (tmp_path / "x.csv").read_text() == "new"


def test_a_file_of_others_is_not_replaced(tmp_path, run):
    mine = tmp_path / "notes.html"
    mine.write_text("<p>what I think of consistent-id</p>")
    with pytest.raises(ProblemError, match="nothing in it says that"):
        write_atomically(mine, "new")
    assert "what I think" in mine.read_text()


def test_the_content_that_is_there_already_may_be_written_again(tmp_path, run):
    (tmp_path / "x.csv").write_text("a,b\n")
    write_atomically(tmp_path / "x.csv", "a,b\n")


@pytest.mark.parametrize(
    "content",
    [
        '{\n "format": "consistent_id estimate 1"}',
        "<!-- consistent-id: robot x, method y -->",
        "/* consistent-id: robot x",
        '"""consistent-id: robot x',
        "time,q_a,q_b,dq_a,dq_b,ddq_a,ddq_b\n0,1,2,3,4,5,6\n",
    ],
)
def test_a_file_with_our_mark_is_replaced(tmp_path, run, content):
    (tmp_path / "x").write_text(content)
    write_atomically(tmp_path / "x", "new")
    assert (tmp_path / "x").read_text() == "new"


def test_a_log_with_torque_is_not_taken_for_samples_of_a_trajectory(tmp_path, run):
    (tmp_path / "x.csv").write_text("time,q_a,dq_a,ddq_a,tau_a\n0,1,2,3,4\n")
    with pytest.raises(ProblemError, match="is there already"):
        write_atomically(tmp_path / "x.csv", "new")


def test_a_problem_file_is_never_taken_for_ours_as_people_go_on_writing_it(
    tmp_path, run
):
    (tmp_path / "problem.toml").write_text("# consistent-id: drafted\nname = 'x'\n")
    with pytest.raises(ProblemError, match="is there already"):
        write_atomically(tmp_path / "problem.toml", "new")


@pytest.mark.parametrize("link", [os.link, os.symlink])
def test_an_input_is_not_replaced_by_whatever_name(tmp_path, run, link):
    (tmp_path / "log.json").write_text('{"format": "consistent_id robot 1"}')
    link(tmp_path / "log.json", tmp_path / "other.json")
    note_input((tmp_path / "log.json").stat())
    with pytest.raises(ProblemError, match="is an input of this run"):
        write_atomically(tmp_path / "other.json", "new")


def test_force_replaces_both(tmp_path):
    (tmp_path / "log.csv").write_text("mine")
    with running(Run(force=True)):
        note_input((tmp_path / "log.csv").stat())
        write_atomically(tmp_path / "log.csv", "new")
    assert (tmp_path / "log.csv").read_text() == "new"


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
def test_what_is_no_regular_file_is_never_replaced(tmp_path, make):
    make(tmp_path / "x")
    with pytest.raises(ProblemError, match="no regular file"):
        require_replaceable(tmp_path / "x")


def test_several_files_appear_when_all_are_written(tmp_path):
    with together():
        write_atomically(tmp_path / "out" / "a", "1")
        assert not (tmp_path / "out").exists()
        write_atomically(tmp_path / "out" / "b", "2")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["a", "b"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_of_several_files_none_appears_when_the_work_fails(tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(ZeroDivisionError), together():
        write_atomically(tmp_path / "a", "new")
        raise ZeroDivisionError
    assert (tmp_path / "a").read_text() == "old"


def test_of_several_files_none_stays_when_one_cannot_be_put_in_place(
    tmp_path, monkeypatch
):
    (tmp_path / "a").write_text("old")
    replace = os.replace

    def fails(source, target):
        if target == tmp_path / "c":
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(files.os, "replace", fails)
    with pytest.raises(ProblemError, match="No space left"), together():
        for name in "abc":
            write_atomically(tmp_path / name, "new")
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_what_a_dead_process_left_is_removed_and_what_a_living_one_makes_is_not(
    tmp_path,
):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    staged = {
        name: tmp_path / f"{files._STAGED}{files.platform.node()}.{process}.x"
        for name, process in (("dead", dead.pid), ("living", os.getppid()))
    }
    for folder in staged.values():
        folder.mkdir()
        (folder / "part").write_text("half")
    write_atomically(tmp_path / "a", "new")
    assert not staged["dead"].exists()
    assert staged["living"].exists()
