"""Half of 95 % intervals: Student's quantile for the noise's degrees of freedom."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment

import consistent_id as ci
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained import constrained_estimate
from consistent_id.estimation.constrained_fit import constrained_fit
from consistent_id.estimation.determination import linear_errors
from consistent_id.estimation.estimate import Estimate
from consistent_id.regression.base import base_parameters
from consistent_id.regression.residual_noise import half_widths, unconstrained_fit

FREE = ci.constraints.ParameterBounds({"j1.viscous": (-100.0, 100.0)})


def fitted(freedom, *, bounds=(FREE,), **options):
    """Estimates of an arm of two joints, whose noise has a freedom for each joint."""
    model, truth, log = experiment(4, joints=2, noise=0.5, samples=300, **options)
    regression = ci.build_regression(model, log)
    noise = replace(regression.noise, freedom=np.array(freedom), beyond=1.0)
    regression = replace(regression, noise=noise)
    bound = ci.constrained_least_squares(model, regression, constraints=list(bounds))
    return model, truth, regression, bound


def test_a_parameter_of_one_joint_has_students_quantile_for_that_joint():
    model, _, regression, bound = fitted([5.0, 8.0])
    plain = ci.least_squares(model, regression)
    # Columns of the last joint's drive are zero in the other joint's rows, but its
    # parameters follow bodies that are in both, so they have a little of both.
    places = [model.layout.index(f"j1.{term}") for term in ("viscous", "coulomb")]
    for estimate in (plain, bound):
        shown = estimate.parameter_quantiles[places]
        assert shown == pytest.approx([2.306] * 2, abs=0.02)  # t, eight degrees
        assert estimate.half_intervals[places] == pytest.approx(
            shown * estimate.parameter_errors[places]
        )
    # Parameters of both joints have more degrees of freedom than those of one.
    assert bound.parameter_quantiles.max() <= 2.571
    base = base_parameters(model)
    quantiles = unconstrained_fit(regression, base).noise.quantiles
    assert plain.base_quantiles == pytest.approx(quantiles)
    assert plain.base_half_intervals == pytest.approx(quantiles * plain.standard_errors)


def test_the_noise_of_two_joints_together_has_the_freedom_of_satterthwaite():
    model, _, regression, _ = fitted([5.0, 8.0])
    noise = unconstrained_fit(regression, base_parameters(model)).noise
    g = np.random.default_rng(0).normal(size=(1, noise.rank))
    first, second = (float(np.sum((N @ g.T) ** 2)) for N in noise.of_joints)
    expected = (first + second) ** 2 / (first**2 / 5.0 + second**2 / 8.0)
    assert noise.freedoms_along(g) == pytest.approx(expected)
    assert half_widths(np.array([1.0, np.inf])) == pytest.approx(
        [12.706, 1.960], abs=1e-3
    )
    # As a whole, it has the freedom that it is given.
    assert noise.with_freedom(7.0).freedoms_along(g) == pytest.approx(7.0)


@pytest.mark.slow
def test_half_intervals_are_in_files_frames_and_uncertainty(tmp_path):
    model, _, regression, bound = fitted([5.0, 8.0])
    path = bound.save(tmp_path / "estimate.json")
    again = Estimate.load(path, model, bound.base)
    assert again.half_intervals == pytest.approx(bound.half_intervals, nan_ok=True)
    listed = bound.to_dict()["parameters"]["j1.viscous"]
    place = model.layout.index("j1.viscous")
    assert listed["half_interval"] == pytest.approx(bound.half_intervals[place])
    pytest.importorskip("pandas")
    column = bound.to_frame()["half_interval"]
    assert column.to_numpy() == pytest.approx(bound.half_intervals, nan_ok=True)
    # Of two short segments, the scatter is that of the noise of both together.
    noise = replace(regression.noise, effective=np.full(2, 5.0))
    half = replace(regression, counts=(150, 150), noise=noise)
    sure = ci.uncertainty(model, [half, half], constraints=[FREE], replicates=2)
    found = sure["j1.viscous"]
    assert found.quantile == pytest.approx(2.120, abs=0.01)  # t, 16 degrees
    assert found.half_interval == pytest.approx(found.quantile * found.standard_error)
    # Of two long ones, it is that between them.
    long = replace(half, noise=replace(noise, effective=np.full(2, 150.0)))
    sure = ci.uncertainty(model, [long, long], constraints=[FREE], replicates=2)
    assert sure["j1.viscous"].quantile == pytest.approx(12.706, abs=1e-3)


def test_a_bound_that_is_active_by_chance_halves_the_variance():
    """A truth on its bound: the estimate is max(z, 0), of mean square one half."""
    model, _, regression, _ = fitted([50.0, 50.0])
    place = model.layout.index("j1.viscous")
    prior = ci.constraints.PointToSet(slack=1e-9)  # moves next to nothing

    def under(*bounds):
        return ci.constrained_least_squares(
            model, regression, constraints=bounds, prior=prior
        )

    free = under()
    edge = free["j1.viscous"] + 0.5 * free.parameter_errors[place]
    bound = ci.constraints.ParameterBounds({"j1.viscous": (edge, 100.0)})
    active = under(bound)
    assert active["j1.viscous"] == pytest.approx(edge)
    ratio = active.parameter_errors[place] / free.parameter_errors[place]
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.01)
    # A parameter that is not correlated with it keeps its error, others lose a part.
    known = np.isfinite(free.parameter_errors)
    ratios = active.parameter_errors[known] / free.parameter_errors[known]
    assert (ratios <= 1.001).all() and (ratios >= np.sqrt(0.5) - 0.01).all()


def test_a_prior_narrows_no_error_where_no_inequality_is_active():
    """The error is that of least squares and, beside it, how far the prior moved it."""
    model, _, regression, _ = fitted([50.0, 50.0])
    problem = FitProblem.of(model, regression, (), base_parameters(model))
    prior = ci.constraints.PointToSet(slack=0.05)
    found, fit = constrained_estimate(problem, prior, method="x"), problem.free
    moved = constrained_fit(problem, prior)
    shift = abs(moved.parameters - moved.best.parameters)
    plain = linear_errors(fit.base, fit.noise, np.zeros((0, len(model.layout))))
    known = np.isfinite(found.parameter_errors)
    assert known.any()
    assert found.parameter_errors[known] == pytest.approx(
        np.hypot(plain.values, shift)[known], rel=1e-6
    )


def test_a_parameter_between_equal_bounds_is_known_and_has_no_error():
    model, _, regression, free = fitted([50.0, 50.0])
    place = model.layout.index("j1.viscous")
    assert free.origins[place] == "data" and free.parameter_errors[place] > 0.0
    known = ci.constraints.ParameterBounds({"j1.viscous": (0.3, 0.3)})
    found = ci.constrained_least_squares(model, regression, constraints=[known])
    assert found["j1.viscous"] == pytest.approx(0.3, abs=1e-12)
    assert found.origins[place] == "constraint"
    assert not found.parameter_errors[place] > 0.0
