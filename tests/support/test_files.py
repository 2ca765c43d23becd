"""Files that are written: several at once, never over inputs or others' files."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from consistent_id._support import files
from consistent_id._support.files import (
    require_replaceable,
    require_writable,
    together,
    when_written,
    write_atomically,
)
from consistent_id._support.ownership import marked
from consistent_id._support.run import Run, note_input, running
from consistent_id.errors import ProblemError


@pytest.fixture
def run(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
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


OURS = [
    '{\n "format": "consistent_id estimate 1",\n "mass": 1.0\n}',
    '{\n "format": "consistent_id estimate 1"\n}',
    "<!-- consistent-id: robot x, method y -->\n<robot/>",
    "/* consistent-id: robot x */\nint x;",
    '"""consistent-id: robot x."""\nmass = 1.0\n',
    "# consistent-id: motion; x\n1 2 3\n",
    '<html><meta name="generator" content="consistent-id: report"><p>x</p></html>',
    "time,q_a,q_b,dq_a,dq_b,ddq_a,ddq_b\n0,1,2,3,4,5,6\n",  # no place for a mark
    b"\x89PNG\r\n\x1a\n\x00\xff",
]


@pytest.mark.parametrize("content", OURS)
def test_a_file_that_was_written_here_is_replaced(tmp_path, run, content):
    write_atomically(tmp_path / "x", content)
    write_atomically(tmp_path / "x", content)
    write_atomically(tmp_path / "x", "new")
    assert (tmp_path / "x").read_text() == "new"


@pytest.mark.parametrize("content", OURS)
def test_once_edited_a_file_that_was_written_here_is_its_editors(
    tmp_path, run, content
):
    write_atomically(tmp_path / "x", content)
    written = (tmp_path / "x").read_bytes()
    (tmp_path / "x").write_bytes(edited := written[:-3] + b" " + written[-3:])
    with pytest.raises(ProblemError, match=r"was edited since|nothing in it says"):
        write_atomically(tmp_path / "x", "new")
    assert (tmp_path / "x").read_bytes() == edited


@pytest.mark.parametrize("content", [c for c in OURS if isinstance(c, str)])
def test_the_form_of_a_file_alone_does_not_make_it_ours(tmp_path, run, content):
    (tmp_path / "x").write_text(content)
    with pytest.raises(ProblemError, match="nothing in it says that"):
        write_atomically(tmp_path / "x", "new")


@pytest.mark.parametrize("content", [c for c in OURS if isinstance(c, str)])
def test_other_ends_of_lines_are_no_edit(tmp_path, run, content):
    write_atomically(tmp_path / "x", content)
    saved = (tmp_path / "x").read_bytes().replace(b"\n", b"\r\n") + b"\r\n"
    (tmp_path / "x").write_bytes(saved)
    write_atomically(tmp_path / "x", "new")


def test_a_content_that_is_written_again_keeps_one_digest(tmp_path, run):
    write_atomically(tmp_path / "x", OURS[0])
    again = write_atomically(tmp_path / "y", (tmp_path / "x").read_bytes())
    assert again.read_bytes() == (tmp_path / "x").read_bytes()
    assert again.read_bytes().count(b'"digest"') == 1


def test_a_users_table_of_a_motion_and_currents_is_not_replaced(tmp_path, run):
    """Its columns begin as those of `write_trajectory`."""
    (tmp_path / "x.csv").write_text("time,q_a,dq_a,ddq_a,i_a\n0,1,2,3,4\n")
    with pytest.raises(ProblemError, match="is there already"):
        write_atomically(tmp_path / "x.csv", "new")


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


MINE = "# A robot.\nname = 'x'\n"


@pytest.mark.parametrize(
    "saved",
    [
        lambda text: text,
        lambda text: text.replace("\n", "\r\n"),  # by git, or an editor
        lambda text: text.rstrip("\n"),
        lambda text: text + "\n\n",
    ],
)
def test_a_problem_file_that_nobody_edited_is_replaced(tmp_path, run, saved):
    (tmp_path / "problem.toml").write_bytes(saved(marked(MINE)).encode())
    write_atomically(tmp_path / "problem.toml", "new")
    assert (tmp_path / "problem.toml").read_text() == "new"


@pytest.mark.parametrize(
    "edited",
    [
        lambda text: text.replace("'x'", "'y'"),
        lambda text: text + "[drive]\n",
        lambda text: "# mine\n" + text,
        lambda text: text.replace("digest ", "digest 0"),
        lambda text: text.replace("\n# A", "\n#  A").replace("name", "\nname"),
        lambda text: text + " " * 2**20 + "\n[drive]\n",
    ],
)
def test_a_problem_file_that_was_edited_is_not_replaced(tmp_path, run, edited):
    (tmp_path / "problem.toml").write_text(text := edited(marked(MINE)))
    with pytest.raises(ProblemError, match=r"was edited since|nothing in it says"):
        write_atomically(tmp_path / "problem.toml", "new")
    assert (tmp_path / "problem.toml").read_text() == text


def test_the_refusal_of_an_edited_file_says_that_it_was_edited(tmp_path, run):
    (tmp_path / "problem.toml").write_text(marked(MINE) + "[drive]\n")
    with pytest.raises(ProblemError, match="was edited since consistent-id wrote it"):
        require_replaceable(tmp_path / "problem.toml")


def test_a_text_has_one_digest_however_often_it_is_written():
    once = marked(MINE)
    assert marked(MINE.replace("\n", "\r\n")) == once
    assert once.startswith(MINE) and marked(once) == once
    again = marked(once + "[drive]\n")
    assert again.count("consistent-id: digest") == 1
    assert again.index("[drive]") < again.index("consistent-id: digest")


def test_all_files_are_looked_at_before_the_work(tmp_path, run):
    names = ["a.json", "plots/b.json"]
    require_writable(tmp_path / "out", names)
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "plots").write_text("a file where a folder has to be")
    with pytest.raises(ProblemError, match=r"plots: cannot be written to"):
        require_writable(tmp_path / "out", names)
    (tmp_path / "out" / "plots").unlink()
    (tmp_path / "out" / "plots").mkdir()
    (tmp_path / "out" / "plots" / "b.json").write_text("mine")
    with pytest.raises(ProblemError, match=r"b\.json is there already"):
        require_writable(tmp_path / "out", names)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="Linux only")
def test_a_place_that_no_user_can_write_to_is_refused_before_the_work(run):
    """The permissions of /proc allow the superuser to, but no folder can be made."""
    with pytest.raises(ProblemError, match="/proc/results: cannot be written to"):
        require_writable(Path("/proc/results"), ["a.json"])


def test_looking_whether_a_folder_can_be_written_to_leaves_nothing(tmp_path, run):
    require_writable(tmp_path / "out" / "deep", ["a.json"])
    assert not list(tmp_path.iterdir())


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


def test_what_follows_writing_waits_for_all_files_and_needs_them(tmp_path):
    seen = []
    when_written(lambda: seen.append("now"))
    with together():
        write_atomically(tmp_path / "a", "1")
        when_written(lambda: seen.append((tmp_path / "a").exists()))
        assert seen == ["now"]
    assert seen == ["now", True]
    with pytest.raises(ProblemError), together():
        write_atomically(tmp_path / "a" / "b", "a folder that is a file")
        when_written(lambda: seen.append("never"))
    assert seen == ["now", True]


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
