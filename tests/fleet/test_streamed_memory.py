"""Memory does not grow with a log, whatever its format."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHILD = ROOT / "tests" / "helpers" / "streamed_peaks.py"
FORMS = {"Parquet": "pyarrow", "HDF5": "h5py", "CSV": "numpy", "MCAP": "rosbags"}
"""Formats, and what they need."""

SHORT, LONG = 40_000, 480_000  # samples
RISE = 45.0
"""MB; up to 25 were measured, which do not grow with the log.  The samples in between
would take 53 MB as numbers, three times as much with derivatives and rows, and several
times as much as messages."""

# Large arrays have pages of their own: those that are free do not count as used.
PAGES = {"MALLOC_MMAP_THRESHOLD_": str(2**20)}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kilobytes")
@pytest.mark.parametrize("form", FORMS)
def test_memory_is_flat(form, tmp_path, monkeypatch):
    for needed in ("pyarrow", FORMS[form]):
        pytest.importorskip(needed)
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from long_logs import write
    from streaming import problem_text

    files = []
    for length in (SHORT, LONG):
        folder = tmp_path / str(length)
        folder.mkdir()
        write(folder, form, length)
        files.append(folder / "problem.toml")
        files[-1].write_text(problem_text(form))
    call = [sys.executable, str(CHILD), *map(str, files)]
    more = {"check": True, "capture_output": True, "text": True}
    printed = subprocess.run(call, env=os.environ | PAGES, **more).stdout
    looked_short, looked_long, early, end = json.loads(printed)
    assert end < 1000.0
    assert looked_long - looked_short < RISE
    assert end - early < RISE
