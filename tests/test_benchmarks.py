"""The benchmarks run, and both ways that they time give the same answer."""

import importlib.util
from pathlib import Path

import pytest


def _speed():
    path = Path(__file__).parent.parent / "benchmarks" / "speed.py"
    spec = importlib.util.spec_from_file_location("speed", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_our_way_and_the_stacked_way_leave_the_same_residual():
    speed = _speed()
    model = speed.arm()
    data = speed.log(model, 3000)
    # One compresses by QR, the other stacks and solves by SVD.
    assert speed.ours(model, data)["residual"] == pytest.approx(
        speed.stacked(model, data)["residual"], rel=1e-9
    )


def test_the_table_of_the_constrained_solve_can_be_made():
    table = _speed().solve_table(1)
    assert "Clarabel" in table
    assert "certified" in table
