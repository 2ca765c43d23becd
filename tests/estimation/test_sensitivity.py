"""How estimates follow data: a known derivative, finite differences, Monte-Carlo."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment
from some_fast import some_fast

from consistent_id import (
    DriveTerms,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    build_regression,
    simulate_torque,
)
from consistent_id.constraints.cones.least_norm import LeastNorm, solve_least_norm
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock, smat, svec
from consistent_id.constraints.priors import Penalty, QuadraticDistance
from consistent_id.estimation.best_fit import FitProblem, base_factor
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
    constrained_fit,
)
from consistent_id.estimation.penalised import penalised_fit
from consistent_id.estimation.uncertainties.parameter_scatter import (
    _ACTIVE,
    _response_root,
    covariance,
    segment_scores,
    white_scores,
)
from consistent_id.regression.base import base_parameters
from consistent_id.regression.segments import segment_regressions


def prepared(seed, noise, prior, constraints=DEFAULT_CONSTRAINTS, **options):
    """A fitted estimate of simulated data, noise relative to the torque."""
    model, truth, exact = experiment(seed, **options)
    sigma = noise * exact.torque.std(axis=0)
    rng = np.random.default_rng(seed)
    log = simulate_torque(model, truth, exact, noise=sigma, rng=rng)
    regression = build_regression(model, log).weighted(sigma)
    base = base_parameters(model)
    fitted = constrained_fit(FitProblem.of(model, regression, constraints, base), prior)
    return SimpleNamespace(**locals())


def white_covariance(p):
    scores = white_scores(p.fitted, p.regression, p.base, p.sigma)
    return covariance(p.fitted, scores)


@pytest.mark.parametrize("eigenvalues", [(3, 2, 1, 1), (3, 2, 1, -1), (3, 1, -1, -2)])
def test_the_nearest_semidefinite_matrix_follows_by_its_known_derivative(eigenvalues):
    # dX = Q (Omega * Q^T dA Q) Q^T with Omega_ij the divided differences of max(l, 0).
    rng = np.random.default_rng(0)
    Q, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    values = np.array(eigenvalues, dtype=float)
    A = Q @ np.diag(values) @ Q.T
    basis = np.array([smat(e) for e in np.eye(10)])
    block = SemidefiniteBlock("X", basis, np.zeros((4, 4)), np.ones(4))
    domain = ConicSet.semidefinite([block], 10)
    solution = solve_least_norm(LeastNorm(np.eye(10), svec(A), domain))
    fitted = SimpleNamespace(
        best=SimpleNamespace(scaled=SimpleNamespace(M=np.eye(10), domain=domain)),
        distance=QuadraticDistance(np.eye(10), np.zeros(10), np.zeros(10)),
        final=SimpleNamespace(solution=solution, weight=0.0),
    )
    B = _response_root(fitted)
    upper = np.maximum(values, 0.0)
    gaps = np.subtract.outer(values, values)
    same = abs(gaps) < 1e-12
    rises = np.where(same, 1.0, gaps)
    omega = np.where(same, values > 0, np.subtract.outer(upper, upper) / rises)
    dA = np.array([Q @ (omega * (Q.T @ E @ Q)) @ Q.T for E in basis])
    assert pytest.approx(svec(dA), abs=1e-6) == B @ B.T


@pytest.mark.slow
@pytest.mark.parametrize("distance", ["pullback", "entropic"])
@pytest.mark.parametrize("seed", some_fast([2, 5, 8]))  # nothing there is barely active
def test_the_response_is_the_derivative_of_the_optimum_on_active_constraints(
    seed, distance
):
    # A wide margin makes blocks active, which the entropic distance else prevents.
    thick = (PhysicalConsistency(margin=0.1), FixedMasses(), NonNegativeDrive())
    p = prepared(seed, 0.3, Penalty(0.1, distance), thick, joints=3, samples=60)
    scaled, fit, u = p.fitted.best.scaled, p.fitted.final, p.fitted.final.solution.u
    domain = scaled.domain
    blocks = [np.linalg.eigvalsh(block.value(u))[0] for block in domain.blocks]
    assert min(blocks) <= _ACTIVE
    assert (domain.b_in - domain.A_in @ u).min() <= _ACTIVE
    dz = p.rng.normal(size=len(scaled.z))
    dz *= 1e-2 / np.linalg.norm(dz)
    ahead, behind = (
        penalised_fit(replace(scaled, z=z), p.fitted.distance, fit.weight, start=u)
        for z in (scaled.z + dz, scaled.z - dz)
    )
    expected = (ahead.solution.u - behind.solution.u) / 2
    B = _response_root(p.fitted)
    got = B @ (B.T @ (scaled.M.T @ dz))
    # Solutions are good to 1e-5 of typical parameters, steps are some 1e-2.
    assert np.linalg.norm(got - expected) <= 5e-3 * np.linalg.norm(expected)


def test_without_active_constraints_it_is_the_covariance_of_least_squares():
    p = prepared(1, 0.05, Penalty(1e-6), (), joints=3, drive=DriveTerms(viscous=True))
    R = p.regression.stacked()[:, list(p.base.independent)]
    expected = np.linalg.inv(R.T @ R)  # rows are divided by sigma
    P = p.base.projection
    size = np.sqrt(np.diag(expected))
    difference = P @ white_covariance(p) @ P.T - expected
    assert (abs(difference) <= 1e-3 * np.outer(size, size)).all()


@pytest.mark.parametrize("weight", [1e-6, 1e-2, 1.0])
def test_however_faint_the_prior_what_it_settles_follows_what_the_data_do(weight):
    # Along what torque cannot tell, the distance's gradient is zero for any data.
    p = prepared(3, 0.01, Penalty(weight), (), joints=3, drive=DriveTerms())
    scaled = p.fitted.best.scaled
    unseen = np.linalg.svd(scaled.projection)[2][len(p.base) :]
    G = p.fitted.distance.local(p.fitted.final.solution.u).G / scaled.unit
    C = white_covariance(p)
    gradient = unseen @ (G * scaled.unit).T @ G
    assert abs(gradient @ C @ gradient.T).max() <= 1e-9 * abs(G @ C @ G.T).max()


@pytest.mark.slow
def test_the_covariance_is_that_of_estimates_under_white_noise():
    model, truth, motion = experiment(5, joints=2, samples=100)
    truth[-2:] = -0.5  # rotors that feed: their bounds are active, whatever the noise
    exact = simulate_torque(model, truth, motion)
    sigma, base = 0.02 * exact.torque.std(axis=0), base_parameters(model)
    rng = np.random.default_rng(5)

    def drawn(noise):
        log = simulate_torque(model, truth, exact, noise=noise, rng=rng)
        return build_regression(model, log).weighted(sigma)

    fitted = constrained_fit(
        FitProblem.of(model, drawn(sigma), DEFAULT_CONSTRAINTS, base), Penalty(0.1)
    )

    def estimate(noise):
        scaled = fitted.best.scaled.with_factor(base_factor(drawn(noise), base))
        fit = penalised_fit(scaled, fitted.distance, fitted.final.weight)
        return replace(fitted, final=fit, best=replace(fitted.best, scaled=scaled))

    true = estimate(0.0 * sigma)
    scores = white_scores(true, drawn(sigma), base, sigma)
    got = np.sqrt(np.diag(covariance(true, scores)))
    expected = np.std([estimate(sigma).parameters for _ in range(300)], axis=0)
    assert got[[0, 10, -2, -1]] == pytest.approx(0.0, abs=1e-9)
    moves = got > 1e-4 * true.best.scaled.unit
    assert moves.sum() >= 12
    # A standard deviation of 300 is good to 4 %.
    assert got[moves] == pytest.approx(expected[moves], rel=0.17)


def test_what_is_fixed_does_not_move():
    p = prepared(6, 0.1, Penalty(0.1), joints=2)
    C = white_covariance(p)
    assert C[[0, 10], [0, 10]] == pytest.approx(0.0, abs=1e-20)


@pytest.mark.slow
def test_scores_of_segments_scatter_like_white_noise_if_that_is_what_it_is():
    p = prepared(7, 0.1, Penalty(0.1), joints=2, samples=2000)
    segments = segment_regressions(p.model, p.log, count=100)
    weighted = [segment.weighted(p.sigma) for segment in segments]
    scatter = covariance(p.fitted, segment_scores(p.fitted, weighted, p.base))
    white = white_covariance(p)
    ratio = np.sqrt(np.diag(scatter) / np.where(np.diag(white) > 0, np.diag(white), 1))
    moves = np.sqrt(np.diag(white)) > 1e-6 * p.fitted.best.scaled.unit
    # Standard deviations from 100 segments are good to 7 %.
    assert ratio[moves] == pytest.approx(1.0, abs=0.3)


def test_equal_segments_do_not_scatter_and_one_is_too_few():
    p = prepared(8, 0.1, Penalty(0.1), joints=2)
    scores = segment_scores(p.fitted, [p.regression] * 3, p.base)
    assert scores == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(ProblemError, match="1 segments"):
        segment_scores(p.fitted, [p.regression], p.base)


def test_scores_of_segments_are_their_gradients_about_the_mean_with_a_degree_lost():
    p = prepared(9, 0.1, Penalty(0.1), joints=2)
    segments = [
        segment.weighted(p.sigma)
        for segment in segment_regressions(p.model, p.log, count=3)
    ]
    scaled, x = p.fitted.best.scaled, p.fitted.parameters
    gradients = []
    for segment in segments:
        R = segment.stacked()
        slope = R[:, :-1].T @ (R[:, :-1] @ x - R[:, -1])
        gradients.append(slope * scaled.unit / scaled.size**2)
    scores = segment_scores(p.fitted, segments, p.base)
    # The covariance of a sum of three draws, from their own unbiased variance.
    expected = 3.0 * np.cov(np.transpose(gradients), ddof=1)
    size = abs(expected).max()
    assert np.allclose(scores.T @ scores, expected, rtol=0, atol=1e-8 * size)
