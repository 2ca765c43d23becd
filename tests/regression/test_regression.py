"""Regression: the stacked matrix, built with Pinocchio, is the truth."""

import tracemalloc

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot, random_states

from consistent_id.errors import NotExcitedError, ProblemError, RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import base_parameters, condition_number
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.loaders import DHRow, from_modified_dh

CHANNELS = ("position", "velocity", "acceleration", "torque")
DRIVE = DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
ROBOTS = [(1, False, 1), (4, False, 2), (7, False, 3), (6, True, 4)]


def recorded(robot, rng, samples, name="log"):
    """Random states and torques, with the joints in reverse and a stranger first."""
    n = len(robot)
    motion = [x[:, ::-1] for x in random_states(rng, n, samples)]
    torque = rng.normal(size=(samples, n))
    stranger = np.full((samples, 1), 1e3)
    joints = ("stranger", *robot.joint_names[::-1])
    channels = [np.hstack([stranger, x]) for x in (*motion, torque)]
    return Recording(joints, 0.01 * np.arange(samples), *channels, name=name)


def stacked_rows(pin_model, robot, recording):
    """``[Y, tau]`` from Pinocchio, shape (joints, samples, parameters + 1)."""
    log, n = recording.of(robot.joint_names), len(robot)
    data = pin_model.createData()
    rows = np.zeros((n, len(log), 14 * n + 1))
    states = zip(log.position, log.velocity, log.acceleration, strict=True)
    for i, state in enumerate(states):
        rows[:, i, : 10 * n] = pin.computeJointTorqueRegressor(pin_model, data, *state)
    for j in range(n):
        dq, ddq = log.velocity[:, j], log.acceleration[:, j]
        terms = np.column_stack([dq, np.sign(dq), np.ones_like(dq), ddq])
        rows[j, :, 10 * n + 4 * j : 10 * n + 4 * j + 4] = terms
    rows[:, :, -1] = log.torque.T
    return rows


def problem(joints=4, tree=False, seed=2, samples=200):
    rng = np.random.default_rng(seed)
    pin_model, robot = random_robot(rng, joints, tree=tree)
    recording = recorded(robot, rng, samples)
    rows = stacked_rows(pin_model, robot, recording)
    return TorqueModel(robot, DRIVE), recording, rows, rng


def assert_same_squares(regression, rows):
    """``F'F = [Y, tau]'[Y, tau]`` joint by joint: the same norm for every ``x``."""
    for F, Y in zip(regression.factors, rows, strict=True):
        # Rounding of sums of hundreds of products; relative to the largest entry.
        gram = Y.T @ Y
        np.testing.assert_allclose(F.T @ F, gram, rtol=0, atol=1e-12 * abs(gram).max())


@pytest.mark.parametrize(("joints", "tree", "seed"), ROBOTS)
@pytest.mark.parametrize("samples", [2, 300])
def test_factors_give_the_stacked_residual_norm(joints, tree, seed, samples):
    model, recording, rows, rng = problem(joints, tree, seed, samples)
    regression = build_regression(model, recording)
    for _ in range(5):
        x = rng.normal(size=len(model.layout))
        z = np.append(x, -1.0)
        truth = np.linalg.norm(rows @ z, axis=1)
        found = [np.linalg.norm(F @ z) for F in regression.factors]
        # Rounding, times the condition of the independent columns of a row.
        np.testing.assert_allclose(found, truth, rtol=1e-10)
        rms = truth / np.sqrt(samples)
        np.testing.assert_allclose(regression.residual_rms(x), rms, rtol=1e-10)
    torque_rms = np.sqrt(np.mean(rows[:, :, -1] ** 2, axis=1))
    np.testing.assert_allclose(regression.torque_rms, torque_rms, rtol=1e-12)
    assert regression.counts == (samples,) * joints
    assert regression.joints == model.robot.joint_names


