"""Limits in work: the same on a busy machine, and when processes are killed."""

import os
import signal
import threading
import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from excited import arm, arm_limits, arm_problem

from consistent_id import TorqueModel
from consistent_id._support.executors import Executor
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.design import _warn_if_short
from consistent_id.excitation.path_search import FoundPath, searched_path
from consistent_id.excitation.searches import Lanes
from consistent_id.excitation.stages import DesignSearch
from consistent_id.excitation.work import Meter

STARTS = [FoundPath(number) for number in range(6)]


def problem():
    return arm_problem(TorqueModel(arm(3)), arm_limits(arm(3)), form=PathForm(5.0, 3))


def variables(found):
    return {one.number: one.variables for one in found}


def assert_same(first, second):
    assert [one.number for one in first] == [one.number for one in second]
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one.variables, other.variables)
        assert one.score == other.score and one.work == other.work


@cache
def whole_search():
    return searched_path(problem(), FoundPath(0))


@pytest.mark.slow
def test_a_search_ends_when_its_work_is_done():
    whole = whole_search()
    part = searched_path(problem(), FoundPath(0), work=0.3 * whole.work)
    assert whole.complete and not part.complete
    # It ends at the next iteration, which is a small part of it.
    assert 0.3 * whole.work <= part.work < 0.4 * whole.work
    assert part.score > whole.score


@pytest.mark.slow
def test_the_same_work_on_a_busy_machine_finds_the_same():
    work = 0.5 * whole_search().work
    quiet = searched_path(problem(), FoundPath(0), work=work)
    stop = threading.Event()

    def burn():
        while not stop.is_set():
            sum(range(1000))

    other = threading.Thread(target=burn)
    other.start()
    try:
        busy = searched_path(problem(), FoundPath(0), work=work)
    finally:
        stop.set()
        other.join()
    assert_same([quiet], [busy])


@pytest.mark.slow
def test_lanes_end_by_their_own_work_however_long_they_take():
    one = searched_path(problem(), FoundPath(0)).work
    lanes = Lanes(2, interrupted=bool)
    first = lanes.run(problem(), STARTS, 1.5 * one)
    again = lanes.run(problem(), STARTS, 1.5 * one)
    assert_same(first, again)
    assert len(first) < len(STARTS)  # the work was spent before all had begun
    assert lanes.spent(first, STARTS) >= 1.5 * one


EVERYWHERE = ["serial", "processes:2", "dask:2"]


def place(name):
    """An executor, if what it needs is installed."""
    if name == "dask:2":
        pytest.importorskip("distributed")
    return name and Executor.named(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERYWHERE)
def test_lanes_find_the_same_wherever_they_are_run(name):
    one = searched_path(problem(), FoundPath(0)).work
    lanes = Lanes(3, interrupted=bool)
    expected = lanes.run(problem(), STARTS, 1.5 * one)
    there = replace(lanes, executor=place(name))
    assert_same(expected, there.run(problem(), STARTS, 1.5 * one))


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERYWHERE)
def test_an_interrupt_leaves_what_was_found_wherever_it_was(name):
    asked = iter([False] * 8)
    lanes = Lanes(2, interrupted=lambda: next(asked, True), executor=place(name))
    starts = [FoundPath(number) for number in range(500)]
    found = lanes.run(problem(), starts, np.inf)
    assert len(found) < 500


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills a process")
@pytest.mark.filterwarnings("ignore")  # of those who look after killed workers
@pytest.mark.parametrize("name", [None, "processes:2", "dask:2"])
def test_a_killed_process_changes_nothing(monkeypatch, tmp_path, name):
    executor = place(name)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    lanes = Lanes(2, interrupted=bool)
    expected = lanes.run(problem(), STARTS, np.inf)
    killed = []

    def kill():
        until = time.monotonic() + 60.0
        while time.monotonic() < until and not killed:
            # Starts 1, 3 and 5 are those of the second lane, in another process.
            for begun in tmp_path.glob("excitation-*/3.begun"):
                if (text := begun.read_text()) and int(text) != os.getpid():
                    os.kill(int(text), signal.SIGKILL)
                    killed.append(int(text))
            time.sleep(0.002)

    thread = threading.Thread(target=kill)
    thread.start()
    found = replace(lanes, executor=executor).run(problem(), STARTS, np.inf)
    thread.join()
    assert len(killed) == 1
    assert_same(expected, found)


class Slow:
    """A guard of many bodies that are never near, and take long."""

    keeps_apart, pairs, density, near = False, 4000, 24, 0.1

    def __init__(self, seconds):
        self.seconds = seconds
        self.looks = []

    def measure(self, motion):
        self.looks.append(motion.tobytes())
        return np.full((motion.shape[1], 1), -1.0)

    def kept(self, motion):
        return True

    def initial_places(self, times):
        return set()


def test_paths_that_were_measured_are_not_measured_again():
    guard = Slow(0.01)
    of = problem().guarded((guard,))
    found = searched_path(of, FoundPath(0), work=4.0 * of.costs.measure)
    assert found.variables is not None and not found.complete
    assert len(guard.looks) > 2
    pairs = zip(guard.looks, guard.looks[1:], strict=False)
    assert all(one != other for one, other in pairs)


def search_of(time_limit, seconds):
    guard = Slow(seconds)
    forms = [problem().guarded((guard,)), problem().guarded((guard,))]
    lanes = Lanes(1, interrupted=bool, executor=Executor("serial"))
    search = DesignSearch(None, Aim(), lanes, 1, Meter(time_limit))
    return search, forms


@pytest.mark.slow
def test_forms_are_tried_only_if_a_trial_has_a_step():
    search, forms = search_of(10.0, 0.05)
    assert forms[0].costs.step > 1.0
    assert search.best_form(forms).begun == ()
    assert search.meter.spent == 0.0
    search, forms = search_of(10.0, 1e-4)
    assert search.best_form(forms).begun
    assert search.meter.spent > 0.0


def test_a_limit_that_is_short_for_the_robot_is_said_before_the_search(caplog):
    of = problem().guarded((Slow(0.05),))
    step, draw = of.costs.step, of.costs.draw
    _warn_if_short([of], 30.0 * step + 2.0 * draw, 2)
    assert not caplog.messages
    # Each random path takes its work from that of the steps.
    limit = 12.0 * step + 2.0 * draw
    few, many = 1, 8
    _warn_if_short([of], limit, few)
    assert not caplog.messages
    _warn_if_short([of], limit, many)
    (said,) = caplog.messages
    assert f"its random paths {8.0 * draw:.2g} s" in said
    caplog.clear()
    _warn_if_short([of], 2.0 * step, few)
    (said,) = caplog.messages
    assert said.startswith("with 3 joints and 4000 pairs of bodies, a step of the sear")
    enough = min(60.0 * step + draw, 60.0 * step / 0.8)
    assert f"--time-limit {enough:.0f} finds a better motion" in said
    caplog.clear()
    _warn_if_short([problem()], 1e-9, few)
    (said,) = caplog.messages
    assert "random paths" not in said  # without bodies they take no time
