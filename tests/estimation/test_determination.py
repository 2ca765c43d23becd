"""What determines a parameter: the same in every table, and relative to its value."""

import numpy as np
import pytest
from experiments import pendulum

from consistent_id import (
    FixedMasses,
    PhysicalConsistency,
    base_parameters,
    build_regression,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.comparison.parameter_uncertainty import uncertainty
from consistent_id.estimation.determination import linear_errors, parameter_sizes
from consistent_id.regression.residual_noise import residual_noise
from consistent_id.regression.segments import merged, segment_regressions

BODIES = (PhysicalConsistency(), FixedMasses())


def noisy(noise, seed=0):
    model, truth, log = pendulum()
    rng = np.random.default_rng(seed)
    return model, simulate_torque(model, truth, log, noise=noise, rng=rng)


def test_errors_without_equalities_are_those_of_least_squares():
    model, log = noisy(0.5)
    regression, base = build_regression(model, log), base_parameters(model)
    none = np.zeros((0, len(model.layout)))
    found = linear_errors(base, residual_noise(regression, base), none)
    stated = least_squares(model, regression, base=base).standard_errors
    assert found[list(base.independent)] == pytest.approx(stated, rel=1e-6)


def test_an_equality_that_ties_two_parameters_shrinks_their_errors():
    # hx = hy: one unknown with the information of both, and their cross terms.
    model, log = noisy(0.5)
    regression, base = build_regression(model, log), base_parameters(model)
    tie = np.zeros((1, len(model.layout)))
    tie[0, 1:3] = 1.0, -1.0
    noise = residual_noise(regression, base)
    found = linear_errors(base, noise, tie)
    assert found[1] == pytest.approx(found[2])
    free = linear_errors(base, noise, tie[:0])
    assert found[1] < free[1]


def test_a_size_is_the_value_or_a_tenth_of_the_torque():
    model, log = noisy(0.5)
    regression = build_regression(model, log)
    (factor,) = regression.factors
    x = np.zeros(len(model.layout))
    k = model.layout.index("joint1.viscous")
    torque, column = (np.linalg.norm(factor[:, i]) for i in (-1, k))
    sizes = parameter_sizes(model, regression, x)
    assert sizes[k] == pytest.approx(0.1 * torque / column)
    x[k] = -100.0
    assert parameter_sizes(model, regression, x)[k] == 100.0


@pytest.mark.parametrize("noise", [0.05, 3.0])
def test_estimate_and_uncertainty_agree_on_what_the_data_determine(noise):
    model, log = noisy(noise)
    segments = segment_regressions(model, log, count=8)
    estimate = constrained_least_squares(model, merged(segments), constraints=BODIES)
    found = uncertainty(model, segments, constraints=BODIES, replicates=4)
    verdicts = [p.verdict for p in found.parameters]
    for origin, verdict in zip(estimate.origins, verdicts, strict=True):
        # Intervals can only add that constraints leave no room.
        assert verdict == origin or verdict == "constraint"
        assert (origin == "data") == (verdict == "data")


def test_a_standard_error_holds_the_priors_bias_and_is_only_where_it_means_something():
    model, log = noisy(1.0)
    segments = segment_regressions(model, log, count=8)
    found = uncertainty(model, segments, constraints=BODIES, replicates=4)
    for p in found.parameters:
        if p.verdict in ("data", "constraint"):
            assert p.standard_error >= p.prior_shift
        else:
            assert np.isnan(p.standard_error)
    assert "scatter" in found.scatter
