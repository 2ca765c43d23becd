"""Optima for torque that no robot has are proven where another solver finds them too.

Each of these problems of ``benchmarks/odd_torque.py`` was not certified, though CVXPY
found no better point.
"""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from some_fast import some_fast

from consistent_id import build_regression
from consistent_id.constraints.cones.certificate import RADIUS
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import SLACK_GAP, constrained_fit
from consistent_id.estimation.nearest import DISTANCE_GAP
from consistent_id.regression.base import base_parameters

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

FAR = [55, 189, 409, 482, 748, 703]
"""Seeds whose least misfit is that of a robot far beyond the proof's reach."""

THIN = [127, 293, 448, 466, 636, 972]
"""Links of very different eigenvalues: multipliers were not exact enough."""

JUMPS = [297, 336, 867, 905]
"""No weight of the prior uses up the slack: the optimum jumps."""

FLAT = [887]
"""Robots far away fit nearly as well, but rounding leaves no proof of them."""

DIVERGES = 306
"""No robot is light enough for the torque; a solver's point has a size of 1e140."""


@pytest.fixture(scope="module")
def odd_torque():
    before, path = set(sys.modules), BENCHMARKS / "odd_torque.py"
    spec = importlib.util.spec_from_file_location("odd_torque", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["odd_torque"] = module  # dataclasses look there for their module
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec.loader.exec_module(module)
        yield module
    finally:  # other tests load benchmarks of these names from files
        sys.path.remove(str(BENCHMARKS))
        for name in {"odd_torque", "robustness"} - before:
            sys.modules.pop(name, None)


def fitted(odd_torque, seed):
    case = odd_torque.case(seed, **odd_torque.SMALL)
    kind = odd_torque.KINDS[seed % len(odd_torque.KINDS)]
    log = replace(case.recording, torque=odd_torque.odd(case, kind))
    base, regression = base_parameters(case.model), build_regression(case.model, log)
    problem = FitProblem.of(case.model, regression, case.constraints, base)
    return constrained_fit(problem, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    some_fast(FAR) + some_fast(THIN) + some_fast(JUMPS) + some_fast(FLAT),
)
def test_an_optimum_that_another_solver_finds_is_certified(odd_torque, seed):
    found = fitted(odd_torque, seed)
    assert found.certified, found.proof.statement
    assert found.distance_gap <= DISTANCE_GAP and found.slack_gap <= SLACK_GAP
    # Proofs reach ten times as far as the nominal robot, and as the estimate.
    nominal, u = found.distance.nominal, found.final.solution.u
    least = RADIUS * max(1.0 + np.linalg.norm(nominal), np.linalg.norm(u - nominal))
    assert found.final.optimality.radius >= least
    if seed in FAR:
        assert found.best.optimality.radius >= least


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast([297, 55, 905]))
def test_its_figures_are_those_of_the_point_that_is_delivered(odd_torque, seed):
    found = fitted(odd_torque, seed)
    scaled, final, u = found.best.scaled, found.final, found.final.solution.u
    assert scaled.domain.violation(u) == final.optimality.violation
    assert final.excess == pytest.approx(scaled.excess(u), rel=1e-12)
    squared = found.distance.squared(u)
    assert final.squared_distance == pytest.approx(squared, rel=1e-9)
    half = (final.excess + final.weight * squared) / 2.0
    assert final.optimality.objective == pytest.approx(half, rel=1e-9)
    # It is within the slack of the best fit.
    least = scaled.excess(found.best.solution.u)
    whole = max(least + scaled.residual**2, 1.0)
    used = (final.excess - least) / (((1.0 + found.slack) ** 2 - 1.0) * whole)
    assert used <= 1.0 + 1e-6


@pytest.mark.slow
def test_a_solver_that_diverges_leaves_doubt_and_no_warning(odd_torque):
    outcome = odd_torque.run(DIVERGES, small=True)
    assert outcome.verdict == "uncertified" and not outcome.agrees
    assert outcome.warned == ()
