"""Results are kept as long as the object that they are of, and as there is room."""

import gc

import numpy as np
import pytest

from consistent_id._support.caches import kept_for_equal, kept_with


class Log:
    """An object that is told from others by identity."""


@pytest.fixture
def counted():
    calls = []

    @kept_with(0, most=3, room=100, size=lambda values: values.nbytes)
    def rows(log, samples):
        calls.append(samples)
        return np.zeros(samples)

    return rows, calls


def test_a_result_is_computed_once_for_each_object_and_argument(counted):
    rows, calls = counted
    log = Log()
    assert rows(log, 2) is rows(log, 2)
    assert rows(Log(), 2) is not rows(log, 2)
    assert len(rows(log, 3)) == 3
    assert calls == [2, 2, 3]


def test_the_oldest_goes_when_there_is_no_room(counted):
    rows, calls = counted
    one, other, large = Log(), Log(), Log()
    rows(one, 6), rows(other, 6), rows(one, 6)  # 96 bytes
    rows(large, 50)  # above all room: kept, and alone
    rows(large, 50)
    assert calls == [6, 6, 50]
    rows(one, 6)
    assert calls == [6, 6, 50, 6]


def test_what_was_not_used_for_longest_goes_first(counted):
    rows, calls = counted
    logs = [Log() for _ in range(4)]
    for log in (*logs[:3], logs[0], logs[3], logs[0], logs[1]):
        rows(log, 1)
    assert len(calls) == 5  # the second had gone


@pytest.mark.slow
def test_nothing_is_kept_of_what_is_gone(counted):
    rows, calls = counted
    log = Log()
    rows(log, 1)
    del log
    gc.collect()
    rows(Log(), 1)
    assert calls == [1, 1]


def test_objects_may_end_while_the_room_of_their_results_is_counted():
    """In another thread, say."""
    logs = [Log(), Log(), Log()]

    def size(_):
        logs.clear()
        return 1

    kept = kept_with(0, most=5, room=100, size=size)(lambda log: "kept")
    assert [kept(log) for log in list(logs)[:1]] == ["kept"]
    second = logs[1]
    assert kept(second) == kept(second) == "kept"


def test_equal_arrays_are_computed_once_and_others_each():
    asked = []

    @kept_for_equal(most=2)
    def total(values):
        asked.append(values)
        return values.sum()

    one = np.arange(6.0)
    table = np.column_stack([one, -one])
    assert total(one) == total(table[:, 0]) == 15.0  # a column is no block of memory
    assert len(asked) == 1
    assert total(one.reshape(2, 3)) == 15.0
    assert total(one.astype(int)) == 15
    assert len(asked) == 3
    total(one)  # gone: two others came after it
    assert len(asked) == 4
    one[0] = 1.0
    assert total(one) == 16.0


def test_without_an_object_results_are_kept_for_equal_arguments():
    computed = []

    @kept_with(None, most=2)
    def sized(text):
        computed.append(text)
        return len(text)

    assert [sized("one"), sized("three"), sized("one")] == [3, 5, 3]
    assert computed == ["one", "three"]