@pytest.mark.parametrize(("joints", "tree", "seed"), ROBOTS)
def test_singular_values_are_those_of_the_stacked_matrix(joints, tree, seed):
    model, recording, rows, rng = problem(joints, tree, seed)
    sigma = rng.uniform(0.1, 10.0, joints)
    W = (rows / sigma[:, None, None]).reshape(-1, rows.shape[2])
    compressed = build_regression(model, recording).weighted(sigma).stacked()
    truth = np.linalg.svd(W, compute_uv=False)
    found = np.linalg.svd(compressed, compute_uv=False)
    found = np.append(found, np.zeros(len(truth) - len(found)))
    # The backward error of QR is relative to the largest singular value.
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-12 * truth[0])


def test_weights_divide_each_joints_rows_and_replace_one_another():
    model, recording, rows, rng = problem()
    plain = build_regression(model, recording)
    sigma = np.array([0.1, 1.0, 3.0, 20.0])
    weighted = plain.weighted([5.0] * 4).weighted(sigma)
    x = rng.normal(size=len(model.layout))
    z = np.append(x, -1.0)
    truth = np.linalg.norm((rows @ z) / sigma[:, None])
    assert np.linalg.norm(weighted.stacked() @ z) == pytest.approx(truth, rel=1e-10)
    np.testing.assert_array_equal(weighted.residual_rms(x), plain.residual_rms(x))
    np.testing.assert_array_equal(plain.sigma, 1.0)


@pytest.mark.slow
def test_adding_two_recordings_equals_building_from_both():
    rng = np.random.default_rng(5)
    pin_model, robot = random_robot(rng, 4)
    model = TorqueModel(robot, DRIVE)
    logs = [recorded(robot, rng, samples) for samples in (40, 7, 300)]
    rows = np.concatenate([stacked_rows(pin_model, robot, log) for log in logs], axis=1)
    a, b, c = (build_regression(model, log) for log in logs)
    for regression in (a + b + c, c + (b + a), build_regression(model, logs)):
        assert_same_squares(regression, rows)
        assert regression.counts == (347,) * 4
    for part, log in zip((a, b, c), logs, strict=True):  # and the parts still stand
        assert_same_squares(part, stacked_rows(pin_model, robot, log))


def test_without_the_pass_for_noise_all_else_is_the_same():
    rng = np.random.default_rng(5)
    _, robot = random_robot(rng, 2)
    model, log = TorqueModel(robot, DRIVE), recorded(robot, rng, 60)
    whole, bare = (build_regression(model, log, noise=n) for n in (True, False))
    assert whole.noise is not None
    assert bare.noise is None
    for mine, theirs in zip(whole.factors, bare.factors, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert (bare.counts, bare.peaks.tolist()) == (whole.counts, whole.peaks.tolist())


@pytest.mark.slow
def test_neither_the_order_of_samples_nor_the_size_of_pieces_matters():
    # Two pieces of four chunks each, and a last piece of one sample.
    model, recording, rows, rng = problem(joints=2, samples=32_769)
    assert_same_squares(build_regression(model, recording), rows)
    order = rng.permutation(len(recording))
    shuffled = (getattr(recording, name)[order] for name in CHANNELS)
    log = Recording(recording.joints, recording.time, *shuffled)
    assert_same_squares(build_regression(model, log), rows)


@pytest.mark.slow
def test_the_same_recording_gives_the_same_bits():
    model, recording, _, _ = problem(joints=2, samples=40_000)
    first, again = (build_regression(model, recording) for _ in range(2))
    for one, other in zip(first.factors, again.factors, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_samples():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(1, 0.1), DHRow(-1, 0.2)])
    model = TorqueModel(robot)

    def peak(samples):
        motion = np.zeros((4, samples, 3))
        motion += np.sin(np.arange(1.0, 13.0)).reshape(4, 1, 3)
        log = Recording(robot.joint_names, np.arange(samples) * 1e-3, *motion)
        tracemalloc.start()
        try:
            build_regression(model, log)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(1000)  # imports
    # One or two workers' pieces at a time, 7 MB each; all rows would take 298 MB.
    assert peak(400_000) < 2.5 * peak(40_000)


