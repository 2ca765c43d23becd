"""The noise of residuals: coverage of errors, and the prior's standard error."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.special import stdtrit

from consistent_id import (
    PhysicalConsistency,
    ProblemError,
    Recording,
    build_regression,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.estimation import weighted_least_squares
from consistent_id.estimation.best_fit import best_fit
from consistent_id.regression import base_parameters
from consistent_id.regression.residual_noise import (
    _EXACT,
    ResidualNoise,
    Scatter,
    _steps,
    joint_noise,
    unconstrained_fit,
)


def slow_motion(joints, duration, rng):
    """Sums of sines of up to half a hertz, at 100 Hz, with exact derivatives."""
    time = np.arange(round(100 * duration)) / 100
    rates = 2 * np.pi * np.arange(1, 6) / 10
    amplitudes = rng.normal(size=(joints, 5)) / np.arange(1, 6)
    angles = np.outer(time, rates)[None] + rng.uniform(0, 6, (joints, 1, 5))
    state = (np.sin(angles), rates * np.cos(angles), -(rates**2) * np.sin(angles))
    return time, *(np.einsum("jtk,jk->tj", part, amplitudes) for part in state)


def noise_like(kind, rng, shape):
    white = rng.normal(size=(shape[0] + 400, *shape[1:]))
    if kind == "white":
        return white[400:]
    if kind == "AR(1)":
        return signal.lfilter([np.sqrt(0.19)], [1, -0.9], white, axis=0)[400:]
    found = signal.filtfilt(*signal.butter(4, 0.1), white, axis=0)[200:-200]
    return found / found.std()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", "AR(1)", "low-passed"])
def test_95_per_cent_of_intervals_hold_the_truth(kind):
    rng = np.random.default_rng(1)
    model, truth, log = experiment(2, joints=3, samples=10)
    motion = Recording(log.joints, *slow_motion(3, 30.0, rng))
    clean = simulate_torque(model, truth, motion)
    base = base_parameters(model)
    size = 0.05 * clean.torque.std(axis=0)
    inside = []
    for _ in range(200):
        shaken = clean.torque + size * noise_like(kind, rng, clean.torque.shape)
        regression = build_regression(model, replace(clean, torque=shaken))
        found = weighted_least_squares(model, regression, base=base)
        error = abs(found.base_values - base.projection @ truth)
        inside.append(error <= 1.96 * found.standard_errors)
    # Errors of one data set hang together: 200 sets tell the share to about 1 %.
    assert np.mean(inside) == pytest.approx(0.95, abs=0.025)


def test_the_covariance_is_the_one_least_squares_states():
    model, _, log = experiment(3, joints=2, noise=[2.0, 0.1], samples=300)
    base = base_parameters(model)
    regression = build_regression(model, log).weighted([0.5, 1.0])
    noise = unconstrained_fit(regression, base).noise
    covariance = noise.steps @ noise.inflation @ noise.steps.T
    stated = least_squares(model, regression, base=base).base_covariance
    assert np.allclose(covariance, stated, rtol=1e-6)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("small", [0.0, 1e-14])
def test_steps_have_unit_effects_where_a_column_is_none(small, size):
    rng = np.random.default_rng(0)
    A = size * rng.normal(size=(30, 4)) * [1.0, 300.0, 1.0, small]
    A[:, 2] = A[:, 0] - 1e-3 * A[:, 1]
    steps = _steps(A, None)  # the solution's own have no column to leave out
    assert steps.shape == (4, 2) and not steps[3].any()
    np.testing.assert_allclose(steps.T @ A.T @ A @ steps, np.eye(2), atol=1e-9)


def test_under_right_weights_and_white_noise_next_to_nothing_is_inflated():
    model, _, log = experiment(3, joints=2, noise=1.0, samples=2000)
    base = base_parameters(model)
    noise = unconstrained_fit(build_regression(model, log), base).noise
    level = build_regression(model, log).weighted(noise.level)
    again = unconstrained_fit(level, base).noise
    assert np.allclose(again.inflation, np.eye(len(base)), atol=0.25)
    assert again.one_error == pytest.approx(1.0, abs=0.25)
    functionals = base.lift(np.eye(len(base)))
    assert again.squared_misfit(functionals) == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 1000),
    share=st.floats(0.01, 1.0),
    weights=st.tuples(*[st.floats(0.3, 3.0)] * 2),
)
def test_the_prior_moves_what_data_determine_by_one_standard_error_in_all(
    seed, share, weights
):
    model, _, clean = experiment(seed, joints=2, samples=300)
    rng = np.random.default_rng(seed)
    noise = share * clean.torque.std(axis=0) * noise_like("AR(1)", rng, (300, 2))
    log = replace(clean, torque=clean.torque + noise)
    base = base_parameters(model)
    regression = build_regression(model, log)
    sigma = np.array(weights) * share * clean.torque.std(axis=0)
    regression = regression.weighted(sigma)
    bodies = [PhysicalConsistency()]
    estimate = constrained_least_squares(
        model, regression, constraints=bodies, base=base
    )
    best = best_fit(model, regression, bodies, base=base)
    moved = estimate.base_values - base.projection @ best.parameters
    covariance = least_squares(model, regression, base=base).base_covariance
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), moved)
    # Beyond the best fit's own gap, of a thousandth of the misfit's square at most.
    assert whitened @ whitened <= 1.05


def test_what_standard_errors_rest_on_is_said():
    model, _, log = experiment(5, joints=2, samples=3000)
    base = base_parameters(model)
    rng = np.random.default_rng(0)
    size = 0.1 * log.torque.std(axis=0)

    def said(kind):
        noisy = log.torque + size * noise_like(kind, rng, log.torque.shape)
        regression = build_regression(model, replace(log, torque=noisy))
        return regression, least_squares(model, regression, base=base).notes[0]

    regression, white = said("white")
    assert "white" in white
    assert "times those of white noise" in said("AR(1)")[1]
    bare = replace(regression, noise=None)
    assert "no residuals were at hand" in least_squares(model, bare).notes[0]


def test_few_effective_samples_are_said():
    rng = np.random.default_rng(1)
    model, truth, log = experiment(2, joints=3, samples=10)
    motion = Recording(log.joints, *slow_motion(3, 0.9, rng))
    clean = simulate_torque(model, truth, motion)
    noise = noise_like("low-passed", rng, clean.torque.shape)
    noisy = replace(clean, torque=clean.torque + noise)
    regression = build_regression(model, noisy)
    found = unconstrained_fit(regression, base_parameters(model)).noise
    assert "errors are rough" in found.sentence


@pytest.mark.parametrize(("noise", "between"), [(1.0, 1.0), (4.0, 1.0), (1.0, 9.0)])
def test_degrees_of_freedom_of_two_variances_are_those_of_satterthwaite(noise, between):
    one = np.eye(1)
    found = ResidualNoise(
        sigma=np.ones(1),
        length=np.ones(1),
        effective=41.0,
        measured=True,
        steps=one,
        inflation=noise * one,
        root=np.sqrt(noise) * one,
        level_freedom=np.array([9.0]),
        of_joints=(np.sqrt(noise) * one,),
        between=(Scatter(between * one, 5.0),),
    )
    # (a + b)^2 / (a^2 / 9 + b^2 / 5), of any functional of the one parameter.
    expected = (noise + between) ** 2 / (noise**2 / 9.0 + between**2 / 5.0)
    freedoms = found.freedoms(np.array([[1.0], [-3.0], [0.0]]))
    assert freedoms == pytest.approx([expected, expected, 9.0])
    assert replace(found, between=()).freedoms(one) == pytest.approx([9.0])


def test_degrees_of_freedom_of_two_joints_count_by_their_shares_of_the_variance():
    one = np.eye(2)
    found = ResidualNoise(
        sigma=np.ones(2),
        length=np.ones(2),
        effective=100.0,
        measured=True,
        steps=one,
        inflation=np.diag([4.0, 10.0]),
        root=np.diag(np.sqrt([4.0, 10.0])),
        level_freedom=np.array([9.0, 3.0]),
        of_joints=(np.diag([2.0, 1.0]), np.diag([0.0, 3.0])),
    )
    # The first parameter has the noise of one joint, the second 1 and 9 parts of both.
    assert found.freedoms(one) == pytest.approx([9.0, 100.0 / (1.0 / 9.0 + 81.0 / 3.0)])


@pytest.mark.slow
def test_few_effective_samples_widen_intervals_by_students_quantile():
    rng = np.random.default_rng(0)
    model, truth, log = experiment(2, joints=3, samples=10)
    clean = simulate_torque(
        model, truth, Recording(log.joints, *slow_motion(3, 10.0, rng))
    )
    base, size = base_parameters(model), 0.05 * clean.torque.std(axis=0)
    normal, student = [], []
    for _ in range(120):
        white = rng.normal(size=(len(clean) + 600, 3))
        slow = signal.lfilter([np.sqrt(1.0 - 0.98**2)], [1.0, -0.98], white, axis=0)
        noisy = replace(clean, torque=clean.torque + size * slow[600:])
        regression = build_regression(model, noisy)
        estimate = weighted_least_squares(model, regression, base=base)
        noise = unconstrained_fit(regression.weighted(estimate.sigma), base).noise
        z = estimate.base_values - base.projection @ truth
        z = abs(z) / estimate.standard_errors
        normal.append(np.mean(z <= 1.96))
        student.append(np.mean(z <= stdtrit(noise.freedoms(np.eye(len(base))), 0.975)))
    # 93 to 97 %; the mean over 120 sets is uncertain by 0.8 %.
    assert np.mean(student) > np.mean(normal) + 0.007
    assert 0.93 < np.mean(student) < 0.97 + 0.008


def noise_of(**changes):
    """Noise of two joints, of which the second tells nothing of one parameter."""
    one = np.eye(1)
    values = {
        "sigma": np.ones(2),
        "length": np.ones(2),
        "effective": 90.0,
        "measured": True,
        "steps": one,
        "inflation": one,
        "root": one,
        "level_freedom": np.full(2, 1e6),
        "of_joints": (one, 0.0 * one),
    }
    return ResidualNoise(**values | changes)


@pytest.mark.parametrize(
    ("changes", "words", "absent"),
    [
        ({}, ["residuals are white"], ["again", "interval"]),
        ({"length": np.array([1.0, 1.5])}, ["residuals are white"], []),
        (
            {"length": np.array([1.0, 1.6])},
            ["over 1 to 2 samples", "are 1.0 to 1.3 times"],
            ["errors are rough"],
        ),
        ({"length": np.full(2, 4.0)}, ["over 4 samples", "errors are 2.0 times"], []),
        ({"beyond": 1.1}, [], ["as large again"]),
        ({"beyond": 1.21}, ["they are 1.1 times as large again"], []),
        ({"beyond": 4.0}, ["they are 2.0 times as large again"], []),
        # Student's quantile for 27 degrees of freedom is 2.052, for 28 it is 2.048.
        ({"level_freedom": np.full(2, 27.0)}, ["is 2.1 standard errors"], []),
        ({"level_freedom": np.full(2, 28.0)}, [], ["interval"]),
        (
            {"length": np.full(2, 4.0), "effective": 3.9},
            ["only 4 effective samples for 1 parameters"],
            [],
        ),
        ({"length": np.full(2, 4.0), "effective": 4.0}, [], ["errors are rough"]),
        ({"measured": False}, ["no residuals were at hand"], ["residuals are"]),
    ],
)
def test_the_sentence_on_standard_errors_says_what_enlarges_them(
    changes, words, absent
):
    sentence = noise_of(**changes).sentence
    assert all(word in sentence for word in words), sentence
    assert not any(word in sentence for word in absent), sentence


def test_weights_and_residuals_agree_where_the_weights_are_found():
    """After one round they are the residuals of plain least squares."""
    model, _, log = experiment(3, joints=2, noise=0.1, samples=400)
    loud = log.torque + np.random.default_rng(0).normal(size=(400, 2)) * [0.0, 5.0]
    base = base_parameters(model)
    regression = build_regression(model, replace(log, torque=loud), noise=False)

    def left(weights):
        """Each joint's residual under given weights, less the degrees of freedom."""
        solution = unconstrained_fit(regression.weighted(weights), base)
        rms = regression.residual_rms(solution.parameters)
        return rms / np.sqrt(1.0 - len(base) / 800.0)

    once = joint_noise(model, regression, base=base, iterations=1)
    np.testing.assert_allclose(once, left(np.ones(2)), rtol=1e-9)
    twice = joint_noise(model, regression, base=base, iterations=2)
    np.testing.assert_allclose(twice, left(once), rtol=1e-9)
    found = joint_noise(model, regression, base=base)
    np.testing.assert_allclose(found, left(found), rtol=1e-3)
    assert found[1] > 10.0 * found[0]
    with pytest.raises(ProblemError, match="iterations is 0"):
        joint_noise(model, regression, base=base, iterations=0)
    exact = build_regression(model, experiment(3, joints=2, samples=400)[2])
    floor = 1e-6 * exact.torque_rms
    np.testing.assert_allclose(joint_noise(model, exact, base=base), floor, rtol=1e-6)


