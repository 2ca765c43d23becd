"""One BLAS thread, examples that repeat themselves, and names of doctests."""

import gc
import os
from contextlib import suppress

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import HealthCheck, settings

# Workers share the cores; before NumPy is imported, and for subprocesses too.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# What tests and libraries make mostly stays: look for rubbish seldom.
gc.set_threshold(100_000)

# The same examples on every machine, however slow it is.
settings.register_profile(
    "repeatable",
    max_examples=50,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")

# Nor do examples change with the numbers that the package's source holds: to read it
# for them takes each worker almost two seconds in a fresh clone.
with suppress(ImportError):
    from hypothesis.internal.conjecture import providers

    providers._get_local_constants = lambda: providers._local_constants


@pytest.fixture(autouse=True, scope="session")
def _own_state(tmp_path_factory):
    """Let tests, and processes that they start, record nothing in the user's state."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(autouse=True, scope="session")
def _doctest_names(doctest_namespace):
    import numpy as np

    doctest_namespace["np"] = np


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path):
    """Look for examples in docstrings only where there are any.

    To search a module for them imports it and reads each of its docstrings, in each
    worker.
    """
    found = yield
    if ">>>" in file_path.read_text(encoding="utf-8"):
        return found
    return [one for one in found if not isinstance(one, DoctestModule)]


# What an example in a docstring calls, if it takes above half a second.
_SLOW = (
    *("run_study(", "ci.Study(", "identify_log(", "draft_problem(", "main(["),
    *("ci.diagnose(", "ci.uncertainty(", "ci.design_trajectory(", "ci.to_mjcf("),
)


def pytest_collection_modifyitems(items):
    """Mark examples in docstrings that run a whole study, or so, as slow."""
    for item in items:
        test = getattr(item, "dtest", None)
        if test is not None and any(call in test.docstring for call in _SLOW):
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish():
    """Spare the garbage collector the tests and libraries, which all stay."""
    gc.freeze()
