"""Memory does not grow with a log, whatever its format."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "streaming.py"
LONG, SHORT = (1_000_000, 2_000_000), (200_000, 1_000_000)
# What it needs, lengths that do not take long to write, and by how much the peak may
# rise, in MB.  The samples that are more would take 120 MB as numbers; of the shorter
# logs 96 MB, several hundred as text or messages.  Up to 1 000 000 samples, what one
# task takes, the peak still rises by some 100 MB.
FORMS = {
    "Parquet": ("pyarrow", LONG, 30.0),
    "HDF5": ("h5py", LONG, 30.0),
    "CSV": ("numpy", SHORT, 100.0),
    "MCAP": ("rosbags", SHORT, 100.0),
}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kilobytes")
@pytest.mark.parametrize("form", FORMS)
def test_memory_is_flat(form):
    library, lengths, most = FORMS[form]
    for needed in ("pyarrow", library):
        pytest.importorskip(needed)
    call = [sys.executable, str(BENCHMARK), "--form", form]
    call += ["--samples", *map(str, lengths)]
    printed = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    rows = [line.split("|") for line in printed.splitlines()[2:4]]
    short, long = (float(row[4]) for row in rows)
    assert long < 1000.0
    assert long - short < most
