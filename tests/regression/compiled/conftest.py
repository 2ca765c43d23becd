"""Compiled code is tested in a folder of its own."""

import pytest

from consistent_id.regression.compiled import compiler, entries, sines, triangle


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A folder of its own, nothing known, and compiled code from the first sample."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv(compiler.SWITCH, "1")
    monkeypatch.setattr(entries, "LOOK_AFTER", 1)
    monkeypatch.setattr(entries, "COMPILE_AFTER", 1)
    caches = entries._recursion, triangle._found, sines._found
    for known in caches:
        known.cache_clear()
    yield tmp_path / "consistent_id" / "compiled"
    for known in caches:
        known.cache_clear()
