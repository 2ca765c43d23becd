"""Constraints that exclude each other, and what single ones cost."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment, pendulum

from consistent_id import (
    FixedMasses,
    InfeasibleError,
    NonNegativeDrive,
    PhysicalConsistency,
    build_regression,
    constrained_least_squares,
)
from consistent_id.comparison import base_feasibility, shadow_prices
from consistent_id.constraints import (
    FixedParameters,
    ParameterBounds,
    TotalMass,
    lowered,
)
from consistent_id.constraints.cones.interior import irreducible_conflict
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.estimation import contradiction
from consistent_id.estimation.best_fit import best_fit
from consistent_id.regression import base_parameters


def _rows(*rows):
    A = np.array([row[:-1] for row in rows], float)
    b = np.array([row[-1] for row in rows], float)
    return ConicSet.at_most(A, b, [f"row {i}" for i in range(len(rows))])


def test_a_conflict_holds_no_more_than_it_needs():
    # x + y >= 2 against x <= 0.5 and y <= 0.5; the others have no part in it.
    domain = _rows([1, 0, 0.5], [0, 1, 0.5], [-1, -1, -2], [1, 1, 9], [-1, 0, 4])
    assert irreducible_conflict(domain) == (0, 1, 2)
    for member in (0, 1, 2):
        assert irreducible_conflict(domain.without(member)) == ()


def test_a_set_with_points_has_no_conflict():
    assert irreducible_conflict(_rows([1, 0, 1], [-1, 0, 1])) == ()


def test_members_are_counted_through_equalities_rows_and_blocks():
    model, _, _ = pendulum()
    domain = lowered((FixedMasses(), NonNegativeDrive(), PhysicalConsistency()), model)
    assert domain.labels == (
        "link1.m = 2 kg",
        "joint1.viscous >= 0",
        "physical consistency of link 'link1'",
    )
    assert domain.only([2]).labels == domain.labels[2:]
    assert domain.without(0).labels == domain.labels[1:]


def test_the_value_to_blame_is_named_with_its_cost_and_what_it_would_be():
    model, truth, log = pendulum()
    regression = build_regression(model, log)
    wrong = FixedParameters({"link1.Izz": 0.01, "link1.hx": 0.6})
    constraints = [PhysicalConsistency(), FixedMasses(), wrong]
    found = contradiction(model, regression, constraints)
    best = found.resolutions[0]
    # Without the moment of inertia, everything else is the truth.
    assert best.label == "link1.Izz = 0.01 kg m^2"
    assert best.rms < 1e-5 * np.sqrt(np.mean(log.torque**2))
    assert best.values["link1.Izz"] == pytest.approx(truth[9], rel=1e-4)
    others = [r.rms for r in found.resolutions[1:]]
    assert min(others) > 100 * best.rms
    with pytest.raises(InfeasibleError, match=r"link1\.Izz = 0\.01 kg m\^2.*RMS"):
        constrained_least_squares(model, regression, constraints=constraints)


def test_bounds_that_exclude_each_other_are_a_conflict_of_two():
    model, _, log = pendulum()
    constraints = [
        PhysicalConsistency(),
        ParameterBounds({"joint1.viscous": (1.0, 2.0)}),
        FixedParameters({"joint1.viscous": 0.5}),
    ]
    found = contradiction(model, build_regression(model, log), constraints)
    assert {r.label for r in found.resolutions} == {
        "joint1.viscous >= 1",
        "joint1.viscous = 0.5 N m s/rad",
    }


def test_constraints_that_agree_have_no_contradiction():
    model, _, log = pendulum()
    constraints = [PhysicalConsistency(), FixedMasses()]
    assert contradiction(model, build_regression(model, log), constraints) is None


def test_a_price_is_the_residuals_slope():
    model, _, log = experiment(3, joints=3, noise=1.0)
    regression = build_regression(model, log)
    base = base_parameters(model)
    mass = model.robot.links[-1].nominal.mass

    name = model.layout.links[-1]

    def constrained(value):
        constraints = [PhysicalConsistency(), FixedMasses({name: value})]
        best = best_fit(model, regression, constraints, base=base)
        return constraints, best.misfit / np.sqrt(sum(regression.counts))

    wrong = 1.5 * mass
    constraints, _ = constrained(wrong)
    prices = {p.label: p for p in shadow_prices(model, regression, constraints)}
    price = prices[f"{name}.m = {wrong:.10g} kg"]
    step = 1e-3 * mass
    slope = (constrained(wrong + step)[1] - constrained(wrong - step)[1]) / (2 * step)
    # One percent of a typical mass, which is the nominal one.
    assert price.price == pytest.approx(0.01 * mass * slope, rel=1e-3)
    free = [PhysicalConsistency()]
    rms = best_fit(model, regression, free, base=base).misfit / np.sqrt(
        sum(regression.counts)
    )
    assert price.cost == pytest.approx(constrained(wrong)[1] - rms, rel=1e-4)
    assert price.verdict == "certified"


def test_what_is_not_active_has_no_price():
    model, _, log = pendulum()
    noise = np.random.default_rng(0).normal(size=log.torque.shape)
    noisy = build_regression(model, replace(log, torque=log.torque + noise))
    loose = [ParameterBounds({"joint1.viscous": (0.0, 10.0)}), TotalMass(0.5, 9.0)]
    prices = shadow_prices(model, noisy, [PhysicalConsistency(), *loose])
    assert all("viscous" not in p.label and "total" not in p.label for p in prices)


def test_the_nearest_robot_to_an_impossible_one_is_possible_and_near():
    model, truth, _ = pendulum()
    base = base_parameters(model)
    values = base.projection @ truth
    values[base.names.index("link1.Izz")] = -0.1
    # With a mass: without, ever heavier bodies come ever nearer, and none is nearest.
    known = [PhysicalConsistency(margin=0.0), FixedMasses()]
    answer = base_feasibility(model, base, values, constraints=known)
    assert answer.nearest.verdict == "certified"
    assert 0.0 < answer.nearest.torque_change < 1.0
    again = base_feasibility(model, base, base.projection @ answer.nearest.parameters)
    assert again.answer != "impossible"
    possible = base_feasibility(model, base, base.projection @ truth)
    assert possible.nearest is None


def test_the_misfit_without_a_value_is_that_of_the_estimate_without_it():
    model, _, log = pendulum()
    rng = np.random.default_rng(0)
    log = replace(log, torque=log.torque + 0.3 * rng.normal(size=log.torque.shape))
    regression = build_regression(model, log)
    wrong = {"link1.Izz": 0.01, "link1.hx": 0.6}
    rest = [PhysicalConsistency(), FixedMasses()]
    found = contradiction(model, regression, [*rest, FixedParameters(wrong)])
    by_label = {one.label: one.rms for one in found.resolutions}
    estimate = constrained_least_squares(
        model, regression, constraints=[*rest, FixedParameters({"link1.hx": 0.6})]
    )
    off = log.torque - estimate.predict(log)
    rms = by_label["link1.Izz = 0.01 kg m^2"]
    # The prior may use up a slack of a thousandth.
    assert rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=2e-3)
