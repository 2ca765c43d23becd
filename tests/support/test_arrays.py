"""Arrays of frozen values: read-only copies, made once."""

import numpy as np

from consistent_id._support.arrays import frozen


def test_what_is_frozen_already_is_not_copied_again():
    own = frozen([[1.0, 2.0]], (1, 2), "numbers")
    assert frozen(own, (None, 2), "numbers") is own


def test_an_array_that_others_can_write_to_is_copied():
    numbers = np.zeros(3)
    writable = numbers[:]
    numbers.setflags(write=False)
    own = frozen(numbers, (3,), "numbers")
    writable[0] = 7.0
    assert numbers[0] == 7.0 and not own.any()


def test_a_frozen_array_that_was_made_writable_is_copied():
    own = frozen(np.zeros(3), (3,), "numbers")
    own.setflags(write=True)
    again = frozen(own, (3,), "numbers")
    own[0] = 7.0
    assert not again.any() and not again.flags.writeable


def test_frozen_rows_are_contiguous():
    turned = frozen(np.zeros((2, 3)).T, (3, 2), "numbers")
    assert turned.flags.c_contiguous
    assert frozen(turned.T, (2, 3), "numbers").flags.c_contiguous
