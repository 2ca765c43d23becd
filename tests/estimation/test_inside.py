"""Links stay off the boundary of consistency, as far as the data do not ask for it."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from some_fast import some_fast

from consistent_id import (
    FixedMasses,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    Recording,
    build_regression,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.constraints.delivered_bodies import link_conditions
from consistent_id.constraints.priors import Penalty, PointToSet
from consistent_id.estimation.best_fit import MOVE, FitProblem, best_fit, inner_fit
from consistent_id.regression import base_parameters
from consistent_id.robot.inertia import pseudo_inertia

BODIES = (PhysicalConsistency(), NonNegativeDrive())
OUTSIDE = (PointToSet(inside=0.0), Penalty(1e-6, inside=0.0))
DEFAULT = (PointToSet(), Penalty(1e-6))


def little_data(seed, joints=4):
    """Torque of small motion with much noise, and masses of the datasheet."""
    model, truth, log = experiment(seed, joints=joints, samples=300)
    motion = Recording(
        log.joints, log.time, 0.2 * log.position, 0.2 * log.velocity, log.acceleration
    )
    clean = simulate_torque(model, truth, motion)
    noise = 0.3 * clean.torque.std(axis=0)
    rng = np.random.default_rng(seed)
    torque = clean.torque + noise * rng.normal(size=clean.torque.shape)
    masses = dict(zip(model.layout.links, truth[: 10 * joints : 10], strict=True))
    bodies = (*BODIES, FixedMasses(masses))
    return model, build_regression(model, replace(clean, torque=torque)), bodies


def edges(model, parameters):
    return [link for link in link_conditions(model, parameters) if link.edge]


def shares(model, parameters):
    """Least eigenvalue of each link's pseudo-inertia, whitened by the nominal one."""
    found = []
    links = parameters[: model.layout.inertial_size].reshape(-1, 10)
    for link, nominal in zip(links, model.robot.nominal.reshape(-1, 10), strict=True):
        root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(nominal)))
        found.append(np.linalg.eigvalsh(root @ pseudo_inertia(link) @ root.T)[0])
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast([6, 2, 3, 5]))
@pytest.mark.parametrize("kind", some_fast([1, 0]))
def test_links_of_little_data_stay_inside_at_next_to_no_cost(seed, kind):
    model, regression, bodies = little_data(seed)
    outside, inside = (
        constrained_least_squares(model, regression, constraints=bodies, prior=prior)
        for prior in (OUTSIDE[kind], DEFAULT[kind])
    )
    assert edges(model, outside.parameters)
    assert not edges(model, inside.parameters)
    assert inside.certificate.verdict == "certified"
    assert "of its nominal body" in inside.notes[0]
    assert inside.fit.misfit <= 1.001 * outside.fit.misfit


@pytest.mark.parametrize("seed", [2, 3, 5, 6])
def test_the_share_moves_what_data_determine_by_a_part_of_a_standard_error(seed):
    model, regression, bodies = little_data(seed)
    base = base_parameters(model)
    best = best_fit(model, regression, bodies, base=base)
    problem = FitProblem.of(model, regression, bodies, base)
    found = inner_fit(problem, best, share=0.1)
    assert 0.0 < found.share <= 0.1
    assert (shares(model, found.best.parameters) >= found.share - 1e-6).all()
    moved = base.projection @ (found.best.parameters - best.parameters)
    noise = problem.free.noise
    covariance = noise.steps @ noise.inflation @ noise.steps.T
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), moved)
    assert np.linalg.norm(whitened) == pytest.approx(found.move, rel=1e-2, abs=1e-4)
    # A bias of this size and the standard error are together 4 % larger at most.
    assert np.hypot(1.0, found.move) <= 1.04
    assert np.hypot(1.0, MOVE) <= 1.04


def test_a_link_that_the_data_show_to_be_thin_stays_thin():
    model, truth, log = experiment(1, joints=2, samples=2000)
    # All of a nominal link's second moment along one axis but a hundredth is gone.
    J = pseudo_inertia(model.robot.nominal[-10:])
    values, vectors = np.linalg.eigh(J[:3, :3] - np.outer(J[:3, 3], J[3, :3]) / J[3, 3])
    J[:3, :3] -= 0.99 * values[0] * np.outer(vectors[:, 0], vectors[:, 0])
    thin = truth.copy()
    thin[10:20] = [
        J[3, 3],
        *J[:3, 3],
        J[1, 1] + J[2, 2],
        -J[0, 1],
        J[0, 0] + J[2, 2],
        -J[0, 2],
        -J[1, 2],
        J[0, 0] + J[1, 1],
    ]
    assert shares(model, thin)[1] < 0.05
    noise = 1e-4 * log.torque.std(axis=0)
    seen = simulate_torque(model, thin, log, noise=noise, rng=np.random.default_rng(0))
    base = base_parameters(model)
    regression = build_regression(model, seen)
    estimate = constrained_least_squares(
        model, regression, constraints=BODIES, base=base
    )
    errors = least_squares(model, regression, base=base).standard_errors
    away = abs(base.projection @ (estimate.parameters - thin)) / errors
    assert away.max() <= 5.0


@pytest.mark.parametrize(
    ("seed", "joints"), [(2, 2), pytest.param(0, 4, marks=pytest.mark.slow)]
)
def test_a_share_that_masses_do_not_allow_is_reduced(seed, joints):
    model, regression, _ = little_data(seed, joints)
    light = {
        link: (0.0, 0.03 * mass)
        for link, mass in zip(
            model.layout.links, model.robot.nominal[::10], strict=True
        )
    }
    bodies = (PhysicalConsistency(), MassBounds(light))
    estimate = constrained_least_squares(model, regression, constraints=bodies)
    assert 0.0 < shares(model, estimate.parameters).min() < 0.03
    assert "contains at least 0.01 of its nominal body" in estimate.notes[0]


@pytest.mark.slow
def test_none_is_asked_for_without_physical_consistency():
    model, regression, _ = little_data(0)
    only = (NonNegativeDrive(),)
    first, again = (
        constrained_least_squares(model, regression, constraints=only, prior=prior)
        for prior in (DEFAULT[0], OUTSIDE[0])
    )
    assert np.array_equal(first.parameters, again.parameters)


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_a_share_is_a_number_below_one(share):
    with pytest.raises(ProblemError, match="from 0 to less than 1"):
        PointToSet(inside=share)
    with pytest.raises(ProblemError, match="from 0 to less than 1"):
        Penalty(0.1, inside=share)
    with pytest.raises(ProblemError, match="from 0 to less than 1"):
        PhysicalConsistency(share=share)
