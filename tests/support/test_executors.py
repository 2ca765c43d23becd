"""Work done here, in processes and on a Dask cluster: the same, whoever is killed."""

import os
import signal
import socket
import sys
import threading
import time
from contextlib import closing, suppress
from itertools import accumulate
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from killing import killing, loky_workers

from consistent_id._support import executors
from consistent_id._support.executors import (
    Executor,
    beside,
    companion,
    in_halves,
    single_threaded,
    tree_reduced,
)
from consistent_id._support.run import Run, current_run, running
from consistent_id.errors import ProblemError, RecordingError, SolverError
from consistent_id.regression.linear import triangle


@single_threaded
def _factor(seed):
    rows = np.random.default_rng(seed).normal(size=(200, 12))
    return triangle(np.asfortranarray(rows))


def _killed_elsewhere(process):
    if os.getpid() != process:
        os.kill(os.getpid(), signal.SIGKILL)
    return process


def _joined(first, second):
    return triangle(np.asfortranarray(np.vstack([first, second])))


def _reduced(executor):
    return tree_reduced(executor.map(_factor, range(23)), _joined)


def _killed_once(task):
    """Kill this process, the first time that a task is begun."""
    number, folder = task
    mark = folder / f"{number}"
    if number % 5 == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return _factor(number)


def _killed(task):
    os.kill(os.getpid(), signal.SIGKILL)


def _faulty(task):
    raise RecordingError(f"task {task}: no such column")


def _allowed(task):
    return current_run().large_files


def _trimming(task):
    return os.environ.get("MALLOC_TRIM_THRESHOLD_"), os.environ["OMP_NUM_THREADS"]


def _name_of(task):
    return os.getpid(), task


def _whose(task):
    return os.getpid(), current_run().large_files, _factor(task)


def _slow(task):
    time.sleep(0.2)
    return _factor(task)


@pytest.fixture(params=["processes:2", "dask:2"])
def executor(request):
    """What works in other processes."""
    if request.param.startswith("dask"):
        pytest.importorskip("distributed")
    return Executor.named(request.param)


@pytest.mark.slow
def test_results_are_the_same_to_the_last_bit(executor):
    np.testing.assert_array_equal(_reduced(executor), _reduced(Executor()))


@pytest.mark.slow
def test_somebody_else_may_have_dask_dashboard_at_its_usual_port():
    pytest.importorskip("distributed")
    with socket.socket() as other:
        with suppress(OSError):  # somebody else has it already
            other.bind(("127.0.0.1", 8787))
            other.listen()
        found = _reduced(Executor.named("dask:1"))  # warnings are errors here
        np.testing.assert_array_equal(found, _reduced(Executor()))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of those who look after killed workers
def test_a_worker_that_is_killed_changes_nothing(executor, tmp_path):
    tasks = [(k, tmp_path) for k in range(23)]
    found = tree_reduced(executor.map(_killed_once, tasks), _joined)
    np.testing.assert_array_equal(found, _reduced(Executor()))
    assert len(list(tmp_path.iterdir())) == 5  # so many were killed


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_workers_are_killed_at_any_time():
    pytest.importorskip("psutil")
    with killing(loky_workers, 3) as killed:
        work = Executor.named("processes:2").map(_slow, range(23))
        found = tree_reduced(work, _joined)
    assert len(killed) == 3
    np.testing.assert_array_equal(found, _reduced(Executor()))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_task_that_kills_every_worker_is_given_up():
    with pytest.raises(SolverError, match="killed 4 times at the same task"):
        list(Executor.named("processes:2").map(_killed, [0]))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_whoever_has_enough_need_not_wait(executor):
    started = time.monotonic()
    with closing(executor.as_done(time.sleep, [0.0, 300.0])) as looks:
        assert next(done for done in looks if done) == {0: None}
    assert time.monotonic() - started < 100.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_results_as_they_are_done_are_the_same_whoever_is_killed(executor, tmp_path):
    found = {}
    for done in executor.as_done(_killed_once, [(k, tmp_path) for k in range(8)]):
        found |= done
    assert len(list(tmp_path.iterdir())) == 2  # so many were killed
    for k in range(8):
        np.testing.assert_array_equal(found[k], _factor(k))


@pytest.mark.slow
def test_errors_of_tasks_are_raised_as_they_are(executor):
    with pytest.raises(RecordingError, match="task 0: no such column"):
        list(executor.map(_faulty, range(3)))


