"""Whole turns by which positions jump are undone, and nothing else changes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import unwrapped

TIME = np.arange(400) / 100.0


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.floats(0.5, 9.0), st.floats(-20.0, 20.0), st.floats(-6.0, 6.0))
def test_a_wrapped_position_is_continued_from_its_first_sample(size, middle, low):
    q = middle + size * np.sin(2.0 * TIME)[:, None] * [1.0, -0.5]
    wrapped = low + np.mod(q - low, 2.0 * np.pi)
    log = unwrapped(Recording(("a", "b"), TIME, wrapped))
    turns = (log.position - q) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.tile(np.round(turns[0]), (400, 1)), atol=1e-9)
    np.testing.assert_array_equal(log.position[0], wrapped[0])


def test_commands_are_taken_nearest_to_the_position():
    q = 5.0 * np.sin(2.0 * TIME)[:, None]
    command = q + 0.1
    log = Recording(
        ("a",),
        TIME,
        np.mod(q, 2.0 * np.pi),
        position_command=np.mod(command, 2.0 * np.pi),
    )
    found = unwrapped(log)
    np.testing.assert_allclose(found.position_command - found.position, 0.1)


def test_a_position_that_does_not_jump_stays_to_the_last_bit():
    log = Recording(("a",), TIME, np.sin(TIME)[:, None])
    np.testing.assert_array_equal(unwrapped(log).position, log.position)
