"""The recommended method is the simplest within one standard error of the best."""

import numpy as np
import pytest
from experiments import experiment

from consistent_id import ProblemError
from consistent_id.constraints import PointToSet
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.estimation.recommendation import (
    MethodCandidate,
    Recommendation,
    _simplest,
    recommend,
)
from consistent_id.regression import base_parameters, segment_regressions


def test_of_errors_that_do_not_scatter_the_least_is_taken():
    assert _simplest(np.array([[3.0, 3.0], [2.0, 2.0], [4.0, 4.0]])) == 1


def test_the_first_within_one_standard_error_of_the_least_is_taken():
    spread = 0.1 * np.array([-1.0, 1.0, -1.0, 1.0])
    squared = np.array([1.05 + spread, 1.4 + spread, 1.0 + spread])
    # Standard error of the mean: 0.1 sqrt(4/3) / 2 = 0.058.
    assert _simplest(np.sqrt(squared)) == 0
    assert _simplest(np.sqrt(squared + np.array([[0.02], [0.0], [0.0]]))) == 2
    assert _simplest(np.full((3, 4), np.inf)) == 0


def test_the_expected_error_is_that_of_another_motion():
    model, _truth, log = experiment(3, joints=3, noise=0.5, samples=1200)
    _, _, other = experiment(3, joints=3, noise=0.5, samples=1200)
    base = base_parameters(model)
    found = recommend(
        model,
        segment_regressions(model, log),
        [
            MethodCandidate("constrained", False, PointToSet()),
            MethodCandidate("weighted constrained", True, PointToSet()),
        ],
        constraints=DEFAULT_CONSTRAINTS,
        base=base,
    )
    # One joint turns and two slide: each kind has its own relative error.
    squares = np.mean(other.torque**2, axis=0)
    noise = np.sqrt(np.mean([0.5**2 / squares[0], 2 * 0.5**2 / squares[1:].sum()]))
    assert found.expected == pytest.approx(noise, rel=0.1)
    assert found.method == "constrained"
    assert "on a motion not seen" in found.statement


def test_nothing_to_recommend_is_refused():
    model, _, log = experiment(0, joints=2, samples=300)
    with pytest.raises(ProblemError, match="0 candidates"):
        recommend(
            model,
            segment_regressions(model, log),
            [],
            constraints=DEFAULT_CONSTRAINTS,
            base=base_parameters(model),
        )


def test_where_no_block_can_be_left_out_it_says_so():
    nothing = Recommendation("a", ("a", "b"), np.full((2, 3), np.inf))
    assert nothing.expected is None
    assert "no block" in nothing.statement
