"""Progress: two lines for a pipe, a bar for a terminal, nothing for who did not ask."""

import subprocess
import sys

import pytest
from logged import write_arm

from consistent_id._support import progress
from consistent_id._support.progress import begun, counted, stages


@pytest.fixture
def clock(monkeypatch):
    times = iter([0.0, 6.0])
    monkeypatch.setattr(progress, "monotonic", lambda: next(times))


def test_a_pipe_gets_the_first_stage_and_the_end(capsys, clock):
    with stages(2, True) as begin:
        begin("one")
        assert capsys.readouterr().err == "0/2 one [0 s]\n"
        begin("two")
        assert capsys.readouterr().err == ""
    assert capsys.readouterr().err == "2/2 done [6 s]\n"


def test_what_is_counted_has_a_line_at_once_and_one_at_the_end(capsys, clock):
    with counted(9, "starts", True) as count:
        assert capsys.readouterr().err == "0/9 starts [0 s]\n"
        count(1)
        count(2, "(best: 3)")
        assert capsys.readouterr().err == ""
    assert capsys.readouterr().err == "2/9 starts done (best: 3) [6 s]\n"


def test_work_that_fails_has_no_last_line(capsys):
    with pytest.raises(KeyboardInterrupt), stages(2, True) as begin:
        begin("one")
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "0/2 one [0 s]\n"


def test_nobody_who_did_not_ask_sees_anything(capsys):
    with stages(1, False) as begin, counted(3, "starts", False) as count:
        begin("one")
        count(2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("shown", [stages, counted])
def test_a_terminal_has_a_bar(shown, capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with stages(4, True) if shown is stages else counted(4, "ones", True) as say:
        say("one") if shown is stages else say(3)
    error = capsys.readouterr().err
    assert "\r" in error
    assert ("0/4" if shown is stages else "3/4") in error


def test_work_that_is_done_again_stays_in_the_last_stage(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with stages(2, True) as begin:
        for name in ("one", "two", "two again"):
            begin(name)
        begun_so_far = capsys.readouterr().err
    assert "1/2" in begun_so_far and "2/2" not in begun_so_far


def test_what_begins_is_said_at_once(capsys):
    begun("reading log.csv", shown=True)
    begun("reading other.csv", shown=False)
    assert capsys.readouterr().err == "reading log.csv ...\n"


@pytest.mark.slow
def test_a_command_says_what_it_reads_before_it_imports_its_libraries(tmp_path):
    words = ["check", *map(str, write_arm(tmp_path))]
    code = f"""
import subprocess
import sys
from consistent_id.cli import main
class First:
    def write(self, text):
        sys.__stdout__.write(text + "|" + ",".join(sorted(HEAVY & set(sys.modules))))
        raise SystemExit
    def flush(self):
        pass
    def isatty(self):
        return False
HEAVY = {{"scipy", "pinocchio", "casadi", "cvxpy", "pyarrow", "clarabel"}}
sys.stderr = First()
main({words!r})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "reading arm.urdf, log.csv ...\n|"
