"""One BLAS thread, whichever of the libraries was imported first."""

import os
import subprocess
import sys

import pytest

_SEEN = """
from consistent_id._support.executors import _controller, single_threaded
held = single_threaded(lambda: _controller().info())()
import scipy.linalg, threadpoolctl
every = threadpoolctl.threadpool_info()
paths = {i["filepath"] for i in every if i["user_api"] == "blas"}
assert {i["filepath"] for i in held if i["user_api"] == "blas"} == paths
assert {i["num_threads"] for i in held if i["user_api"] == "blas"} <= {1}
"""


@pytest.mark.slow
def test_scipys_own_blas_is_held_too_though_nothing_has_imported_it_yet():
    # The tests run with one BLAS thread themselves: conftest.py sets these.
    free = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    subprocess.run([sys.executable, "-c", _SEEN], check=True, env=free)


_COMMAND = """
import sys
from consistent_id.cli import run
assert "numpy" not in sys.modules
sys.argv = ["consistent-id", "--version"]
try:
    run()
except SystemExit:
    pass
import numpy, scipy.linalg, threadpoolctl
every = threadpoolctl.threadpool_info()
print(max(i["num_threads"] for i in every if i["user_api"] == "blas"))
"""


@pytest.mark.slow
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread")
@pytest.mark.parametrize(
    ("stated", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")]
)
def test_a_command_has_one_thread_unless_another_number_is_stated(stated, threads):
    free = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", _COMMAND],
        check=True,
        env=free | stated,
        capture_output=True,
        text=True,
    )
    assert done.stdout.split()[-1] == threads
