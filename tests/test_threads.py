"""One BLAS thread, whichever of the libraries was imported first."""

import os
import subprocess
import sys

_SEEN = """
from consistent_id._support.executors import _controller, single_threaded
held = single_threaded(lambda: _controller().info())()
import scipy.linalg, threadpoolctl
every = threadpoolctl.threadpool_info()
paths = {i["filepath"] for i in every if i["user_api"] == "blas"}
assert {i["filepath"] for i in held if i["user_api"] == "blas"} == paths
assert {i["num_threads"] for i in held if i["user_api"] == "blas"} <= {1}
"""


def test_scipys_own_blas_is_held_too_though_nothing_has_imported_it_yet():
    # The tests run with one BLAS thread themselves: conftest.py sets these.
    free = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    subprocess.run([sys.executable, "-c", _SEEN], check=True, env=free)
