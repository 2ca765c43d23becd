"""Masses that nothing bounds: the best fit is attained, and says what was bounded."""

import numpy as np
import pytest
from experiments import experiment
from some_fast import some_fast

from consistent_id import (
    DHRow,
    DriveTerms,
    FixedMasses,
    InertialParameters,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    differentiated,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.constraints import TotalMass
from consistent_id.estimation.best_fit import FitProblem, attained_fit
from consistent_id.regression import base_parameters

BODIES = (PhysicalConsistency(), NonNegativeDrive())
DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True)


def arm(seed, joints, samples, amplitude, noise):
    """An arm without a datasheet, its log, and its true parameters."""
    rng = np.random.default_rng([seed, joints])
    rows = [
        DHRow(rng.choice([0.0, np.pi / 2, -np.pi / 2]), *rng.uniform(0.1, 0.4, 2))
        for _ in range(joints)
    ]
    model = TorqueModel(from_modified_dh("arm", rows), DRIVE)
    time = np.arange(samples) / 100
    waves = np.sin(np.outer(time, rng.uniform(0.3, 4.0, 4)))
    q = amplitude * waves @ rng.normal(size=(4, joints))
    motion = differentiated(Recording(model.robot.joint_names, time, q))
    bodies = []
    for k in range(joints):
        mass, reach = rng.uniform(1.0, 8.0) / (k + 1), rng.uniform(0.05, 0.3)
        inertia = mass * reach**2 * np.diag(rng.uniform(0.3, 0.5, 3))
        com = rng.uniform(-reach, reach, 3)
        bodies.append(InertialParameters.from_central(mass, com, inertia).vector)
    truth = np.concatenate([*bodies, rng.uniform(0.1, 2.0, 3 * joints)])
    return model, truth, simulate_torque(model, truth, motion, noise=noise, rng=rng)


@pytest.mark.parametrize("joints", some_fast([2, 6, 7]))
@pytest.mark.parametrize(
    ("samples", "amplitude", "noise"),
    some_fast(
        [(300, 0.7, 0.3), (300, 0.15, 0.5), (3000, 0.7, 0.3), (3000, 0.05, 1.0)], 2
    ),
)
@pytest.mark.parametrize("seed", some_fast(range(2)))
def test_masses_free_end_certified(joints, samples, amplitude, noise, seed):
    model, truth, log = arm(seed, joints, samples, amplitude, noise)
    regression = build_regression(model, log)
    estimate = constrained_least_squares(model, regression, constraints=BODIES)
    assert estimate.certificate.verdict == "certified"
    # The true robot is one of those that compete, so that it fits no better.
    fitted, true = (regression.residual_rms(x) for x in (estimate.parameters, truth))
    assert np.sum(fitted**2) <= np.sum(true**2)
    assert estimate.links[:, 0].sum() <= 10.0 * joints * 10.0


def test_the_mass_that_data_leave_open_is_named():
    model, _, log = arm(0, 2, 3000, 0.05, 1.0)
    base, regression = base_parameters(model), build_regression(model, log)
    found = attained_fit(FitProblem.of(model, regression, BODIES, base))
    masses = found.best.parameters[: model.layout.inertial_size : 10]
    bound = found.constraints[-1].upper_bound
    assert found.constraints[:-1] == BODIES
    assert masses.sum() == pytest.approx(bound, rel=1e-2)
    heaviest = model.layout.links[int(np.argmax(masses))]
    assert f"do not bound the mass of {heaviest}" in found.note
    estimate = constrained_least_squares(model, regression, constraints=BODIES)
    assert found.note in estimate.notes[0]


def test_the_bound_is_raised_for_a_robot_that_is_heavier():
    model, truth, log = experiment(3, joints=3, samples=1000)
    heavy = truth.copy()
    heavy[:30] *= 40.0
    log = simulate_torque(model, heavy, log, noise=0.1, rng=np.random.default_rng(0))
    base, regression = base_parameters(model), build_regression(model, log)
    found = attained_fit(FitProblem.of(model, regression, BODIES, base))
    # The next power of ten above 40 times the typical masses.
    typical = model.robot.nominal[::10].sum()
    assert found.constraints[-1].upper_bound == pytest.approx(100.0 * typical)
    error = base.projection @ (found.best.parameters - heavy)
    assert abs(error).max() <= 1e-3 * abs(base.projection @ heavy).max()


@pytest.mark.parametrize(
    "known",
    [
        FixedMasses({f"link{k}": 2.0 for k in (1, 2)}),
        MassBounds({f"link{k}": (0.0, 50.0) for k in (1, 2)}),
        TotalMass(0.0, 900.0),
    ],
)
def test_masses_that_are_bounded_get_no_other_bound(known):
    model, _, log = arm(1, 2, 300, 0.7, 0.3)
    given = (*BODIES, known)
    base = base_parameters(model)
    regression = build_regression(model, log)
    found = attained_fit(FitProblem.of(model, regression, given, base))
    assert found.constraints == given
    assert found.note == ""


def test_the_total_is_bounded_where_a_bound_of_one_mass_leaves_another_open():
    model, _, log = arm(1, 2, 300, 0.7, 0.3)
    given = (*BODIES, MassBounds({"link1": (0.0, 50.0)}))
    base = base_parameters(model)
    regression = build_regression(model, log)
    found = attained_fit(FitProblem.of(model, regression, given, base))
    *others, total = found.constraints
    assert (tuple(others), type(total)) == (given, TotalMass)
