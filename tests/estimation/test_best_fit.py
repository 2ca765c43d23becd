"""The best fit's misfit is that of its parameters on the regression itself."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment

from consistent_id import (
    FixedMasses,
    PhysicalConsistency,
    SolverError,
    build_regression,
)
from consistent_id.constraints import TotalMass
from consistent_id.estimation import best_fit as best_fits
from consistent_id.estimation.best_fit import _gain, best_fit, scaled_fit
from consistent_id.regression.base import base_parameters


@pytest.mark.parametrize("noise", [0.05, 5.0])
@pytest.mark.parametrize("wrong_mass", [1.0, 1.5])
def test_the_misfit_is_the_norm_of_all_residuals(noise, wrong_mass):
    model, truth, log = experiment(3, noise=noise)
    regression = build_regression(model, log).weighted([1.0, 2.0, 3.0, 0.5])
    last = model.layout.links[-1]
    mass = wrong_mass * truth[model.layout.index(f"{last}.m")]
    constraints = [PhysicalConsistency(), FixedMasses({last: mass})]
    best = best_fit(model, regression, constraints, base=base_parameters(model))
    R = regression.stacked()
    expected = np.linalg.norm(R[:, :-1] @ best.parameters - R[:, -1])
    assert best.misfit == pytest.approx(expected, rel=1e-8)


def test_the_misfit_is_right_also_where_it_is_less_than_a_millionth_of_the_torque():
    model, _, exact = experiment(3)
    noise = 3e-7 * np.sqrt(np.mean(exact.torque**2))
    log = experiment(3, noise=noise)[2]
    regression = build_regression(model, log)
    base = base_parameters(model)
    best = best_fit(model, regression, [PhysicalConsistency()], base=base)
    assert 0.1 < best.scaled.residual < 0.9
    R = regression.stacked()
    expected = np.linalg.norm(R[:, :-1] @ best.parameters - R[:, -1])
    assert best.misfit == pytest.approx(expected, rel=1e-4)


def test_the_torque_of_one_unit_of_a_drive_term_is_as_large_as_all_torque():
    """Of joints at rest, it is a thousandth of the largest unit's torque instead."""
    model, _, log = experiment(3, joints=3, samples=200)
    slow = log.velocity * [1.0, 1e-6, 0.1]
    log = replace(log, velocity=slow, acceleration=np.zeros_like(slow))
    regression = build_regression(model, log).weighted([1.0, 2.0, 3.0])
    fit = scaled_fit(model, regression, base_parameters(model), ())
    R = regression.stacked()
    names, sizes = model.layout.names, np.linalg.norm(R[:, :-1], axis=0)
    norms = dict(zip(names, sizes, strict=True))
    expected = []
    for name in names[model.layout.inertial_size :]:
        largest = max(norms[f"j{k}.{name.split('.')[1]}"] for k in range(3))
        size = max(norms[name], 1e-3 * largest)
        expected.append(np.linalg.norm(R[:, -1]) / size if size > 0.0 else 1.0)
    assert 1.0 in expected  # without acceleration, rotors have no torque
    np.testing.assert_allclose(fit.unit[model.layout.inertial_size :], expected)


def test_the_gain_from_more_mass_is_bounded_by_the_price_of_its_bound():
    """Of 5 units more than 0.2 each, half squared, to ten times the mass: 9 times 5."""
    total = TotalMass(0.0, 40.0)
    domain = SimpleNamespace(
        in_labels=("other", "total mass <= 40 kg"), b_in=np.array([1.0, 5.0])
    )
    prices = SimpleNamespace(at_most=np.array([7.0, 0.2]))
    best = SimpleNamespace(
        scaled=SimpleNamespace(domain=domain, size=3.0),
        solution=SimpleNamespace(multipliers=prices),
    )
    assert _gain(best, total) == pytest.approx(2.0 * 0.2 * 9.0 * 5.0 * 3.0**2)


@pytest.mark.parametrize(
    ("violation", "message"),
    [(0.9e-5, None), (1.1e-5, "best point violates"), (None, "no finite point")],
)
def test_a_doubtful_point_is_taken_up_to_a_violation(monkeypatch, violation, message):
    def solve(*given, **how):
        if violation is None:
            raise SolverError("no finite point")
        return "point", SimpleNamespace(violation=violation)

    monkeypatch.setattr(best_fits, "solve_certified", solve)
    monkeypatch.setattr(best_fits, "irreducible_conflict", lambda domain: ())
    problem = SimpleNamespace(domain=None)
    if message is None:
        assert best_fits.solved(problem, np.zeros(1))[0] == "point"
    else:
        with pytest.raises(SolverError, match=message):
            best_fits.solved(problem, np.zeros(1))
