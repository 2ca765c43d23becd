"""Errors of parameters from Stribeck velocities that are wrong, or hardly known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import consistent_id as ci
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.fleet.windows import RowsInTurn
from consistent_id.recordings.signals import PDGains, commanded, low_passed
from consistent_id.recordings.signals.clocks import cubic_spline
from consistent_id.regression import shape_errors
from consistent_id.regression.correlated_noise import joined_noise
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.regression.segments import segment_regressions
from consistent_id.regression.shape_errors import FACTOR, with_shape_errors

JOINTS, SAMPLES = 2, 3000
STATED = 0.15  # rad/s


def arm(velocities=(STATED,) * JOINTS):
    rows = [ci.DHRow(-np.pi / 2, 0.0, 0.1), ci.DHRow(0.0, 0.4, 0.1)]
    drive = tuple(
        ci.DriveTerms(
            viscous=True, coulomb="tanh", velocity_scale=0.01, stribeck_velocity=v
        )
        for v in velocities
    )
    return ci.TorqueModel(ci.from_modified_dh("arm", rows), drive)


def recorded(model, rng, noise):
    """A slow log, of friction that is different each time."""
    time = np.arange(SAMPLES) / 100
    rates = 2 * np.pi * np.arange(1, 6) / 10
    sizes = rng.normal(size=(JOINTS, 5)) / np.arange(1, 6)
    angles = np.outer(time, rates)[None] + rng.uniform(0, 6, (JOINTS, 1, 5))
    state = (np.sin(angles), rates * np.cos(angles), -(rates**2) * np.sin(angles))
    motion = (np.einsum("jtk,jk->tj", part, sizes) for part in state)
    bodies = [
        ci.InertialParameters.from_central(
            m, (0.2, 0.0, 0.05), m * np.diag([0.01, 0.02, 0.02])
        ).vector
        for m in (4.0, 2.0)
    ]
    friction = np.tile([1.0, 1.5, 1.0], JOINTS) * rng.uniform(0.7, 1.5, 3 * JOINTS)
    truth = np.concatenate([*bodies, friction])
    log = ci.Recording(model.robot.joint_names, time, *motion)
    log = ci.simulate_torque(model, truth, log)
    shaken = log.torque + noise * rng.normal(size=log.torque.shape)
    return truth, replace(log, torque=shaken)


def friction_of(base):
    kinds = ("viscous", "coulomb", "stribeck")
    return [k for k, name in enumerate(base.names) if name.endswith(kinds)]


@pytest.mark.parametrize("change", [0.004, -0.004])
def test_the_error_of_a_velocity_is_found_and_so_is_what_it_does(change):
    """Without noise, the error is that of an exact fit with the wrong velocity."""
    rng = np.random.default_rng(1)
    truth, log = recorded(arm((STATED * np.exp(change), STATED)), rng, 1e-6)
    model, base = arm(), ci.regression.base_parameters(arm())
    regression = ci.build_regression(model, log)
    found = ci.least_squares(model, regression, base=base)
    moved = found.base_values - base.projection @ truth
    columns = list(base.independent)
    R, shapes = regression.stacked()[:, columns], regression.noise.shapes
    first, second = np.sum(shapes, axis=0)[:, columns]
    response = np.linalg.inv(R.T @ R)
    own = friction_of(base)[:3]
    assert abs(response @ first)[own] == pytest.approx(abs(moved[own]), rel=0.05)
    # The joint whose velocity is right has a hundredth of it at the most.
    assert np.linalg.norm(second) < 0.01 * np.linalg.norm(first)


@pytest.mark.parametrize("noise", [0.01, 300.0])
def test_scores_are_those_of_dense_rows(noise):
    rng = np.random.default_rng(2)
    _, log = recorded(arm((0.2, STATED)), rng, noise)
    model = arm()
    regression = ci.build_regression(model, log)
    x = ci.regression.base_parameters(model).lift(
        ci.least_squares(model, regression).base_values
    )
    Y = model.regressor(log.position, log.velocity, log.acceleration)
    high, low = (
        arm((v,) * JOINTS).regressor(log.position, log.velocity, log.acceleration)
        for v in (STATED * 1.001, STATED * 0.999)
    )
    for j, N in enumerate(np.sum(regression.noise.shapes, axis=0)):
        c = ((high - low)[j] / (2 * 0.001)).T @ x
        scores = Y[j] @ c
        size = np.linalg.norm(N) / np.linalg.norm(scores)
        np.testing.assert_allclose(N, size * scores, atol=2e-2 * abs(N).max())
        if noise > 1.0:  # rows show nothing
            assert 0.5 < size / np.log(FACTOR) <= 2.0


def test_nothing_is_added_without_such_friction():
    model = replace(arm(), drive=ci.DriveTerms(viscous=True, coulomb="sign"))
    _, log = recorded(arm(), np.random.default_rng(3), 0.1)
    regression = ci.build_regression(model, log)
    assert regression.noise.shapes == ()
    given = model, regression.factors, regression.counts, [motion_of(model, log, None)]
    assert with_shape_errors(*given, regression.noise) is regression.noise


def told(velocities, rng, delay, error, samples=SAMPLES):
    """A log of commands that are late, and its torque for a delay that is assumed."""
    truth, log = recorded(arm(velocities), rng, 0.0)
    gains, time = PDGains([200.0, 100.0], 0.0), log.time
    q = log.position + log.torque / gains.kp  # so torque is that of the robot
    ahead = cubic_spline(time, q, time + delay + 0.5 * (time[1] - time[0]))
    raw = replace(log, torque=None, position_command=ahead)
    return truth, commanded(raw, gains, delay=error[0], delay_error=error[1])


@pytest.mark.parametrize("cutoff", [None, 8.0])
def test_the_error_of_a_delay_does_what_another_delay_does(cutoff):
    """All joints have the same delay: its scores add, also those of bodies."""
    base, found = ci.regression.base_parameters(arm()), []
    for delay in (0.02, 0.021):
        rng = np.random.default_rng(11)
        _, log = told((STATED,) * JOINTS, rng, 0.02, (delay, 0.001))
        inner = log.samples(slice(50, -50))
        bare = replace(inner, torque_shift=None)
        if cutoff is not None:
            inner = low_passed(inner, torque_cutoff=cutoff)
        regression = ci.build_regression(arm(), inner)
        equal = replace(regression, sigma=np.array([0.5, 2.0]))
        found.append(unconstrained_fit(equal, base))
    moved = found[1].solution.x - found[0].solution.x
    *_, last = found[0].noise.shapes
    np.testing.assert_allclose(
        found[0].noise.steps @ last, moved, rtol=0.02, atol=0.02 * abs(moved).max()
    )
    assert len(ci.build_regression(arm(), bare).noise.shapes[0]) == JOINTS


def test_the_error_of_a_delay_is_added_where_only_some_parts_have_it():
    """Sums, streams and fleets join what has commands and what has not."""
    rng, model = np.random.default_rng(13), arm()
    _, late = told((STATED,) * JOINTS, rng, 0.02, (0.02, 0.001))
    _, plain = recorded(model, rng, 0.1)
    first, second = (ci.build_regression(model, log) for log in (late, plain))
    (Nj, _), (Mj, _) = first.noise.shapes, second.noise.shapes
    for joined in (first + second, second + first):
        (own, _) = joined.noise.shapes
        np.testing.assert_allclose(own[-1], Nj[-1])
        np.testing.assert_allclose(own[:-1], Nj[:-1] + Mj)


def test_windows_without_commands_have_no_shift():
    rng, model = np.random.default_rng(15), arm()
    _, late = told((STATED,) * JOINTS, rng, 0.02, (0.02, 0.001))
    plain = replace(late, torque_shift=None)
    first, second = (motion_of(model, log, None) for log in (late, plain))
    found = RowsInTurn((second, first)).shifted(1)
    np.testing.assert_array_equal(found[:SAMPLES], 0.0)
    np.testing.assert_array_equal(found[SAMPLES:], late.torque_shift[:, 1])
    assert RowsInTurn((second, second)).shifted(1) is None


def test_rows_that_do_not_count_have_no_part_in_the_error_of_a_delay():
    rng, model = np.random.default_rng(14), arm()
    _, log = told((STATED,) * JOINTS, rng, 0.02, (0.02, 0.001), samples=400)
    known = rng.uniform(size=log.position.shape) < 0.5
    motion = motion_of(model, replace(log, torque_known=known), None)
    for j in range(JOINTS):
        np.testing.assert_array_equal(
            motion.shifted(j), np.where(known[:, j], log.torque_shift[:, j], 0.0)
        )


@pytest.mark.slow
def test_intervals_hold_where_the_delay_is_not_the_true_one():
    rng, held, bare = np.random.default_rng(12), [], []
    base = ci.regression.base_parameters(arm())
    for _ in range(25):
        wrong = 0.015 + 0.001 * rng.normal()
        truth, log = told((STATED,) * JOINTS, rng, 0.015, (wrong, 0.001))
        noise = 0.1 * rng.normal(size=log.torque.shape)
        log = replace(log, torque=log.torque + noise).samples(slice(50, -50))
        for inside, used in ((held, log), (bare, replace(log, torque_shift=None))):
            regression = ci.build_regression(arm(), used)
            free = unconstrained_fit(regression, base)
            found = ci.least_squares(arm(), regression, base=base)
            error = abs(found.base_values - base.projection @ truth)
            half = free.noise.quantiles * found.standard_errors
            inside.append(np.mean(error <= half))
    assert np.mean(held) >= 0.93
    assert np.mean(bare) < 0.8


def test_correlated_noise_tells_less_of_a_velocity():
    """Over 19 samples, of the same variance: errors are 4.4 times as large."""
    rng, n = np.random.default_rng(7), (SAMPLES, JOINTS)
    _, log = recorded(arm(), rng, 0.0)
    white, sizes = rng.normal(size=n), []
    slow = signal.lfilter([np.sqrt(0.19)], [1.0, -0.9], white, axis=0)
    for noise in (white, slow):
        shaken = replace(log, torque=log.torque + 0.5 * noise)
        regression = ci.build_regression(arm(), shaken)
        sizes.append([np.linalg.norm(N) for N in regression.noise.shapes])
    assert np.mean(np.divide(sizes[1], sizes[0])) > 2.0


def test_the_middle_of_a_long_log_stands_for_all_of_it(monkeypatch):
    _, log = recorded(arm((0.2, 0.1)), np.random.default_rng(8), 0.1)
    whole = ci.build_regression(arm(), log).noise.shapes
    monkeypatch.setattr(shape_errors, "SHOWN", SAMPLES // 2)
    half = ci.build_regression(arm(), log).noise.shapes
    for one, other in zip(half, whole, strict=True):
        assert np.linalg.norm(one) == pytest.approx(np.linalg.norm(other), rel=0.4)


def test_errors_of_velocities_do_not_widen_quantiles():
    """The noise's variance is an estimate of few freedoms, theirs is a part without."""
    _, log = recorded(arm((0.2, 0.1)), np.random.default_rng(9), 0.5)
    base = ci.regression.base_parameters(arm())
    noise = unconstrained_fit(ci.build_regression(arm(), log), base).noise
    bare = replace(noise, shapes=None)
    own, all_columns = friction_of(base), np.eye(len(base))
    more, few = (each.freedoms(all_columns)[own] for each in (noise, bare))
    assert (more > few).all()
    assert noise.quantiles[own].max() <= bare.quantiles[own].max()


