"""Least squares: SciPy's answer, known truth, standard errors, open directions."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import random_robot, random_states

from consistent_id import (
    DriveTerms,
    NotExcitedError,
    ProblemError,
    Recording,
    TorqueModel,
    build_regression,
    huber,
    least_squares,
    simulate_torque,
)
from consistent_id.estimation import robust, weighted_least_squares
from consistent_id.estimation.base_least_squares import (
    _covariance,
    stationarity_certificate,
)
from consistent_id.regression import base_parameters, joint_noise
from consistent_id.regression.linear import null_space, solve_linear


def _experiment(seed, joints=3, samples=2000, noise=0.0, drive=None):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints)
    model = TorqueModel(robot, drive or DriveTerms(viscous=True, offset=True))
    q, dq, ddq = random_states(rng, joints, samples)
    time = np.arange(samples) / 100
    motion = Recording(robot.joint_names, time, q, dq, ddq)
    drive_values = rng.uniform(0.5, 2.0, len(model.layout) - 10 * joints)
    truth = np.concatenate([robot.nominal, drive_values])
    return model, truth, simulate_torque(model, truth, motion, noise=noise, rng=rng)


def test_without_noise_the_true_base_parameters_come_back():
    model, truth, log = _experiment(0)
    estimate = least_squares(model, build_regression(model, log))
    expected = estimate.base.projection @ truth
    # Condition number below 1e3, so ten digits are left of sixteen.
    assert np.allclose(
        estimate.base_values, expected, rtol=0, atol=1e-10 * abs(expected).max()
    )
    assert estimate.undetermined == ()
    assert estimate.certificate.verdict == "certified"


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(3, 12),
    columns=st.integers(1, 8),
    rank=st.integers(1, 8),
)
def test_the_linear_solution_is_that_of_scipys_complete_decomposition(
    seed, rows, columns, rank
):
    rng = np.random.default_rng(seed)
    rank = min(rank, rows, columns)
    A = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns))
    b = rng.normal(size=rows)
    expected, _, found, _ = scipy.linalg.lstsq(A, b, cond=1e-10)
    singular = np.linalg.svd(A, compute_uv=False)
    if singular[rank - 1] < 1e-4 * singular[0]:
        return  # rank is then a matter of taste
    solution = solve_linear(A, b)
    assert solution.rank == found == rank
    # Ten digits are lost at the most, at a condition number of 1e4 and its square.
    assert np.allclose(
        solution.x, expected, rtol=0, atol=1e-6 * (1 + abs(expected).max())
    )
    assert abs(A @ solution.null_space).max(initial=0.0) <= 1e-6 * abs(A).max()


def test_rank_does_not_depend_on_units():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(20, 3)) @ rng.normal(size=(3, 5))
    units = 10.0 ** np.array([-6, 3, 0, -3, 6])
    assert solve_linear(A, A[:, 0]).rank == 3
    assert solve_linear(A * units, A[:, 0]).rank == 3


@pytest.mark.parametrize("rows", [2, 4, 7])
def test_each_column_has_a_singular_value_of_unit_columns(rows):
    A = np.random.default_rng(rows).normal(size=(rows, 4)) * [1e-3, 1.0, 20.0, 1e3]
    unit = A / np.linalg.norm(A, axis=0)
    found = solve_linear(A, A[:, 0]).singular_values
    assert found.shape == (4,)
    # Squares are the Gram matrix's eigenvalues, zero beyond the number of rows.
    assert np.allclose(found**2, np.linalg.eigvalsh(unit.T @ unit)[::-1], atol=1e-14)


def test_open_directions_change_nothing_whatever_the_columns_units():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(20, 3)) @ rng.normal(size=(3, 5)) * [1.0, 0.1, 10.0, 3.0, 0.3]
    found = solve_linear(A, rng.normal(size=20)).kernel
    assert found.shape == (5, 2)
    sizes = np.linalg.norm(A, axis=0) @ abs(found)
    assert (abs(A @ found).max(axis=0) < 1e-12 * sizes).all()


def test_open_directions_are_named_and_the_smallest_solution_is_taken():
    # Columns 0 and 1 stand only as a sum; 2 alone.
    A = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 1.0], [0.0, 0.0, 3.0], [1.0, 1.0, 1.0]])
    solution = solve_linear(A, A @ np.array([3.0, 1.0, 2.0]))
    assert solution.rank == 2
    assert np.allclose(solution.x, [2.0, 2.0, 2.0])
    assert np.allclose(solution.null_space[:, 0], [1.0, -1.0, 0.0])


def test_a_resting_robot_leaves_inertia_open_and_says_so():
    model, truth, _ = _experiment(3, joints=2, drive=DriveTerms())
    q = np.random.default_rng(0).uniform(-2, 2, (50, 2))
    rest = Recording(model.robot.joint_names, np.arange(50.0), q, 0 * q, 0 * q)
    log = simulate_torque(model, truth, rest)
    estimate = least_squares(model, build_regression(model, log))
    assert estimate.undetermined
    assert any("determine" in note for note in estimate.notes)
    assert np.isinf(estimate.standard_errors).any()
    assert np.allclose(estimate.predict(rest), log.torque, atol=1e-9)


def test_nothing_moves_and_nothing_weighs_is_refused():
    with pytest.raises(NotExcitedError, match="excites no parameter"):
        solve_linear(np.zeros((5, 3)), np.ones(5))


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [[1.0, 1.0], [0.5, 0.05], [0.2, 0.1]])
def test_standard_errors_are_the_scatter_over_repeated_experiments(sigma):
    # Whatever the weights, right or wrong: the errors are of the estimator as used.
    model, _, log = _experiment(4, joints=2, samples=300)
    base = base_parameters(model)
    rng = np.random.default_rng(5)
    noise = np.array([0.5, 0.05])
    estimates = []
    for _ in range(300):
        shaken = replace(log, torque=log.torque + rng.normal(size=(300, 2)) * noise)
        regression = build_regression(model, shaken).weighted(sigma)
        estimates.append(least_squares(model, regression, base=base))
    scatter = np.std([e.base_values for e in estimates], axis=0, ddof=1)
    stated = np.mean([e.standard_errors for e in estimates], axis=0)
    # A standard deviation of 300 has itself a relative error of 4 %; five of them.
    assert np.allclose(stated, scatter, rtol=0.2)


@pytest.mark.slow
def test_weights_follow_each_joints_noise_and_reduce_the_scatter():
    model, truth, log = _experiment(6, joints=2, samples=400)
    base = base_parameters(model)
    rng = np.random.default_rng(7)
    noise = np.array([2.0, 0.02])
    errors = {"plain": [], "weighted": []}
    for _ in range(12):
        noisy = simulate_torque(model, truth, log, noise=noise, rng=rng)
        regression = build_regression(model, noisy)
        # 400 samples: 3.5 %; five of them.
        assert joint_noise(model, regression, base=base) == pytest.approx(
            noise, rel=0.18
        )
        for name, solve in (
            ("plain", least_squares),
            ("weighted", weighted_least_squares),
        ):
            estimate = solve(model, regression, base=base)
            errors[name].append(estimate.base_values - base.projection @ truth)
    plain, weighted = (np.sqrt(np.mean(np.square(e))) for e in errors.values())
    assert weighted < plain


@pytest.mark.slow
def test_hubers_loss_shrugs_off_outliers_that_ruin_least_squares():
    model, truth, log = _experiment(8, noise=0.1)
    torque = log.torque.copy()
    rng = np.random.default_rng(9)
    torque[rng.random(torque.shape) < 0.03] += 100.0
    spoiled = replace(log, torque=torque)
    base = base_parameters(model)
    expected = base.projection @ truth
    plain = least_squares(model, build_regression(model, spoiled), base=base)
    robust = huber(model, spoiled, base=base)
    assert robust.certificate.verdict == "certified"
    error = np.linalg.norm(robust.base_values - expected)
    assert error < 0.1 * np.linalg.norm(plain.base_values - expected)


@pytest.mark.slow
def test_mixed_steps_settle_in_fewer_passes_than_reweighting_alone(monkeypatch):
    model, _, log = _experiment(8, noise=0.1)
    rng = np.random.default_rng(9)
    torque = log.torque + 0.1 * rng.standard_t(1, log.torque.shape)
    spoiled = replace(log, torque=torque)
    few = 7  # mixed steps take six, reweighting alone takes eight
    mixed = huber(model, spoiled, iterations=few)
    assert mixed.certificate.verdict == "certified"
    settled = huber(model, spoiled, iterations=100, tolerance=1e-9)
    change = mixed.predict(log) - settled.predict(log)
    assert (abs(change) / settled.sigma).max() < 1e-3
    monkeypatch.setattr("consistent_id.estimation.robust._GROWN", 0.0)
    assert huber(model, spoiled, iterations=few).certificate.verdict == "uncertified"


@pytest.mark.slow
def test_hubers_standard_errors_are_those_of_least_squares_over_his_efficiency():
    """Of normal noise: 95 % at a bound of 1.345 standard deviations [Huber1981]_."""
    model, truth, log = _experiment(6, joints=2, samples=4000)
    noise, rng = np.array([2.0, 0.02]), np.random.default_rng(0)
    noisy = simulate_torque(model, truth, log, noise=noise, rng=rng)
    robust = huber(model, noisy).standard_errors
    plain = weighted_least_squares(model, build_regression(model, noisy))
    # 4000 samples know both scales to a few per cent, and that nothing is correlated.
    np.testing.assert_allclose(robust, plain.standard_errors / np.sqrt(0.95), rtol=0.08)


def test_hubers_estimate_zeroes_the_gradient_of_hubers_loss():
    model, _, log = _experiment(10, joints=2, samples=500, noise=0.3)
    estimate = huber(model, log, tolerance=1e-8, iterations=100)
    residual = (log.torque - estimate.predict(log)) / estimate.sigma
    psi = np.clip(residual, -1.345, 1.345)
    Y = model.regressor(log.position, log.velocity, log.acceleration)
    gradient = np.einsum("jps,sj->p", Y, psi / estimate.sigma)
    size = np.einsum("jps,sj->p", abs(Y), abs(psi) / estimate.sigma)
    # The iteration stops at a change of 1e-8 of each joint's scale.
    assert abs(gradient).max() <= 1e-6 * size.max()


@pytest.mark.slow
def test_a_reweighting_that_has_not_settled_is_not_certified():
    model, _, log = _experiment(2, joints=2, noise=0.3, samples=300)
    loud = log.torque.copy()
    loud[::20] += 50.0
    wild = replace(log, torque=loud)
    once = huber(model, wild, iterations=1)
    assert once.certificate.verdict == "uncertified"
    assert "allow more iterations" in once.certificate.reason
    settled = huber(model, wild)
    assert settled.certificate.verdict == "certified"
    assert settled.certificate.figures["last change"] <= 1e-4
    assert settled.notes[0] == "Huber's loss, k = 1.345"
    assert huber(model, wild, k=0.5).notes[0] == "Huber's loss, k = 0.5"
    for wrong in ({"k": 0.0}, {"k": np.inf}, {"iterations": 0}):
        with pytest.raises(ProblemError, match=f"{next(iter(wrong))} is"):
            huber(model, wild, **wrong)


def test_with_a_wide_bend_huber_is_weighted_least_squares():
    """No residual is beyond it, so that all rows count alike."""
    model, _, log = _experiment(2, joints=2, noise=0.3, samples=300)
    wide = huber(model, log, k=1e6)
    plain = least_squares(model, build_regression(model, log).weighted(wide.sigma))
    np.testing.assert_allclose(wide.base_values, plain.base_values, rtol=1e-6)
    # The scale is the median absolute residual over that of a normal distribution.
    left = abs(log.torque - wide.predict(log))
    np.testing.assert_allclose(wide.sigma, np.median(left, axis=0) / 0.67449, rtol=1e-3)


def test_null_spaces_of_rows_do_not_depend_on_the_rows_units():
    rows = np.array([[1e-12, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(abs(null_space(rows, 1e-9)), [[0.0], [0.0], [1.0]])


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
def test_how_stationary_a_solution_is_does_not_depend_on_units(size):
    A, b = size * np.array([[1.0, 0.0], [1.0, 2.0]]), np.array([3.0, 4.0]) / size
    x = np.array([3.0, 0.5]) / size**2 * (1.0 + 1e-3)
    found = stationarity_certificate(A, b, SimpleNamespace(x=x, rank=2))
    left = abs(A.T @ (A @ x - b)) / np.linalg.norm(A, axis=0) / np.linalg.norm(b)
    assert found.figures["stationarity"] == pytest.approx(left.max())
    assert found.verdict == "uncertified"


def test_parameters_of_open_directions_have_infinite_errors_and_no_covariance():
    noise = SimpleNamespace(steps=np.eye(3)[:, :2], scatter=np.diag([4.0, 9.0]))
    null = np.array([[0.0], [0.6], [-0.8]])
    found = _covariance(noise, SimpleNamespace(null_space=null))
    nan, inf = np.nan, np.inf
    expected = [[4.0, nan, nan], [nan, inf, nan], [nan, nan, inf]]
    np.testing.assert_array_equal(found, expected)


def test_mixed_steps_are_the_shortest_of_all_points_that_they_span():
    rng = np.random.default_rng(1)
    starts, ends = rng.normal(size=(2, 3, 4))
    metric = rng.normal(size=(6, 4))
    steps = [
        robust._ReweightingStep(a, b, []) for a, b in zip(starts, ends, strict=True)
    ]
    shares = robust._mixed(steps, metric)
    B = (ends - starts) @ metric.T
    expected = np.linalg.solve(B @ B.T, np.ones(3))
    np.testing.assert_allclose(shares, expected / expected.sum())
    assert robust._mixed(steps[:1], metric) == pytest.approx([1.0])


@pytest.mark.parametrize(("size", "back"), [(1.1e-8, 1.0), (0.9e-8, 0.0)])
def test_steps_that_differ_by_a_hundred_millionth_are_alike(size, back):
    ends = np.array([[-0.5, -size], [0.5, 0.0], [0.5, size]]) @ [[1.0, 0.0], [0.0, 1.0]]
    ends[0] = [-0.5, 0.0]
    steps = [robust._ReweightingStep(np.zeros(2), end, []) for end in ends]
    shares = robust._mixed(steps, np.eye(2))
    expected = np.array([0.5, back - 0.5, 1.0 - back])
    np.testing.assert_allclose(shares, expected, atol=1e-6)


def test_mixing_restarts_where_a_step_more_than_doubles(monkeypatch):
    changes, mixed = iter([10.0, 19.0, 39.0, 20.0, 40.0, 20.0, 19.0, 5.0]), []

    def last(steps, metric):
        mixed.append(len(steps))
        return np.eye(len(steps))[-1]

    rows = SimpleNamespace(stacked=lambda: np.eye(2))
    for name, fake in {
        "_mixed": last,
        "_largest_change": lambda *a: next(changes),
        "_residuals": lambda *a: [np.ones((5, 1))],
        "reweighted": lambda *a: SimpleNamespace(weighted=lambda scale: rows),
        "solve_linear": lambda *a: SimpleNamespace(x=np.zeros(1)),
    }.items():
        monkeypatch.setattr(robust, name, fake)
    plain = SimpleNamespace(
        base=SimpleNamespace(independent=(0,), lift=lambda x: x),
        regression=SimpleNamespace(torque_rms=np.ones(1)),
    )
    motions = [SimpleNamespace(counted=np.ones((5, 1), dtype=bool))]
    rules = robust.HuberRules(iterations=8, tolerance=5.0)
    found = robust._settled(None, plain, motions, np.zeros(1), rules)
    assert mixed == [1, 2, 1, 2, 3, 4, 4] and found.change == 5.0
    assert found.scale == pytest.approx(1.4826)


def test_a_matrix_is_the_product_of_what_its_solution_holds():
    """Whatever the units of its columns, and of rank two of three."""
    A = np.random.default_rng(3).normal(size=(7, 3)) * [1e-4, 1.0, 1e5]
    A[:, 2] = 1e5 * (A[:, 1] - 3e4 * A[:, 0])
    found = solve_linear(A, np.ones(7))
    assert found.rank == 2
    again = found.left * found.singular_values[:2] @ found.row_space
    np.testing.assert_allclose(again / A, 1.0, rtol=1e-6)
    np.testing.assert_allclose(
        found.row_space @ found.steps,
        np.diag(1.0 / found.singular_values[:2]),
        atol=1e-12,
    )


@pytest.mark.parametrize(("apart", "rank"), [(1.1, 3), (0.9, 2)])
def test_a_column_counts_from_a_tolerance_of_the_largest_direction_on(apart, rank):
    """Two columns nearly alike have a singular value of a root of two."""
    A = np.array([[1.0, 1.0, 0.0], [0.0, 2e-9 * apart, 0.0], [0.0, 0.0, 5.0]])
    assert solve_linear(A, np.ones(3), tolerance=1e-9).rank == rank
