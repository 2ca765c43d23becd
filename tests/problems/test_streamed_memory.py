"""Memory does not grow with a log, whatever its format."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "streaming.py"
FORMS = {"Parquet": "pyarrow", "CSV": "numpy", "HDF5": "h5py", "MCAP": "rosbags"}
MORE = (
    30.0  # MB: a third of what the samples that are more would take as 64-bit numbers
)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kilobytes")
@pytest.mark.parametrize("form", FORMS)
def test_memory_is_flat(form):
    for library in ("pyarrow", FORMS[form]):
        pytest.importorskip(library)
    lengths = ["200000", "1000000"]  # some windows, and many
    call = [sys.executable, str(BENCHMARK), "--form", form, "--samples", *lengths]
    printed = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    rows = [line.split("|") for line in printed.splitlines()[2:4]]
    short, long = (float(row[4]) for row in rows)
    assert long < 1000.0
    assert long - short < MORE
