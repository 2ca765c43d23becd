"""A part that fails loses only itself; what concerns every part passes through."""

import logging

import pytest

from consistent_id import ModelError
from consistent_id._support.run import OutOfTime, Run, Terminated, kept_going, running


def test_within_a_run_a_fault_is_noted_and_the_work_goes_on(caplog):
    cause = ZeroDivisionError("nothing to divide by")
    with running(Run(faults=[])) as run:
        with kept_going("figure 1") as faults:
            raise cause
        with kept_going("figure 2") as none:
            pass
    assert run.faults == [("figure 1", cause)]
    assert faults == ["ZeroDivisionError: nothing to divide by"] and none == []
    assert not caplog.records


def test_without_a_run_a_warning_with_its_traceback_is_logged(caplog):
    with caplog.at_level(logging.WARNING), kept_going("figure 1"):
        raise KeyError("x")
    assert "figure 1 could not be made" in caplog.text
    assert "Traceback" in caplog.text


@pytest.mark.parametrize(
    "error",
    [
        KeyboardInterrupt,
        OutOfTime,
        Terminated,
        MemoryError,
        SystemExit,
        PermissionError,
        BrokenPipeError,
        ModelError,
    ],
)
def test_what_concerns_every_part_passes_through(error):
    with running(Run(faults=[])) as run:
        with pytest.raises(error), kept_going("figure 1"):
            raise error("stop")
        assert run.faults == []
