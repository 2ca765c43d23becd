"""Clean simulated logs of published arms: drafted, selected, and not accused."""

import importlib
import sys
from pathlib import Path

import pytest

from consistent_id.problems.log_check import check_problem

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


MODULES = ("clean_simulations", "faults_robots", "point_to_point", "repair")


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        5,  # a gain of 1.23, to a model without rotors
        13,  # friction's edges in a short validation part; zeros, without rotors
        54,  # a validation part in which a joint turns one way alone
        64,  # a rotor and another centre of mass, which together look like a gain
        67,  # a width of friction, which looks like a scale of the last position
        1009,  # another gain of 1.24, to a model without rotors
        20001,  # poses, between which joints move at one speed and stop
    ],
)
def test_a_clean_log_of_a_published_arm_is_not_accused(seed, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    before = set(sys.modules)
    clean = importlib.import_module("clean_simulations")
    try:
        problem = clean.problem_of(seed, clean.written(seed, tmp_path))
        assert check_problem(problem).suspicious == ()
    finally:  # other tests load benchmarks of these names from files
        for name in set(sys.modules) - before:
            if name in MODULES:
                del sys.modules[name]
