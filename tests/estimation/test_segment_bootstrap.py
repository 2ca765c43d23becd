"""The bootstrap: reproducible, honest about failures, and right about white noise."""

from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment
from scipy.stats import norm, sem, t

from consistent_id import InertialParameters, ProblemError, SolverError, simulate_torque
from consistent_id.constraints.priors import Penalty
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
    constrained_fit,
)
from consistent_id.estimation.cross_validation import cross_validated
from consistent_id.estimation.uncertainties import (
    parameter_scatter,
    resampling,
)
from consistent_id.estimation.uncertainties.parameter_scatter import (
    covariance,
    segment_scores,
    white_scores,
)
from consistent_id.estimation.uncertainties.resampling import bootstrap
from consistent_id.regression import joint_noise
from consistent_id.regression import segments as segment_rows
from consistent_id.regression.base import base_parameters
from consistent_id.regression.segments import merged, segment_regressions

PRIOR = Penalty(0.1)

HERE = "consistent_id.estimation.uncertainties.resampling"


@lru_cache
def simulated(seed=0, count=24, noise=0.1):
    model, truth, exact = experiment(seed, joints=2, samples=1200)
    sigma = noise * exact.torque.std(axis=0)
    rng = np.random.default_rng(seed)
    log = simulate_torque(model, truth, exact, noise=sigma, rng=rng)
    segments = segment_regressions(model, log, count=count)
    weights = joint_noise(model, merged(segments))
    return model, tuple(s.weighted(weights) for s in segments), sigma


@pytest.mark.parametrize("count", [3, 8, 40])
def test_an_expanded_tail_of_the_bootstrapped_mean_is_students(count):
    # Means of drawn samples scatter by the standard deviation over n, not n - 1.
    sample = np.random.default_rng(count).normal(size=count)
    _, high = t.interval(0.95, count - 1, loc=sample.mean(), scale=sem(sample))
    tail = resampling._expanded(0.025, count)
    scatter = sample.std(ddof=0) / np.sqrt(count)
    assert norm.isf(tail, sample.mean(), scatter) == pytest.approx(high)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_result():
    model, segments, _ = simulated()
    first = bootstrap(model, segments, replicates=20, seed=3)
    again = bootstrap(model, segments, replicates=20, seed=3)
    assert np.array_equal(again.estimates, first.estimates)
    other = bootstrap(model, segments, replicates=20, seed=4)
    assert not np.allclose(other.estimates, first.estimates)


@pytest.mark.slow
def test_what_is_zero_but_for_rounding_is_zero(monkeypatch):
    model, segments, _ = simulated()
    solve = resampling.penalised_fits

    def rounded(*args, **options):
        found = solve(*args, **options)
        for fit in found:
            fit.solution.u[0] = 1e-13
        return found

    monkeypatch.setattr(resampling, "penalised_fits", rounded)
    assert (bootstrap(model, segments, replicates=5).estimates[:, 0] == 0.0).all()


@pytest.mark.slow
def test_replicates_and_folds_are_the_same_in_other_processes():
    model, segments, _ = simulated()
    here = bootstrap(model, segments, replicates=25, seed=3)
    there = bootstrap(model, segments, replicates=25, seed=3, executor="processes:2")
    assert np.array_equal(there.estimates, here.estimates)
    path = cross_validated(model, segments, weights=[1e-2, 1.0], folds=3)
    again = cross_validated(
        model, segments, weights=[1e-2, 1.0], folds=3, executor="processes:2"
    )
    assert np.array_equal(again.errors, path.errors)
    assert np.array_equal(again.parameters, path.parameters)


def test_two_replicates_are_enough_and_their_scatter_is_their_difference():
    model, segments, _ = simulated()
    found = bootstrap(model, segments, replicates=2, seed=3)
    difference = abs(found.estimates[0] - found.estimates[1])
    assert found.standard_deviation == pytest.approx(difference / np.sqrt(2.0))
    low, high = replace(found, segments=0).interval(0.5).T
    # Quartiles of two values lie a quarter of the way in from each.
    assert high - low == pytest.approx(difference / 2.0)


