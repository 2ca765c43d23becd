"""Memory does not grow with a log, whatever its format."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "streaming.py"
LONG, SHORT = (1_000_000, 2_000_000), (200_000, 1_000_000)
_RISE = 100.0
"""By how much the peak may rise, in MB: it differs by 30 MB between runs.  The samples
that are more would take 120 MB as numbers, 370 MB with derivatives and rows; those of
shorter logs, which take longer to write, 96 MB, and several hundred as text or
messages."""
# What it needs, and lengths.  Up to 1 000 000 samples, what one task takes, the peak
# still rises by some 100 MB.
FORMS = {
    "Parquet": ("pyarrow", LONG),
    "HDF5": ("h5py", LONG),
    "CSV": ("numpy", SHORT),
    "MCAP": ("rosbags", SHORT),
}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kilobytes")
@pytest.mark.parametrize("form", FORMS)
def test_memory_is_flat(form):
    library, lengths = FORMS[form]
    for needed in ("pyarrow", library):
        pytest.importorskip(needed)
    call = [sys.executable, str(BENCHMARK), "--form", form]
    call += ["--samples", *map(str, lengths)]
    printed = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    rows = [line.split("|") for line in printed.splitlines()[2:4]]
    short, long = (float(row[4]) for row in rows)
    assert long < 1000.0
    assert long - short < _RISE
