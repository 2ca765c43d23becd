"""The slack is the one with the least pooled error on data left out."""

import numpy as np
import pytest
from experiments import experiment

from consistent_id.constraints import Penalty, PointToSet
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.estimation.left_out import LeftOutErrors, folds_of, left_out_fits
from consistent_id.estimation.recommendation import SLACKS, SlackChoice, chosen_slack
from consistent_id.regression import base_parameters, segment_regressions
from consistent_id.regression.segments import merged


def choice(errors):
    tried = (PointToSet(), *(PointToSet(slack) for slack in SLACKS))
    rows = np.array(errors)[:, None] * np.ones(4)
    ones = np.ones(len(errors))
    return SlackChoice(tried, LeftOutErrors(rows, np.full(4, 0.25), ones, ones))


def test_the_least_error_decides_and_of_equal_ones_the_least_slack():
    found = choice([0.05, 0.04, 0.03, 0.02, 0.02, 0.06])
    assert found.prior == PointToSet(0.01)
    assert found.chosen.pooled == pytest.approx([0.02])
    assert "slack 0.01" in found.statement and "0.05 6.00 %" in found.statement
    assert found.to_dict()["chosen"] == "0.01"


def test_without_a_block_that_can_be_left_out_the_default_is_kept():
    assert choice([np.inf] * 6).prior == PointToSet()


@pytest.fixture(scope="module")
def logged():
    # The truth is the nominal robot, the noise large and the log short.
    model, truth, log = experiment(5, joints=4, noise=20.0, samples=150)
    return model, truth, segment_regressions(model, log), base_parameters(model)


@pytest.mark.slow
def test_where_noise_hides_the_robot_a_large_slack_is_chosen_and_is_nearer(logged):
    model, truth, segments, base = logged
    found = chosen_slack(
        left_out_fits(
            model, folds_of(segments), constraints=DEFAULT_CONSTRAINTS, base=base
        ),
        PointToSet(),
    )
    assert len(found.tried) == 1 + len(SLACKS)
    assert found.prior.slack >= 0.01
    whole = merged(segments)
    plain, chosen = (
        constrained_least_squares(model, whole, prior=prior, base=base)
        for prior in (PointToSet(), found.prior)
    )
    assert chosen.certificate.verdict == "certified"
    assert chosen.certificate.figures["slack"] == found.prior.slack
    Y = whole.stacked()[:, :-1]
    errors = [np.linalg.norm(Y @ (e.parameters - truth)) for e in (plain, chosen)]
    assert errors[1] < errors[0]


@pytest.mark.slow
@pytest.mark.parametrize("prior", [PointToSet(0.004), Penalty(0.1)])
def test_a_stated_prior_is_the_only_one_tried(logged, prior):
    model, _, segments, base = logged
    found = chosen_slack(
        left_out_fits(
            model, folds_of(segments), constraints=DEFAULT_CONSTRAINTS, base=base
        ),
        prior,
    )
    assert found.tried == (prior,) and found.prior == prior
    assert found.statement == "" and found.to_dict() is None


@pytest.mark.slow
def test_the_choice_is_the_same_again(logged):
    model, _, segments, base = logged
    first, second = (
        chosen_slack(
            left_out_fits(
                model,
                folds_of(segments),
                constraints=DEFAULT_CONSTRAINTS,
                base=base,
                weighted=True,
            ),
            PointToSet(),
        )
        for _ in range(2)
    )
    assert np.array_equal(first.left_out.errors, second.left_out.errors)