def test_noise_of_weighted_joints_is_written_out():
    """Gram matrices of each joint's rows, in combinations of unit effect."""
    model, _, log = experiment(3, joints=2, noise=0.4, samples=120)
    regression = build_regression(model, log, noise=False).weighted([0.05, 3.0])
    base = base_parameters(model)
    found = unconstrained_fit(regression, base).noise
    columns, S = list(base.independent), found.steps
    grams = [F[:, columns].T @ F[:, columns] for F in regression.factors]
    together = sum(G / w**2 for G, w in zip(grams, regression.sigma, strict=True))
    np.testing.assert_allclose(S.T @ together @ S, np.eye(S.shape[1]), atol=1e-9)
    expected = sum(
        s**2 * S.T @ G @ S / w**4
        for G, w, s in zip(grams, regression.sigma, found.sigma, strict=True)
    )
    np.testing.assert_allclose(found.inflation, expected, atol=1e-9 * expected.max())
    freedom = 120.0 * (1.0 - len(columns) / 240.0)
    assert found.level_freedom == pytest.approx([freedom] * 2)
    assert (found.between, found.beyond) == ((), 1.0)


def test_errors_of_the_model_are_a_scatter_of_blocks_beside_noise():
    model, _, log = experiment(3, joints=2, noise=0.4, samples=120)
    plain = build_regression(model, log)
    base = base_parameters(model)
    found = unconstrained_fit(
        replace(plain, noise=replace(plain.noise, beyond=1.5)), base
    ).noise
    (scatter,) = found.between
    np.testing.assert_allclose(scatter.covariance, 0.5 * found.inflation)
    assert (scatter.freedom, found.beyond) == (9.0, 1.5)


@pytest.mark.parametrize("size", [1e-4, 1.0])
def test_exact_torque_has_noise_of_a_small_part_of_itself(size):
    model, _, log = experiment(3, joints=2, samples=60)
    exact = replace(log, torque=size * log.torque)
    regression = build_regression(model, exact, noise=False)
    found = unconstrained_fit(regression, base_parameters(model)).noise
    np.testing.assert_allclose(found.sigma, _EXACT * regression.torque_rms)
