"""Damaged files of every format end in the package's own errors, soon and cheaply."""

import importlib
import os
import sys
import time
from pathlib import Path

import pytest

from consistent_id import RecordingError

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="memory is limited as on Linux"
)


@pytest.fixture
def fuzz(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("fuzz")


def refused():
    raise RecordingError("not this one")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "kind"),
    [
        (lambda: None, "read"),
        (refused, "refused"),
        (lambda: 1 / 0, "foreign"),
        (lambda: bytes(3 * 2**30), "foreign"),  # MemoryError
        (lambda: os._exit(9), "crash"),
        (lambda: time.sleep(60), "hangs"),
    ],
)
def test_what_a_reader_does_is_seen(fuzz, tmp_path, monkeypatch, work, kind):
    monkeypatch.setattr(fuzz, "SECONDS", 0.5)
    monkeypatch.setattr(fuzz, "_GRACE", 0.5)

    def read(path):
        if path.read_bytes() != b"valid":
            work()

    reader = fuzz.Reader([fuzz.Sample("x", b"valid", read)], tmp_path)
    (tmp_path / "x").write_bytes(b"damaged")
    assert reader.read(0)[0] == kind
    (tmp_path / "x").write_bytes(b"valid")
    assert reader.read(0)[0] == "read"
    reader.end()


@pytest.mark.slow
def test_a_thousand_damaged_files_do_no_harm(fuzz):
    found = list(fuzz.outcomes(1000, seed=0))
    names = {outcome.name for outcome in found}
    assert len(names) > 15
    assert {Path(name).suffix for name in names} >= {".mcap", ".db3", ".bag"}
    assert [(o.name, o.kind, o.detail) for o in found if fuzz.bad(o)] == []
    kinds = [outcome.kind for outcome in found]
    assert kinds.count("refused") > 300 and kinds.count("read") > 30