def test_an_older_part_without_such_errors_adds_none():
    _, log = recorded(arm((0.2, 0.1)), np.random.default_rng(4), 0.01)
    noise = ci.build_regression(arm(), log).noise
    both = joined_noise([noise, replace(noise, shapes=())])
    np.testing.assert_array_equal(both.shapes, noise.shapes)


def test_parts_of_a_log_have_the_same_error():
    _, log = recorded(arm((0.2, 0.1)), np.random.default_rng(4), 0.01)
    noise = ci.build_regression(arm(), log).noise
    parts = [noise.share(0.25), noise.share(0.75)]
    for one, whole in zip(joined_noise(parts).shapes, noise.shapes, strict=True):
        np.testing.assert_allclose(one, whole)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_intervals_of_friction_hold_the_truth(noise):
    """Stated velocities are wrong by up to a factor of 1.4."""
    rng = np.random.default_rng(5)
    model, base = arm(), ci.regression.base_parameters(arm())
    own, held, bare = friction_of(base), [], []
    for _ in range(25):
        wrong = STATED * np.exp(rng.uniform(-0.35, 0.35, JOINTS))
        truth, log = recorded(arm(wrong), rng, noise)
        regression = ci.build_regression(model, log)
        for inside, noisy in (
            (held, regression.noise),
            (bare, replace(regression.noise, shapes=(), beyond=1.0)),
        ):
            free = unconstrained_fit(replace(regression, noise=noisy), base)
            found = ci.least_squares(model, free.regression, base=base)
            error = abs(found.base_values - base.projection @ truth)[own]
            half = (free.noise.quantiles * found.standard_errors)[own]
            inside.append(np.mean(error <= half))
    assert np.mean(held) >= 0.93
    assert np.mean(bare) < 0.75


@pytest.mark.slow
def test_uncertainty_contains_it_though_all_segments_have_the_same_error():
    truth, log = recorded(arm((0.2, 0.11)), np.random.default_rng(6), 0.02)
    model, base = arm(), ci.regression.base_parameters(arm())
    others = set(range(len(model.layout))) - set(base.independent)
    values = dict.fromkeys((model.layout.names[i] for i in others), 0.0)
    constraints = [ci.constraints.FixedParameters(values)]
    found = uncertainty(
        model, segment_regressions(model, log), constraints=constraints, replicates=2
    )
    start = model.layout.inertial_size
    assert "segments" in found.scatter
    for parameter, true in zip(found.parameters[start:], truth[start:], strict=True):
        assert abs(parameter.value - true) <= 2.0 * parameter.standard_error
        low, high = parameter.consistent
        assert low <= true <= high
