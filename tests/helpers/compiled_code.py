"""Whether code can be compiled here, and how calls do without it."""

import pytest

from consistent_id.regression.compiled import compiler

needs_compiler = pytest.mark.skipif(
    compiler._compiler() is None, reason="there is no C compiler here"
)


def without(monkeypatch, call):
    monkeypatch.setenv(compiler.SWITCH, "0")
    value = call()
    monkeypatch.setenv(compiler.SWITCH, "1")
    return value


class Counted:
    """A function that counts its calls."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, *arguments):
        self.calls += 1
        return self.function(*arguments)
