"""Of many cases of one test, a few run with the fast tests, and all with the slow."""

import pytest


def some_fast(values, fast=1):
    """Return `fast` of the values as they are, evenly spread, the others as slow."""
    values = list(values)
    places = {round(k * len(values) / fast) for k in range(fast)}
    return [value if i in places else _slow(value) for i, value in enumerate(values)]


def _slow(value):
    values = value if isinstance(value, tuple) else (value,)
    return pytest.param(*values, marks=pytest.mark.slow)
