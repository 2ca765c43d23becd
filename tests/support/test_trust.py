"""The record of what a user's own runs wrote: whole, small, and nobody else's."""

import logging
import os
import stat
import subprocess
import sys
from hashlib import sha256

import pytest

from consistent_id._support import ownership
from consistent_id._support.ownership import is_recorded, record


def digest(text):
    return sha256(text.encode()).hexdigest()


@pytest.fixture
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


def entries(state):
    return [path for path in state.rglob("*") if path.is_file()]


def test_what_is_recorded_is_found_again_and_nothing_else(state):
    record([digest("a"), digest("b")], "problem.toml")
    assert is_recorded(digest("a")) and is_recorded(digest("b"))
    assert not is_recorded(digest("c"))


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
def test_nobody_else_may_read_or_write_it(state):
    before = os.umask(0)
    try:
        record([digest("a")], "problem.toml")
    finally:
        os.umask(before)
    (entry,) = entries(state)
    assert stat.S_IMODE(entry.stat().st_mode) == 0o600
    assert stat.S_IMODE(entry.parent.stat().st_mode) == 0o700


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
@pytest.mark.parametrize("part", ["folder", "entry"])
@pytest.mark.parametrize("mode", [0o020, 0o002])
def test_what_others_can_write_to_is_ignored(state, part, mode):
    record([digest("a")], "problem.toml")
    (entry,) = entries(state)
    path = entry if part == "entry" else entry.parent
    path.chmod(path.stat().st_mode | mode)
    assert not is_recorded(digest("a"))


@pytest.mark.skipif(os.name != "posix", reason="owners of POSIX")
def test_what_others_own_is_ignored(state, monkeypatch):
    record([digest("a")], "problem.toml")
    monkeypatch.setattr(ownership.os, "getuid", lambda: os.stat("/").st_uid + 12345)
    assert not is_recorded(digest("a"))


@pytest.mark.parametrize("part", ["folder", "entry"])
def test_a_link_is_ignored(state, tmp_path, part):
    record([digest("a")], "problem.toml")
    (entry,) = entries(state)
    path = entry if part == "entry" else entry.parent
    path.rename(tmp_path / "theirs")
    path.symlink_to(tmp_path / "theirs")
    assert not is_recorded(digest("a"))


@pytest.mark.parametrize("where", ["state", "", "."])
def test_the_folder_that_we_are_in_never_chooses_the_record(
    tmp_path, monkeypatch, where
):
    """A stranger's archive, once unpacked, is the user's own by its owner and modes."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / where))
    record([digest("a")], "problem.toml")
    assert is_recorded(digest("a"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", where)
    assert not is_recorded(digest("a"))


def test_a_user_without_a_home_has_no_record(tmp_path, monkeypatch):
    monkeypatch.setattr("platformdirs.user_state_dir", lambda: "~/.local/state")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.chdir(tmp_path)
    forged = tmp_path / "~" / ".local" / "state" / "consistent_id" / "written"
    forged.mkdir(parents=True)
    (forged / digest("a")).touch()
    assert not is_recorded(digest("a"))
    record([digest("b")], "problem.toml")
    assert len(list(forged.iterdir())) == 1


def test_a_state_folder_that_cannot_be_used_breaks_nothing(state, caplog):
    state.write_text("a file in its place")
    with caplog.at_level(logging.WARNING):
        record([digest("a")], "results/problem.toml")
    assert not is_recorded(digest("a"))
    assert "results/problem.toml is not recorded" in caplog.text
    assert "--trust" in caplog.text


def test_nothing_to_record_leaves_no_folder(state):
    record([], "problem.toml")
    assert not state.exists()


def test_the_record_stays_small_and_keeps_the_youngest(state, monkeypatch):
    monkeypatch.setattr(ownership, "_KEPT", 3)
    for age, name in enumerate("edcba"):
        record([digest(name)], "problem.toml")
        if path := next((p for p in entries(state) if p.name == digest(name)), None):
            os.utime(path, (1e9 + age, 1e9 + age))
    (state / "consistent_id" / "written" / "notes").write_text("mine")
    record([digest("new")], "problem.toml")
    assert [n for n in "edcba" if is_recorded(digest(n))] == ["b", "a"]
    assert is_recorded(digest("new"))
    assert len(entries(state)) == 4


@pytest.mark.slow
def test_processes_that_write_at_the_same_time_lose_nothing(state):
    code = (
        "from hashlib import sha256\n"
        "from consistent_id._support.ownership import record\n"
        "for k in range(200): record([sha256(f'{N}-{k}'.encode()).hexdigest()], 'x')"
    )
    call = [sys.executable, "-c"]
    runs = [subprocess.Popen([*call, code.replace("N", str(n))]) for n in range(3)]
    assert [run.wait() for run in runs] == [0, 0, 0]
    assert all(is_recorded(digest(f"{n}-{k}")) for n in range(3) for k in range(200))
