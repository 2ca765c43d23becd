"""Memory does not grow with a log, whatever its format."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "streaming.py"
FORMS = {
    "Parquet": ("pyarrow", (400_000, 1_000_000), 85.0),
    "HDF5": ("h5py", (1_000_000, 1_600_000), 60.0),
    "CSV": ("numpy", (200_000, 600_000), 60.0),
    "MCAP": ("rosbags", (200_000, 500_000), 60.0),
}
"""What a format needs, two lengths, and by how much the peak may rise, in MB.

The peak differs by 30 MB between runs, and rises up to a million samples: by 45 MB for
Parquet, 100 MB for HDF5.  Each million samples that were kept would take 120 MB as
numbers, 370 MB with derivatives and rows, and several times as much as messages."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kilobytes")
@pytest.mark.parametrize("form", FORMS)
def test_memory_is_flat(form):
    library, lengths, rise = FORMS[form]
    for needed in ("pyarrow", library):
        pytest.importorskip(needed)
    call = [sys.executable, str(BENCHMARK), "--form", form]
    call += ["--samples", *map(str, lengths)]
    printed = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    rows = [line.split("|") for line in printed.splitlines()[2:4]]
    short, long = (float(row[4]) for row in rows)
    assert long < 1000.0
    assert long - short < rise