@pytest.mark.slow
def test_intervals_from_few_segments_hold_the_truth_as_often_as_they_say():
    """Means of k normal numbers: percentiles are too narrow, expanded ones are not."""
    model, segments, _ = simulated()
    rng, found = np.random.default_rng(0), bootstrap(model, segments, replicates=2)
    sets, k = len(model.layout), 6
    inside = {0: [], k: []}
    for _ in range(40):
        numbers = rng.normal(size=(sets, k))
        drawn = rng.integers(k, size=(2000, k))
        means = np.array([row[drawn].mean(axis=1) for row in numbers]).T
        for count, hits in inside.items():
            made = replace(found, estimates=means, segments=count)
            low, high = made.interval().T
            hits.append(np.mean((low <= 0.0) & (high >= 0.0)))
    # Of 1040 intervals of 95 % the share scatters by 0.7 %.
    assert np.mean(inside[0]) < 0.91
    assert 0.925 < np.mean(inside[k]) < 0.97


def test_segments_that_are_all_alike_give_no_scatter():
    model, segments, _ = simulated()
    alike = bootstrap(model, [segments[0]] * 5, prior=PRIOR, replicates=10)
    assert alike.certified == 10
    assert alike.standard_deviation == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("distance", ["pullback", "entropic"])
def test_every_replicate_satisfies_the_constraints(distance):
    model, segments, _ = simulated(1, noise=0.5)
    found = bootstrap(model, segments, prior=Penalty(0.1, distance), replicates=20)
    assert (found.certified, found.failed) == (20, 0)
    masses = [link.datasheet.mass for link in model.robot.links]
    for x in found.estimates:
        for k, body in enumerate(x[:20].reshape(-1, 10)):
            assert InertialParameters(body).is_consistent()
            assert masses[k] is None or body[0] == pytest.approx(masses[k])
        assert (x[20:] >= 0.0).all()


@pytest.mark.slow
def test_its_scatter_is_the_covariance_from_segments_and_that_of_white_noise():
    model, segments, sigma = simulated(2, count=80, noise=0.02)
    found = bootstrap(model, segments, prior=PRIOR, replicates=300)
    base, whole = base_parameters(model), merged(segments)
    problem = FitProblem.of(model, whole, DEFAULT_CONSTRAINTS, base)
    fitted = constrained_fit(problem, PRIOR)
    predicted = [
        np.sqrt(np.diag(covariance(fitted, scores)))
        for scores in (
            segment_scores(fitted, segments, base),
            white_scores(fitted, whole, base, sigma),
        )
    ]
    moves = predicted[1] > 1e-4 * fitted.best.scaled.unit
    assert moves.sum() >= 12
    # Standard deviations are good to 4 % (300 replicates), and 8 % (80 segments).
    got = found.standard_deviation[moves]
    assert got == pytest.approx(predicted[0][moves], rel=0.2)
    assert got == pytest.approx(predicted[1][moves], rel=0.35)
    low, high = found.interval(0.9)[moves].T
    assert (high - low) / 2 == pytest.approx(1.645 * got, rel=0.2)


def failing(monkeypatch, *, fails=frozenset(), interrupted=-1):
    """Let fits of draws with these numbers fail, or interrupt the ones with a number.

    Draws are fitted together, `_AT_ONCE` of them.
    """
    solve, calls = resampling.penalised_fits, iter(range(10**6))
    at_once = resampling._AT_ONCE

    def sometimes(*args, **options):
        call = next(calls)
        if call == interrupted:
            raise KeyboardInterrupt
        found = enumerate(solve(*args, **options), start=call * at_once)
        return [None if number in fails else fit for number, fit in found]

    monkeypatch.setattr(f"{HERE}.penalised_fits", sometimes)


def test_an_interruption_keeps_the_replicates_so_far(monkeypatch):
    model, segments, _ = simulated()
    monkeypatch.setattr(f"{HERE}._AT_ONCE", 3)
    whole = bootstrap(model, segments, prior=PRIOR, replicates=20)
    with monkeypatch.context() as patch:
        failing(patch, interrupted=2)
        part = bootstrap(model, segments, prior=PRIOR, replicates=20)
    assert np.array_equal(part.estimates, whole.estimates[:6])
    failing(monkeypatch, interrupted=0)
    with pytest.raises(KeyboardInterrupt):
        bootstrap(model, segments, prior=PRIOR, replicates=20)


