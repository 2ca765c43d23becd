"""Constrained estimates: closed forms, recovery, contradictions, costs."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment, pendulum
from robots import random_robot, random_states
from some_fast import some_fast

from consistent_id import (
    DriveTerms,
    FixedMasses,
    InertialParameters,
    InfeasibleError,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.comparison.constraint_prices import constraint_costs
from consistent_id.constraints import (
    CentreOfMassBoxes,
    FixedCentresOfMass,
    FixedParameters,
    Penalty,
    PointToSet,
)
from consistent_id.estimation.constrained_fit import _OTHER_SIZE, _of_torque_size
from consistent_id.regression import joint_noise
from consistent_id.robot.scaling import reference_bodies


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_without_noise_the_true_robot_is_recovered_where_the_data_speak(seed):
    model, truth, log = experiment(seed)
    estimate = constrained_least_squares(model, build_regression(model, log))
    assert estimate.certificate.verdict == "certified"
    assert np.allclose(
        estimate.predict(log), log.torque, atol=1e-4 * abs(log.torque).max()
    )
    base = estimate.base
    expected = base.projection @ truth
    assert np.allclose(estimate.base_values, expected, atol=1e-3 * abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(6), 3))
def test_every_link_is_a_body_and_every_mass_is_the_datasheets(seed):
    model, truth, log = experiment(20 + seed, noise=5.0, samples=200)
    regression = build_regression(model, log)
    sigma = joint_noise(model, regression)
    estimate = constrained_least_squares(model, regression.weighted(sigma))
    assert estimate.certificate.verdict == "certified"
    for k, body in enumerate(estimate.links):
        assert InertialParameters(body).is_consistent()
        assert body[0] == pytest.approx(truth[10 * k], rel=1e-7)
    assert (estimate.parameters[40:] > -1e-7).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    some_fast(range(30), 3),
)
def test_random_problems_of_all_kinds_are_certified(seed):
    rng = np.random.default_rng(1000 + seed)
    joints, samples = int(rng.integers(2, 10)), int(rng.choice([60, 300, 2000]))
    _, robot = random_robot(rng, joints, tree=bool(rng.integers(2)))
    drive = DriveTerms(
        viscous=bool(rng.integers(2)),
        coulomb="sign" if rng.integers(2) else "none",
        offset=bool(rng.integers(2)),
        rotor_inertia=bool(rng.integers(2)),
    )
    model = TorqueModel(robot, drive)
    amplitude, noise = 10.0 ** rng.uniform(-2.0, 0.0), 10.0 ** rng.uniform(-4.0, 0.3)
    states = [amplitude * x for x in random_states(rng, joints, samples)]
    log = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    extra = rng.uniform(0.1, 1.0, len(model.layout) - 10 * joints)
    exact = simulate_torque(model, [*robot.nominal, *extra], log)
    sigma = noise * exact.torque.std(axis=0) + 1e-9
    log = simulate_torque(model, [*robot.nominal, *extra], log, noise=sigma, rng=rng)
    regression = build_regression(model, log)
    weighted = regression.weighted(joint_noise(model, regression))
    estimate = constrained_least_squares(model, weighted)
    assert estimate.certificate.verdict == "certified", estimate.certificate.reason
    assert all(InertialParameters(body).is_consistent() for body in estimate.links)


def test_the_proof_reaches_ten_times_as_far_as_the_nominal_robot():
    model, _, log = experiment(0, noise=1.0, samples=200)
    found = constrained_least_squares(model, build_regression(model, log))
    assert found.certificate.verdict == "certified"
    said = found.certificate.reason
    reach = int(said.split("with parameters up to ")[1].split(" times the nominal")[0])
    assert 10 <= reach < 1000


@pytest.mark.slow
def test_the_optimum_is_no_worse_than_the_truth_and_no_better_than_least_squares():
    model, truth, log = experiment(30, noise=3.0, samples=300)
    regression = build_regression(model, log)
    tight = constrained_least_squares(model, regression, prior=PointToSet(slack=1e-5))
    free = least_squares(model, regression)

    def misfit(x):
        return np.linalg.norm(regression.residual_rms(x))

    assert misfit(free.parameters) <= misfit(tight.parameters) * (1 + 1e-9)
    assert misfit(tight.parameters) <= misfit(truth) * (1 + 2e-5)


def test_where_constraints_are_slack_it_is_least_squares():
    model, _, log = experiment(31, joints=2, noise=0.01, drive=DriveTerms())
    regression = build_regression(model, log)
    free = least_squares(model, regression)
    bodily = constrained_least_squares(
        model,
        regression,
        constraints=[PhysicalConsistency()],
        prior=PointToSet(slack=1e-6),
    )
    difference = abs(bodily.base_values - free.base_values)
    # A slack of 1e-6 in the misfit is 1.4e-3 of its norm in the parameters' own scale.
    assert (difference <= 0.2 * np.sqrt(len(free.base)) * free.standard_errors).all()


@pytest.mark.parametrize("distance", ["pullback", "euclidean"])
def test_what_the_data_leave_open_is_nominal(distance):
    model, truth, log = experiment(32, joints=3, drive=DriveTerms())
    prior = PointToSet(slack=1e-4, distance=distance)
    estimate = constrained_least_squares(
        model,
        build_regression(model, log),
        constraints=[PhysicalConsistency()],
        prior=prior,
    )
    # The truth is the nominal robot, so all of it is.
    size = np.maximum(abs(truth), 1.0)
    assert (abs(estimate.parameters - truth) <= 1e-3 * size).all()


def test_where_nothing_is_left_to_explain_a_prior_costs_no_fit():
    # Misfits here are far below a millionth of the torque, and so are their ratios.
    model, _, log = experiment(0, joints=3, samples=300)
    regression = build_regression(model, log)
    estimate = constrained_least_squares(model, regression, prior=Penalty(1.0))
    assert estimate.certificate.figures["slack"] == 0.0
    assert "0.00% above" in estimate.notes[0]


def test_constraints_hold_to_the_letter():
    model, truth, log = pendulum()
    regression = build_regression(model, log)
    estimate = constrained_least_squares(
        model,
        regression,
        constraints=[
            PhysicalConsistency(margin=1e-3),
            FixedMasses(),
            FixedCentresOfMass(),
            NonNegativeDrive(),
            FixedParameters({"joint1.viscous": 0.4}),
        ],
    )
    assert estimate["link1.m"] == pytest.approx(2.0, rel=1e-8)
    assert estimate["link1.hx"] == pytest.approx(0.6, rel=1e-8)
    assert estimate["joint1.viscous"] == pytest.approx(0.4, rel=1e-8)
    assert estimate["link1.Izz"] == pytest.approx(truth[9], rel=1e-4)


def test_bounds_and_boxes_hold():
    model, _, log = pendulum()
    heavier = simulate_torque(model, 2.0 * pendulum()[1], log)
    estimate = constrained_least_squares(
        model,
        build_regression(model, heavier),
        constraints=[PhysicalConsistency(), MassBounds(), CentreOfMassBoxes()],
    )
    mass, first = estimate["link1.m"], estimate.links[0][1:4]
    assert 1.0 - 1e-6 <= mass <= 3.0 + 1e-6
    assert (first >= -1e-6).all()
    assert (first <= 0.5 * mass + 1e-6).all()


def test_contradictory_constraints_are_refused_with_those_to_blame():
    model, _, log = pendulum()
    impossible = [
        PhysicalConsistency(),
        FixedMasses(),
        FixedParameters({"link1.Izz": 0.01, "link1.hx": 0.6}),
    ]
    with pytest.raises(InfeasibleError, match="physical consistency of link 'link1'"):
        constrained_least_squares(
            model, build_regression(model, log), constraints=impossible
        )


def test_equalities_that_contradict_each_other_are_named():
    model, _, log = pendulum()
    twice = [FixedMasses(), FixedMasses({"link1": 3.0})]
    with pytest.raises(InfeasibleError, match=r"link1\.m = 3 kg"):
        constrained_least_squares(
            model, build_regression(model, log), constraints=twice
        )


def test_unknown_links_and_parameters_are_named_with_near_ones():
    model, _, log = pendulum()
    regression = build_regression(model, log)
    with pytest.raises(ProblemError, match="no link named 'link2'; known: link1"):
        constrained_least_squares(
            model, regression, constraints=[FixedMasses({"link2": 1.0})]
        )
    with pytest.raises(ProblemError, match=r"no parameter named 'link1.mass'"):
        constrained_least_squares(
            model, regression, constraints=[FixedParameters({"link1.mass": 1.0})]
        )


def test_the_cost_of_a_constraint_is_the_misfit_that_vanishes_without_it():
    model, truth, log = pendulum()
    regression = build_regression(model, simulate_torque(model, 1.5 * truth, log))
    # The torque is that of a pendulum half as heavy again: only the mass holds it back.
    costs = constraint_costs(
        model,
        regression + build_regression(model, simulate_torque(model, truth, log)),
        [FixedMasses(), FixedCentresOfMass(), NonNegativeDrive()],
    )
    by_name = {cost.name: cost for cost in costs}
    assert all(cost.verdict == "certified" for cost in costs)
    # Two logs of 1 and 1.5 times the torque are best fitted by 1.25 times; with h = m c
    # held, only inertia and friction follow.  Freeing either frees h.
    Y = model.regressor(log.position, log.velocity, log.acceleration)[0].T
    kept, tau = [9, 10], Y @ truth
    target = np.concatenate([tau, 1.5 * tau])
    fixed = Y[:, :9] @ truth[:9]
    rows = np.vstack([Y, Y])
    rest = target - np.concatenate([fixed, fixed])
    held = rest - rows[:, kept] @ np.linalg.lstsq(rows[:, kept], rest, rcond=None)[0]
    free = target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]
    expected = np.linalg.norm(held) / np.linalg.norm(free) - 1.0
    assert by_name["FixedMasses"].increase == pytest.approx(expected, rel=1e-4)
    assert by_name["FixedCentresOfMass"].increase == pytest.approx(expected, rel=1e-4)
    assert by_name["NonNegativeDrive"].increase == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_torque_of_the_wrong_sign_leaves_an_optimum_that_is_proven(seed):
    """One standard error is then far less than what any solver can use up."""
    model, _, log = experiment(seed)
    wrong = replace(log, torque=-log.torque)
    estimate = constrained_least_squares(model, build_regression(model, wrong))
    assert estimate.certificate.verdict == "certified"
    assert estimate.certificate.figures["slack"] >= 4.9e-6


@pytest.mark.parametrize("unit", [1e-20, 1.0])
def test_torque_of_another_size_than_the_nominal_robots_is_said(unit):
    _, robot = random_robot(np.random.default_rng(0), 1)
    bodies = reference_bodies(robot).ravel()

    def said(times):
        R = unit * np.array([[*np.eye(10)[0], 0.0, times * bodies[0]]])
        free = SimpleNamespace(regression=SimpleNamespace(stacked=lambda: R))
        model = SimpleNamespace(robot=robot)
        return _of_torque_size(SimpleNamespace(free=free, model=model))

    assert said(1.0) == said(0.99 * _OTHER_SIZE) == said(1.01 / _OTHER_SIZE) == ""
    for times in (1.01 * _OTHER_SIZE, 0.99 / _OTHER_SIZE):
        assert f"is {times:.1e} times that of the nominal robot" in said(times)
