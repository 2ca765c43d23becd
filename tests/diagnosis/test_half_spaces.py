"""Bounds from half-spaces against fits under constraints, solved one by one."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm, at_samples, clean_log

from consistent_id.diagnosis.channel_factors import (
    channel_factors,
    half_spaces_at,
    least_within,
)
from consistent_id.diagnosis.explain import datasheet_constraints
from consistent_id.estimation.best_fit import best_fit
from consistent_id.regression import base_parameters


@pytest.fixture(scope="module")
def fitted():
    """Some logs of one arm with wrong torque: factors, and fits of possible robots."""
    model, base = arm(), base_parameters(arm())
    known = datasheet_constraints(model)
    found = []
    for scale in (1.0, -1.0, 3.0, 0.2):
        log = at_samples(clean_log(0))
        log = replace(log, torque=log.torque * np.array([1.0, scale, 1.0, scale]))
        (factors,) = channel_factors(model, base, [log])
        fit = best_fit(model, factors.regression(), known, base=base)
        found.append((factors, fit))
    return found


@pytest.mark.slow
def test_a_bound_is_never_above_the_misfit_of_the_best_possible_robot(fitted):
    better = 0
    for one, fit in fitted:
        least, misfit = one.least_misfit(), one.relative(fit.misfit)
        for other, of_other in fitted:
            bound = least_within(one.joined(), half_spaces_at(other, of_other))
            # Fits are exact to 1e-6 of what they leave.
            assert least <= bound <= misfit * (1 + 1e-6)
            better += other is not one and bound > 1.01 * least
    assert better > 0  # else the half-spaces say nothing


def test_its_own_half_space_bounds_a_log_by_its_misfit(fitted):
    for factors, fit in fitted:
        bound = least_within(factors.joined(), half_spaces_at(factors, fit))
        assert bound == pytest.approx(factors.relative(fit.misfit), rel=1e-5)


def test_base_parameters_that_a_log_leaves_open_are_bounded_by_least_squares(fitted):
    factors, fit = fitted[1]
    R = factors.joined()
    R[:, 3] = 0.0
    assert least_within(R, half_spaces_at(factors, fit)) == pytest.approx(
        abs(R[-1, -1])
    )


def test_no_half_space_comes_of_a_fit_that_is_not_certified(fitted):
    factors, fit = fitted[1]
    loose = replace(fit, optimality=replace(fit.optimality, gap=1.0))
    assert half_spaces_at(factors, loose) == []


def test_no_half_space_comes_of_a_fit_that_constraints_cost_nothing(fitted):
    factors, fit = fitted[0]
    R = factors.joined()
    free = factors.base.lift(np.linalg.solve(R[:-1, :-1], R[:-1, -1]))
    found = replace(fit.solution, u=free / fit.scaled.unit)
    assert half_spaces_at(factors, replace(fit, solution=found)) == []
    assert half_spaces_at(*fitted[1])  # while reversed torque has one
