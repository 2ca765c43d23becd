"""Whether data contradict constraints: chi-bar-square of a half-space, of bodies."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment, pendulum
from scipy.special import chdtrc, fdtrc
from some_fast import some_fast

from consistent_id import (
    InertialParameters,
    PhysicalConsistency,
    ProblemError,
    build_regression,
    compare,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.comparison.consistency_test import (
    DRAWS,
    SIGNIFICANT,
    ConsistencyTest,
    _reaching,
    _squared_distance,
    consistency_test,
)
from consistent_id.comparison.feasibility import in_words
from consistent_id.constraints import ParameterBounds
from consistent_id.estimation.best_fit import best_fit
from consistent_id.regression import base_parameters
from consistent_id.regression.residual_noise import joint_noise, unconstrained_fit


def noisy_pendulum(seed, noise=0.2):
    model, truth, log = pendulum()
    rng = np.random.default_rng(seed)
    log = simulate_torque(model, truth, log, noise=noise, rng=rng)
    return model, truth, build_regression(model, log)


def half_space(model, regression, errors):
    """Friction asked to be some standard errors above what least squares says."""
    plain = least_squares(model, regression)
    k = plain.base.names.index("joint1.viscous")
    bound = plain.base_values[k] + errors * plain.standard_errors[k]
    return {"constraints": [ParameterBounds({"joint1.viscous": (bound, np.inf)})]}


@pytest.mark.slow
@pytest.mark.parametrize("errors", [1.5, 0.5, 3.0])
def test_of_a_half_space_the_p_value_is_half_that_of_chi_square(errors):
    model, _, regression = noisy_pendulum(1)
    regression = replace(regression, noise=None)
    all_400 = {"draws": 400, "enough": 400, **half_space(model, regression, errors)}
    test = consistency_test(model, regression, **all_400)
    assert test.increase == pytest.approx(errors**2, rel=1e-3)
    # A mixture of nothing and of chi^2 with one degree of freedom, by halves; 400
    # draws tell it to four standard errors of a proportion.
    p = 0.5 * chdtrc(1, errors**2)
    assert test.p_value == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 400) + 0.005)


@pytest.mark.slow
@pytest.mark.parametrize(("inside", "counts"), [(1.9, True), (2.1, False)])
def test_a_constraint_within_two_errors_counts_as_active(inside, counts):
    """Two half-spaces: mixture of chi^2 by the angle between them [Shapiro1988]_."""
    model, _, log = experiment(3, joints=2, noise=0.5, samples=300)
    regression = replace(build_regression(model, log), noise=None)
    regression = regression.weighted(joint_noise(model, regression))
    plain = least_squares(model, regression)
    names = ["j0.viscous", "j1.viscous"]
    k = [plain.base.names.index(name) for name in names]
    x, C = plain.base_values[k], plain.base_covariance[np.ix_(k, k)]
    first = x[0] + np.sqrt(C[0, 0])
    best = x[1] + C[1, 0] / C[0, 0] * (first - x[0])  # of the second, with the first
    second = best - inside * np.sqrt(C[1, 1])
    bounds = dict(zip(names, [(first, np.inf), (second, np.inf)], strict=True))
    test = consistency_test(
        model, regression, constraints=[ParameterBounds(bounds)], draws=400, enough=400
    )
    assert test.increase == pytest.approx(1.0, rel=1e-3)
    angle = np.arccos(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]))
    p = 0.5 * chdtrc(1, 1.0) + counts * angle / (2 * np.pi) * chdtrc(2, 1.0)
    # The other case is 0.15 away: seven standard errors of 400 draws.
    assert test.p_value == pytest.approx(p, abs=0.07)


@pytest.mark.slow
@pytest.mark.parametrize("errors", some_fast([3.0, 1.5]))
def test_an_estimated_noise_level_makes_it_that_of_an_f_distribution(errors):
    model, _, regression = noisy_pendulum(1)
    few = replace(regression.noise, freedom=np.array([5.0]), beyond=1.0)
    regression = replace(regression, noise=few)
    # The test weights by the level of all parameters, not by the error of this one.
    weighted = regression.weighted(joint_noise(model, regression))
    fit = unconstrained_fit(weighted, base_parameters(model))
    weighted = weighted.weighted(fit.noise.level)
    plain = least_squares(model, replace(weighted, noise=None))
    fit = unconstrained_fit(weighted, plain.base)
    k = plain.base.names.index("joint1.viscous")
    step = errors * np.linalg.norm(fit.noise.steps[k])
    bounds = {"joint1.viscous": (plain.base_values[k] + step, np.inf)}
    test = consistency_test(
        model, regression, constraints=[ParameterBounds(bounds)], draws=400, enough=400
    )
    assert test.increase == pytest.approx(errors**2, rel=1e-3)
    p = 0.5 * fdtrc(1, 5, errors**2)
    assert test.p_value == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 400) + 0.005)


@pytest.mark.parametrize(
    ("lengths", "freedom", "shared"),
    [
        ((4.0, 4.0, 4.0), 5.0, (4.0, 4.0, 4.0)),
        ((3.9, 4.0, 4.1), 5.0, (4.0, 4.0, 4.0)),  # they differ by chance
        ((1.0, 3.0, 9.0), 1e6, (1.0, 3.0, 9.0)),  # each is known
        (None, 5.0, (1.0, 1.0, 1.0)),  # white
    ],
)
def test_joints_share_the_correlation_of_their_noise(lengths, freedom, shared):
    model, _, log = experiment(3, joints=3, noise=0.5, samples=300)
    regression = build_regression(model, log)
    noise = None
    if lengths is not None:
        effective = np.array(regression.counts) / lengths
        freedoms = np.full(3, freedom)
        noise = replace(
            regression.noise, effective=effective, freedom=freedoms, beyond=1.0
        )
    regression = replace(regression, noise=noise)
    base = base_parameters(model)
    weighted = regression.weighted(joint_noise(model, regression))
    sigma = unconstrained_fit(weighted, base).noise.sigma
    # Least squares with these levels; friction is asked to be 10 units above it.
    R = regression.weighted(sigma * np.sqrt(shared)).stacked()
    A = R[:, list(base.independent)]
    k = base.names.index("j2.viscous")
    x = np.linalg.lstsq(A, R[:, -1])[0][k]
    expected = 10.0**2 / np.linalg.inv(A.T @ A)[k, k]
    test = consistency_test(
        model,
        regression,
        constraints=[ParameterBounds({"j2.viscous": (x + 10.0, np.inf)})],
        draws=1,
    )
    assert test.increase == pytest.approx(expected, rel=1e-4)
    assert test.white == (lengths is None)


def test_what_is_not_rare_is_known_from_a_few_draws_and_what_is_rare_from_all():
    model, truth, log = experiment(4, joints=2, noise=0.0, samples=400)
    noise = log.torque.std(axis=0)
    rng = np.random.default_rng(0)
    common = build_regression(
        model, simulate_torque(model, truth, log, noise=noise, rng=rng)
    )
    wrong = truth.copy()
    wrong[10:20] *= -1.0
    rare = build_regression(
        model, simulate_torque(model, wrong, log, noise=0.1 * noise, rng=rng)
    )
    early, whole = (
        consistency_test(model, common, draws=99, enough=k) for k in (10, 99)
    )
    assert early.draws < whole.draws == 99
    # The tenth draw that reaches it is the last one, so the share is that of the draws.
    assert early.p_value == 10 / early.draws
    # Of ten, a share is known to a third; four of these.
    assert early.p_value == pytest.approx(whole.p_value, rel=4 / np.sqrt(10))
    first, second = (
        consistency_test(model, rare, draws=99, enough=k) for k in (10, 99)
    )
    assert (first.draws, first.p_value) == (second.draws, second.p_value) == (99, 0.01)


@pytest.mark.slow
def test_simulated_data_reach_what_their_own_distance_is_above():
    """Distances to a robot on the boundary, which rough fits find to some per cent."""
    model, truth, log = experiment(4, joints=2, noise=0.0, samples=400)
    wrong, rng = truth.copy(), np.random.default_rng(0)
    wrong[10:20] *= -1.0
    noise = 0.1 * log.torque.std(axis=0)
    log = simulate_torque(model, wrong, log, noise=noise, rng=rng)
    regression, base = build_regression(model, log), base_parameters(model)
    regression = regression.weighted(joint_noise(model, regression, base=base))
    consistent = [PhysicalConsistency(margin=0.0)]
    best = best_fit(model, regression, consistent, base=base)
    fitted = best.scaled.M @ best.solution.u
    assert np.linalg.matrix_rank(best.scaled.M) == len(fitted)  # all noise is in range
    for e in np.random.default_rng(0).normal(size=(40, len(fitted))):
        distance = _squared_distance(best, fitted + e / best.scaled.size)
        if distance > 0.1:
            for share in (0.1, 0.3, 0.7, 0.999, 1.001, 1.5, 3.0, 10.0):
                assert _reaching(best, share * distance, e[None]) == [share < 1.0]


def test_weights_of_the_regression_do_not_matter():
    model, _, log = experiment(3, joints=2, noise=1.0, samples=300)
    regression = build_regression(model, log)
    other = regression.weighted([3.0, 0.1])
    first, second = (consistency_test(model, r, draws=9) for r in (regression, other))
    assert first.increase == pytest.approx(second.increase, rel=1e-3, abs=1e-3)


def test_noise_alone_is_no_contradiction_and_torque_of_no_body_is_one():
    model, truth, log = experiment(4, joints=2, noise=0.0, samples=400)
    rng = np.random.default_rng(0)
    noise = log.torque.std(axis=0)
    shaken = simulate_torque(model, truth, log, noise=noise, rng=rng)
    honest = consistency_test(model, build_regression(model, shaken), draws=99)
    assert not honest.significant
    assert "a consistent robot fits as well" in honest.sentence
    wrong = truth.copy()
    wrong[10:20] *= -1.0
    anti = simulate_torque(model, wrong, log, noise=0.01 * noise, rng=rng)
    found = consistency_test(model, build_regression(model, anti), draws=99)
    assert found.significant
    assert found.p_value == pytest.approx(0.01)
    assert "no consistent robot fits as well" in found.sentence


@pytest.mark.slow
def test_a_comparison_says_whether_the_data_mean_what_is_impossible():
    model, truth, log = experiment(4, joints=2, noise=0.0, samples=400)
    rng = np.random.default_rng(0)
    wrong = truth.copy()
    wrong[10:20] *= -1.0
    log = simulate_torque(model, wrong, log, noise=0.1, rng=rng)
    regression = build_regression(model, log)
    estimate = least_squares(model, regression)
    (alone,) = compare([estimate], [log]).reports
    assert alone.verdict.word == "do not use"
    assert alone.consistency is None
    (tested,) = compare([estimate], [log], regression=regression).reports
    assert tested.consistency is not None
    assert tested.consistency.sentence in tested.impossibility
    assert "proven among parameters up to" in tested.impossibility


def test_without_residuals_it_says_that_noise_is_taken_to_be_white():
    model, _, regression = noisy_pendulum(2)
    bare = replace(regression, noise=None)
    test = consistency_test(model, bare, constraints=[PhysicalConsistency()], draws=2)
    assert test.white
    assert "white" in test.sentence


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 4.0])
def test_of_constraints_that_are_all_active_five_per_cent_are_contradicted(moved):
    # Twelve drive terms at their bound, or one of them standard errors beyond it.
    model, truth, log = experiment(4, joints=4, noise=0.0, samples=400)
    first = model.layout.inertial_size
    truth = truth.copy()
    truth[first:] = 0.0
    drive = model.layout.names[first:]
    bounds = [ParameterBounds({name: (0.0, np.inf) for name in drive})]
    rng, found = np.random.default_rng(0), []
    clean = simulate_torque(model, truth, log)
    noise = 0.05 * clean.torque.std(axis=0)

    def shaken():
        noisy = simulate_torque(model, truth, log, noise=noise, rng=rng)
        return build_regression(model, noisy, noise=False)

    once = least_squares(model, shaken().weighted(noise))
    truth[first] = -moved * once.standard_errors[once.base.names.index(drive[0])]
    for _ in range(200 if moved == 0.0 else 20):
        test = consistency_test(model, shaken(), constraints=bounds)
        found.append(test.significant)
    # 200 tests know a share of 5 % to 1.5 %.
    assert np.mean(found) > 0.9 if moved else 0.01 < np.mean(found) < 0.08


def test_no_draws_are_refused():
    model, _, regression = noisy_pendulum(2)
    with pytest.raises(ProblemError, match="draws is 0"):
        consistency_test(model, regression, draws=0)
    with pytest.raises(ProblemError, match="enough is 0"):
        consistency_test(model, regression, enough=0)
    assert consistency_test(model, regression, draws=1, enough=1).draws == 1


@pytest.mark.slow
def test_a_contradiction_goes_with_the_consistent_estimates_as_worth_knowing():
    model, truth, log = experiment(4, joints=2, noise=0.0, samples=400)
    wrong = truth.copy()
    wrong[10:20] *= -1.0
    rng = np.random.default_rng(0)
    log = simulate_torque(model, wrong, log, noise=0.1, rng=rng)
    regression = build_regression(model, log)
    bodies = [PhysicalConsistency()]
    estimates = [
        least_squares(model, regression),
        constrained_least_squares(model, regression, constraints=bodies),
    ]
    plain, constrained = compare(estimates, [], regression=regression).reports
    assert "no consistent robot fits as well" in plain.impossibility
    assert constrained.evidence.contradicted.startswith("no consistent robot fits")
    assert plain.evidence.contradicted == ""
    reasons = {r.kind: r.word for r in constrained.verdict.reasons}
    assert reasons["physical consistency"] == "use"


@pytest.mark.parametrize(("p_value", "contradicted"), [(0.001, True), (0.5, False)])
def test_only_a_small_p_value_is_called_a_contradiction(p_value, contradicted):
    found = ConsistencyTest(increase=12.3, p_value=p_value, draws=200, white=False)
    assert found.significant == contradicted
    assert ("no consistent robot" in found.sentence) == contradicted
    assert ("chi^2 rises by 12.3" in found.contradiction) == contradicted
    assert bool(found.contradiction) == contradicted


def test_only_less_than_one_in_twenty_is_significant():
    shares = (0.0499, 0.05)
    found = [ConsistencyTest(3.0, share, 100, False).significant for share in shares]
    assert found == [True, False]


def test_the_excess_of_a_moment_is_over_the_sum_of_the_other_two():
    body = InertialParameters.from_central(
        2.0, [0.1, 0, 0], np.diag([4e-3, 1e-3, 2e-3])
    )
    assert "0.004 kg m^2" in in_words(body.vector)
    assert "sum of the other two, 0.003, by 0.001" in in_words(body.vector)


@pytest.mark.slow
def test_draws_are_those_of_seed_zero_unless_another_is_given():
    model, _, regression = noisy_pendulum(1)
    few = {"draws": 30, "enough": 30, **half_space(model, regression, 0.5)}
    first, again, other = (
        consistency_test(model, regression, **few, **seed).p_value
        for seed in ({}, {"seed": 0}, {"seed": 1})
    )
    assert first == again != other


def test_an_increase_that_is_rounding_is_reached_by_all_data():
    model, _, regression = noisy_pendulum(1)
    found = consistency_test(model, regression, draws=12, enough=12)
    assert found.increase < 1e-9 and found.p_value == 1.0


def test_a_p_value_of_five_per_cent_is_one_of_those_that_draws_can_give():
    # Of n draws, p is (1 + those that reach the data's) / (1 + n).
    assert SIGNIFICANT * (1 + DRAWS) == pytest.approx(10.0)
