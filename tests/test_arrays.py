"""Arrays of frozen values: copied, read-only and checked."""

from dataclasses import FrozenInstanceError, dataclass

import numpy as np
import pytest

from consistent_id import ModelError
from consistent_id._support.arrays import Array, array_default, chunks, freeze_arrays


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A value of two arrays."""

    position: Array
    weight: Array = array_default((1.0, 2.0))

    def __post_init__(self):
        shapes = {"position": (None, 3), "weight": (2,)}
        freeze_arrays(self, shapes, "sample", ModelError)


def test_arrays_are_copies_that_nobody_can_change():
    given = np.zeros((4, 3), dtype=np.int64)
    sample = Sample(given)
    given[:] = 7
    assert sample.position.dtype == np.float64 and not sample.position.any()
    with pytest.raises(ValueError, match="read-only"):
        sample.position[0] = 1.0
    with pytest.raises(FrozenInstanceError):
        sample.position = given


def test_each_value_has_a_default_of_its_own():
    first, second = Sample(np.zeros((1, 3))), Sample(np.zeros((1, 3)))
    np.testing.assert_array_equal(first.weight, [1.0, 2.0])
    assert not np.shares_memory(first.weight, second.weight)


@pytest.mark.parametrize(
    ("position", "weight", "message"),
    [
        (np.zeros((3, 4)), [1, 2], r"sample: position: expected shape \(any, 3\)"),
        (np.zeros((4, 3)), [1, np.nan], r"sample: weight: entry \(1,\) is nan"),
        ([["a", "b", "c"]], [1, 2], "sample: position: expected numbers"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(position, weight, message):
    with pytest.raises(ModelError, match=message):
        Sample(position, weight)


@pytest.mark.parametrize(
    ("samples", "size", "lengths"),
    [(0, 3, []), (0, 0, []), (2, 3, [2]), (6, 3, [3, 3]), (7, 3, [3, 3, 1])],
)
def test_chunks_have_every_sample_once_in_order(samples, size, lengths):
    parts = list(chunks(samples, size))
    assert [part.stop - part.start for part in parts] == lengths
    assert [n for part in parts for n in range(part.start, part.stop)] == list(
        range(samples)
    )
