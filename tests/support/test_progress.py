"""Progress: two lines for a pipe, a bar for a terminal, nothing for who did not ask."""

import sys

import pytest

from consistent_id._support import progress
from consistent_id._support.progress import counted, stages


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
