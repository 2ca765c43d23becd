"""The recommended method is the simplest within one standard error of the best."""

import numpy as np
import pytest
from experiments import experiment

from consistent_id import ProblemError
from consistent_id.constraints import Penalty, PointToSet
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.estimation.left_out import (
    LeftOutErrors,
    folds_of,
    left_out_errors,
    left_out_fits,
)
from consistent_id.estimation.recommendation import SlackChoice, recommend
from consistent_id.regression import base_parameters, segment_regressions


def recommended(squares):
    n = len(squares[0])
    found = [
        LeftOutErrors([np.sqrt(row)], np.full(n, 1 / n), [1.0], [1.0])
        for row in squares
    ]
    return recommend(dict(zip("abc", found, strict=False)))


def test_of_errors_that_do_not_scatter_the_least_is_taken():
    assert recommended([[9.0, 9.0], [4.0, 4.0], [16.0, 16.0]]).method == "b"


def test_the_first_within_one_standard_error_of_the_least_is_taken():
    spread = 0.1 * np.array([-1.0, 1.0, -1.0, 1.0])
    squared = np.array([1.05 + spread, 1.4 + spread, 1.0 + spread])
    # Standard error of the mean: 0.1 sqrt(4/3) / 2 = 0.058.
    assert recommended(squared).method == "a"
    assert recommended(squared + np.array([[0.02], [0.0], [0.0]])).method == "c"
    assert recommended(np.full((3, 4), np.inf)).method == "a"


def test_an_expectation_that_says_nothing_is_a_sentence_and_no_figure():
    said = recommended([[0.01, 40.0]]).statement
    assert "unknown" in said and "%" not in said
    assert "record faster motion" in said
    assert "%" in recommended([[0.01, 0.02]]).statement


@pytest.mark.slow
def test_the_expected_error_is_that_of_another_motion():
    model, _truth, log = experiment(3, joints=3, noise=0.5, samples=1200)
    _, _, other = experiment(3, joints=3, noise=0.5, samples=1200)
    folds, base = folds_of(segment_regressions(model, log)), base_parameters(model)
    found = recommend(
        {
            method: left_out_errors(
                left_out_fits(
                    model,
                    folds,
                    constraints=DEFAULT_CONSTRAINTS,
                    base=base,
                    weighted=weighted,
                ),
                [PointToSet()],
            )
            for method, weighted in (("plain", False), ("weighted", True))
        }
    )
    # One joint turns and two slide: each kind has its own relative error.
    squares = np.mean(other.torque**2, axis=0)
    noise = np.sqrt(np.mean([0.5**2 / squares[0], 2 * 0.5**2 / squares[1:].sum()]))
    assert found.expected.error == pytest.approx(noise, rel=0.1)
    assert found.expected.contains(noise)
    assert found.method == "plain"
    assert "on a motion not seen" in found.statement and "80 %" in found.statement
    assert found.others.startswith("other methods") and "weighted" in found.others


def test_nothing_to_recommend_is_refused():
    with pytest.raises(ProblemError, match="no method"):
        recommend({})


def test_where_no_block_can_be_left_out_it_says_so():
    nothing = recommended(np.full((2, 3), np.inf))
    assert nothing.expected is None
    assert "no block" in nothing.statement
    assert nothing.others == ""


def choice(errors, priors=None):
    tried = (PointToSet(), PointToSet(slack=0.01), PointToSet(slack=0.05))
    pairs = np.column_stack([errors, errors])
    ones = np.ones(len(pairs))
    left_out = LeftOutErrors(pairs, [0.5, 0.5], ones, ones)
    return SlackChoice(tried if priors is None else priors, left_out)


def test_the_slack_with_the_least_error_on_what_was_left_out_is_chosen():
    found = choice([0.03, 0.02, 0.04])
    assert (found.best, found.prior.slack) == (1, 0.01)
    assert found.chosen.pooled == pytest.approx([0.02])
    assert found.slacks == ("default", "0.01", "0.05")
    assert found.statement.startswith("slack 0.01, chosen by the least error")
    assert found.statement.endswith("default 3.00 %, 0.01 2.00 %, 0.05 4.00 %")
    record = found.to_dict()
    assert record["chosen"] == "0.01"
    assert record["left_out_errors"]["default"] == pytest.approx(0.03)


def test_a_slack_that_cannot_be_tried_has_no_error_and_the_first_is_kept():
    found = choice([np.inf, 0.02, 0.04])
    assert found.prior.slack == 0.01
    assert found.to_dict()["left_out_errors"]["default"] is None
    assert choice([np.inf, np.inf, np.inf]).best == 0


def test_of_a_stated_prior_nothing_is_said():
    for prior in (PointToSet(slack=0.02), Penalty(0.1)):
        found = choice([0.03], (prior,))
        assert (found.slacks, found.statement, found.to_dict()) == ((), "", None)
        assert found.prior == prior