@pytest.mark.slow
def test_what_the_user_allows_holds_in_workers(executor):
    with running(Run(large_files=True)):
        assert list(executor.map(_allowed, [0, 1])) == [True, True]


def test_few_tasks_are_handed_out_before_results_are_taken():
    begun = []

    def tasks():
        for k in range(100):
            begun.append(k)
            yield k

    results = Executor().map(_factor, tasks())
    next(results)
    assert len(begun) == 1


def test_trees_are_balanced_and_keep_the_order():
    for n in range(1, 40):
        deepest, order = 0, ()

        def combine(first, second):
            depth = max(first[0], second[0]) + 1
            return depth, first[1] + second[1]

        deepest, order = tree_reduced(((0, (k,)) for k in range(n)), combine)
        assert order == tuple(range(n))
        assert deepest <= int(np.ceil(np.log2(n))) + 1
    assert tree_reduced([], max) is None
    assert tree_reduced(range(9), int.__add__) == list(accumulate(range(9)))[-1]


@pytest.mark.parametrize(
    "name", ["threads", "processes:0", "processes:two", "dask:host", "serial:tcp://a:1"]
)
def test_executors_that_there_are_not(name):
    with pytest.raises(ProblemError, match="expected serial, processes"):
        Executor.named(name)


def _large_and_killed(task):
    """Return a large array; one worker is killed while it may be handing it over."""
    number, delay, mark = task
    if number == 1 and not Path(mark).exists():
        Path(mark).touch()
        threading.Timer(delay, os.kill, (os.getpid(), signal.SIGKILL)).start()
    return np.full(3_000_000, float(number))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_worker_killed_while_it_hands_over_a_large_result_stops_nothing(tmp_path):
    # Through a pipe, about one of 40 such runs waited for ever.
    for k in range(8):
        tasks = [(n, 0.02 * k, str(tmp_path / f"{k}")) for n in range(4)]
        found = list(Executor.named("processes:2").map(_large_and_killed, tasks))
        assert [array[0] for array in found] == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.slow
def test_a_pool_of_another_size_is_replaced_and_not_resized(monkeypatch):
    # A worker killed while the pool is resized makes loky wait for ever.
    from loky.reusable_executor import _ReusablePoolExecutor

    def resized(pool, workers):
        assert workers == pool._max_workers

    monkeypatch.setattr(_ReusablePoolExecutor, "_resize", resized)
    # A pool that an earlier test left has been idle: its workers may be about to end.
    monkeypatch.setattr("consistent_id._support.workers._pool_sizes", [])
    pids = []
    for workers in (2, 3, 3, 2):
        executor = Executor.named(f"processes:{workers}")
        assert list(executor.map(abs, [-1, -2, -3])) == [1, 2, 3]
        end = time.monotonic() + 20.0  # one that is still starting has another name
        while len(loky_workers()) < workers and time.monotonic() < end:
            time.sleep(0.05)
        pids.append(frozenset(loky_workers()))
    assert pids[1] == pids[2]
    assert [len(found) for found in pids] == [2, 3, 3, 2]


@pytest.mark.slow
def test_workers_of_an_own_cluster_keep_freed_memory(monkeypatch):
    pytest.importorskip("distributed")
    # Another cluster of this process leaves it in the environment.
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    assert list(Executor("dask", 1).map(_trimming, [0])) == [(None, "1")]


def test_work_beside_is_done_by_another_process_and_equals_to_the_last_bit():
    with running(Run(beside=True, large_files=True)):
        with beside(_whose, 3) as result:
            process, large, factor = result()
    assert process != os.getpid() and large
    assert np.array_equal(factor, _factor(3))


@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
@pytest.mark.parametrize(("count", "here"), [(5, 3), (2, 1), (1, 1), (0, 0)])
def test_another_process_does_the_second_half_of_tasks(count, here):
    with running(Run(beside=True)):
        done = list(in_halves(_whose, range(count)))
    own = [process == os.getpid() for process, *_ in done]
    assert own == [True] * here + [False] * (count - here)
    for task, (*_, factor) in enumerate(done):
        assert np.array_equal(factor, _factor(task))


@pytest.mark.parametrize("run", [Run(), Run(beside=True)])
def test_tasks_whose_results_nobody_needs_are_not_done_here(run):
    done = []

    def noted(task):
        done.append(task)
        return task

    with running(run):
        assert next(in_halves(noted, [1, 2, 3, 4])) == 1
        assert done == [1]
        assert list(in_halves(noted, [5, 6], samples=10**9)) == [5, 6]
    assert done == [1, 5, 6]