def test_replicates_without_an_estimate_are_counted(monkeypatch):
    model, segments, _ = simulated()
    whole = bootstrap(model, segments, prior=PRIOR, replicates=20)
    with monkeypatch.context() as patch:
        failing(patch, fails={2, 15})
        part = bootstrap(model, segments, prior=PRIOR, replicates=20)
    assert (part.failed, len(part.estimates)) == (2, 18)
    assert np.array_equal(part.estimates, np.delete(whole.estimates, [2, 15], axis=0))
    failing(monkeypatch, fails=set(range(9)))
    with pytest.raises(SolverError, match="1 of 10 replicates"):
        bootstrap(model, segments, prior=PRIOR, replicates=10)


def test_what_cannot_be_resampled_is_refused():
    model, segments, _ = simulated()
    with pytest.raises(ProblemError, match="1 segments"):
        bootstrap(model, segments[:1])
    with pytest.raises(ProblemError, match="1 replicates"):
        bootstrap(model, segments, replicates=1)
    found = bootstrap(model, segments, replicates=2)
    for level in (0.0, 1.0, 95.0):
        with pytest.raises(ProblemError, match="level"):
            found.interval(level)


def test_scores_scatter_about_the_mean_of_their_own_recording(monkeypatch):
    """One segment of a recording has no scatter; two have twice their squares."""
    rng = np.random.default_rng(0)
    parts, u = [rng.normal(size=(4, 3)) for _ in range(6)], rng.normal(size=2)
    scaled = SimpleNamespace(
        with_factor=lambda R: SimpleNamespace(M=R[:, :2], z=R[:, 2])
    )
    fitted = SimpleNamespace(
        best=SimpleNamespace(scaled=scaled),
        final=SimpleNamespace(solution=SimpleNamespace(u=u)),
    )
    monkeypatch.setattr(parameter_scatter, "base_factor", lambda part, base: part)
    g = np.array([R[:, :2].T @ (R[:, :2] @ u - R[:, 2]) for R in parts])
    found = segment_scores(fitted, parts, None, sources=[0, 0, 1, 2, 2, 2])
    two, three = 2.0 * np.cov(g[:2].T), 3.0 * np.cov(g[3:].T)
    np.testing.assert_allclose(found.T @ found, two + three)
    np.testing.assert_allclose(found[2], 0.0)
    every = segment_scores(fitted, parts, None)
    np.testing.assert_allclose(every.T @ every, 6.0 * np.cov(g.T))


def test_active_constraints_make_no_error_larger(monkeypatch):
    squares = {True: [4.0, 1.0, 3.0, 0.0, 0.0], False: [1.0, 4.0, 0.0, 2.0, 0.0]}
    monkeypatch.setattr(parameter_scatter, "noise_scores", lambda fitted, noise: None)
    monkeypatch.setattr(
        parameter_scatter,
        "covariance",
        lambda fitted, scores, active: np.diag(squares[active]),
    )
    ratios = parameter_scatter.active_ratios(None, None)
    np.testing.assert_allclose(ratios, [1.0, 0.5, 1.0, 0.0, 1.0])


@pytest.mark.parametrize(("length", "left"), [(2.4, 2), (2.401, 6)])
def test_segments_are_joined_to_ten_correlation_lengths(monkeypatch, length, left):
    """Where at least two remain; each joint has a length of its own."""
    monkeypatch.setattr(
        segment_rows,
        "merged",
        lambda parts: np.sum([part.counts for part in parts], axis=0).tolist(),
    )
    parts = [SimpleNamespace(counts=(50, 8))] * 6
    noise = SimpleNamespace(length=np.array([5.0, length]))
    found = parameter_scatter.Segments(parts, (0,) * 6).long_enough(noise)
    assert found.regressions == (([150, 24],) * 2 if left == 2 else parts)
    assert len(found.sources) == left
