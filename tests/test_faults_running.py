"""The benchmark of faults sees files that are not whole, and ours are."""

import importlib
import sys
from pathlib import Path

import pytest

from consistent_id._support.files import together, write_atomically

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="processes are found as on Linux"
)


@pytest.fixture
def faults(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("faults_running")


def careless(folder, version):
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "x").open("wb") as file:
        for _ in range(200):
            file.write(bytes([version]) * 1000)
            file.flush()


def careful(folder, version):
    with together():
        for name in "xy":
            write_atomically(folder / name, bytes([version]) * 200_000)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_writer_that_is_killed_leaves_whole_files_if_it_is_careful(faults, tmp_path):
    assert faults.killed("x", careless, 20, tmp_path / "careless").faults
    found = faults.killed("x", careful, 20, tmp_path / "careful").faults
    # Two renames cannot be one: files of both versions, each whole, are no surprise.
    assert all("of both versions" in fault for fault in found)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_no_room_leaves_what_was_there(faults, tmp_path):
    writers = {"careful": careful}
    row = faults.refused("no room", faults._no_room, writers, tmp_path / "good")
    assert row.faults == ()
    writers = {"careless": careless}
    assert faults.refused("no room", faults._no_room, writers, tmp_path / "bad").faults