@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
def test_tasks_in_halves_need_not_be_sent_to_the_other_process():
    locks = [threading.Lock(), threading.Lock()]  # they cannot be pickled
    with running(Run(beside=True)):
        here, there = in_halves(lambda lock: (os.getpid(), lock.locked()), locks)
    assert here == (os.getpid(), False)
    assert there[0] != os.getpid() and not there[1]


@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
def test_work_beside_needs_no_folder_for_its_result(monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", "/nowhere")
    with running(Run(beside=True)), beside(_whose, 3) as result:
        process, *_ = result()
        again, *_ = result()
    assert process == again != os.getpid()


@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
def test_a_companion_does_all_tasks_that_are_handed_to_it():
    with running(Run(beside=True)), companion(_whose) as handed:
        done = [handed(task)() for task in range(3)]
        unasked, asked = handed(4), handed(5)
        done.append(asked())
        assert unasked is not asked
    processes = {process for process, *_ in done}
    assert len(processes) == 1 and os.getpid() not in processes
    for task, (*_, factor) in zip([0, 1, 2, 5], done, strict=True):
        assert np.array_equal(factor, _factor(task))


@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
def test_what_a_companion_cannot_do_is_done_here():
    with running(Run(beside=True)), companion(_faulty) as handed:
        with pytest.raises(RecordingError, match="task 3: no such column"):
            handed(3)()
    with running(Run(beside=True)), companion(_killed_elsewhere) as handed:
        assert handed(os.getpid())() == os.getpid()
        assert handed(os.getpid())() == os.getpid()


@pytest.mark.skipif(sys.platform != "linux", reason="no copies of a process")
def test_a_copy_does_not_take_what_a_companion_answers():
    with running(Run(beside=True)), companion(_whose) as handed:
        first, *_ = handed(0)()
        with beside(lambda task: handed(task)(), 1) as result:
            other, *_ = result()
        again, *_ = handed(2)()
    assert first == again and other not in (first, os.getpid())


@pytest.mark.parametrize("allowed", [False, True])
def test_there_is_no_companion_where_no_process_can_begin(allowed, monkeypatch):
    def refused():
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", refused, raising=False)
    with running(Run(beside=allowed)), companion(_whose) as handed:
        assert handed is None


def test_without_a_core_to_spare_work_beside_is_done_here_when_it_is_needed():
    done = []
    with beside(done.append, 3) as result:
        assert done == []
        result()
    assert done == [3]


def test_an_error_of_work_beside_is_raised_where_its_result_is_needed():
    with running(Run(beside=True)), beside(_faulty, 3) as result:
        with pytest.raises(RecordingError, match="task 3: no such column"):
            result()


@pytest.mark.skipif(sys.platform != "linux", reason="another process is not a copy")
def test_work_beside_that_is_killed_is_done_here():
    with running(Run(beside=True)), beside(_killed_elsewhere, os.getpid()) as result:
        assert result() == os.getpid()


@pytest.mark.skipif(sys.platform != "linux", reason="another process is not a copy")
def test_where_no_process_can_begin_work_beside_is_done_here(monkeypatch):
    def refused():
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", refused)
    with running(Run(beside=True)), beside(_killed_elsewhere, os.getpid()) as result:
        assert result() == os.getpid()


@pytest.mark.slow
def test_beside_blas_with_openmp_no_process_is_a_copy(monkeypatch):
    """A copy of a process whose BLAS has threads of OpenMP would wait for ever."""

    def copied(*_):
        pytest.fail("a copy of this process was begun")

    layers = SimpleNamespace(info=lambda: [{"threading_layer": "openmp"}])
    with running(Run(beside=True)), monkeypatch.context() as patch:
        patch.setattr(executors, "_controller", lambda: layers)
        # Not os.fork: loky 3.4 begins other programmes by it.
        patch.setattr(executors, "_begun", copied)
        with beside(_name_of, "work") as result:
            process, name = result()
        with beside(_name_of, "short work", copied=True) as result:
            here, _ = result()
    assert process != os.getpid() and name == "work"
    assert here == os.getpid()


def test_an_error_meanwhile_does_not_wait_for_work_beside():
    begun = time.monotonic()
    with pytest.raises(ProblemError), running(Run(beside=True)), beside(time.sleep, 60):
        raise ProblemError("something else")
    assert time.monotonic() - begun < 30