def test_parameters_survive_a_condition_number_that_normal_equations_do_not():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(np.pi / 2, 0), DHRow(0, 0.6)])
    model, rng = TorqueModel(robot), np.random.default_rng(0)
    columns = list(base_parameters(model).independent)
    truth = np.zeros(30)
    truth[columns] = rng.normal(size=len(columns))
    q = 0.5 + 3e-7 * rng.uniform(-1, 1, (1000, 3))  # it hardly leaves one pose
    dq, ddq = rng.uniform(-1, 1, (2, 1000, 3))
    torque = model.predict(truth, q, dq, ddq)
    log = Recording(robot.joint_names, np.arange(1000.0), q, dq, ddq, torque)
    R = build_regression(model, log).stacked()
    W, y = np.hstack(list(model.regressor(q, dq, ddq))).T[:, columns], torque.T.ravel()
    assert 5e7 < condition_number(W, basis="").value < 2e8

    def error(x):
        return np.linalg.norm(x - truth[columns]) / np.linalg.norm(truth)

    by_qr = error(np.linalg.lstsq(R[:, columns], R[:, -1], rcond=None)[0])
    squared = error(np.linalg.solve(W.T @ W, W.T @ y))
    # Rounding is 1e-16, times the condition number (QR), or times its square.
    assert by_qr < 1e-7 and squared > 1e4 * by_qr


@pytest.mark.slow
def test_row_weights_multiply_rows_and_torques():
    model, recording, rows, rng = problem(samples=5000)  # more than one chunk
    recording = recording.of(model.robot.joint_names)
    weights = rng.uniform(-2.0, 2.0, recording.torque.shape)
    weights[10:20] = 0.0
    regression = build_regression(model, recording, row_weights=[weights])
    assert_same_squares(regression, rows * weights.T[:, :, None])
    both, of_each = [recording, recording], [weights, 0 * weights]
    twice = build_regression(model, both, row_weights=of_each)
    assert_same_squares(twice, rows * weights.T[:, :, None])


@pytest.mark.parametrize("absent", ["velocity", "acceleration", "torque"])
def test_a_missing_channel_is_refused_by_name(absent):
    model, log, _, _ = problem()
    channels = {name: getattr(log, name) for name in CHANNELS if name != absent}
    poor = Recording(log.joints, log.time, **channels, name="log 7")
    advice = "measured torque" if absent == "torque" else "signals.differentiated"
    with pytest.raises(RecordingError, match=f"^log 7 has no {absent};.*{advice}"):
        build_regression(model, [log, poor])


def test_a_missing_joint_is_refused_by_name():
    model, log, _, _ = problem()
    first, *others = model.robot.joint_names
    with pytest.raises(RecordingError, match=f"log has no joint '{first}'"):
        build_regression(model, log.of(others))


def test_no_recording_is_no_regression():
    model, *_ = problem()
    with pytest.raises(NotExcitedError, match="no recording"):
        build_regression(model, [])


@pytest.mark.parametrize("sigma", [1.0, [1.0], [1, 1, 1, 0], [-1] * 4, [np.nan] * 4])
def test_noise_levels_must_be_positive_and_one_per_joint(sigma):
    model, log, _, _ = problem()
    with pytest.raises(ProblemError, match="sigma"):
        build_regression(model, log).weighted(sigma)


def test_regressions_of_other_models_or_weights_are_not_added():
    model, log, _, _ = problem()
    regression = build_regression(model, log)
    other = build_regression(TorqueModel(model.robot), log)
    with pytest.raises(ProblemError, match="different models"):
        regression + other
    with pytest.raises(ProblemError, match="different weights"):
        regression + regression.weighted([1, 2, 3, 4])


def test_factors_are_checked_copied_and_frozen():
    model, log, _, _ = problem()
    kept = build_regression(model, log)
    with pytest.raises(ValueError, match="read-only"):
        kept.factors[0][0] = 1.0
    mine = tuple(factor.copy() for factor in kept.factors)
    again = Regression(kept.layout, kept.joints, mine, kept.counts)
    mine[0][:] = 0.0
    np.testing.assert_array_equal(again.stacked(), kept.stacked())
    with pytest.raises(ProblemError, match="4 joints need 4 factors"):
        Regression(kept.layout, kept.joints, mine[:3], kept.counts)
    with pytest.raises(ProblemError, match=r"factor of .*: expected shape \(any, 57\)"):
        Regression(kept.layout, kept.joints, [m[:, 1:] for m in mine], kept.counts)
