"""Errors of the model beyond noise: blocks of a recording, and terms it lacks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment

import consistent_id as ci
from consistent_id.regression.drive.laws import Coulomb, Stribeck
from consistent_id.regression.model_errors import (
    BLOCKS,
    LEFT,
    BlockPart,
    _lacking,
    block_part,
    block_ratio,
    joint_fit,
    lacking_factors,
    lacking_ratio,
    lacking_terms,
)
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.regression.torque_along import predicted_torque


def noisy(seed, *, shift=0.0, samples=4000):
    """A log with white noise, and parameters that shift from block to block."""
    model, truth, log = experiment(seed, joints=2, samples=samples)
    rng = np.random.default_rng(seed)
    size = 0.05 * log.torque.std(axis=0)
    torque = log.torque + size * rng.normal(size=log.torque.shape)
    ends = np.linspace(0, samples, BLOCKS + 1).astype(int)
    for run in (slice(*ends[k : k + 2]) for k in range(BLOCKS)):
        change = shift * truth * rng.normal(size=len(truth))
        torque[run] += predicted_torque(model, change, log.samples(run))
    return model, replace(log, torque=torque)


@pytest.mark.slow
def test_white_noise_has_a_ratio_near_one():
    found = [ci.build_regression(*noisy(seed)).noise.beyond for seed in range(12)]
    assert min(found) >= 1.0
    assert np.median(found) < 1.4


@pytest.mark.slow
def test_parameters_that_shift_from_block_to_block_show():
    still, shifting = (
        np.mean(
            [ci.build_regression(*noisy(k, shift=s)).noise.beyond for k in range(5)]
        )
        for s in (0.0, 0.1)
    )
    assert shifting > 2.0 * still


def test_the_ratio_is_that_of_fits_without_each_block():
    """For blocks of like information: a jackknife, made by leaving blocks out."""
    rng = np.random.default_rng(0)
    n, columns = 4000, 3
    A = rng.normal(size=(n, columns))
    block = np.repeat(np.arange(BLOCKS), n // BLOCKS)
    shifts = 0.2 * rng.normal(size=(BLOCKS, columns))
    b = np.einsum("ij,ij->i", A, 1.0 + shifts[block]) + 0.1 * rng.normal(size=n)
    whole = np.column_stack([A, b])
    fit = joint_fit([np.linalg.qr(whole, mode="r")], [n])
    residual = b - A @ fit.x
    w = fit.weights[0]
    sums = block_part(A / w, residual / w)
    found = block_ratio(fit, sums, [A * residual.std()])
    left = [
        np.linalg.lstsq(A[block != k], b[block != k], rcond=None)[0]
        for k in range(BLOCKS)
    ]
    jackknife = (BLOCKS - 1) / BLOCKS * np.sum((np.array(left) - fit.x) ** 2, axis=0)
    by_noise = np.diag(np.linalg.inv(A.T @ A)) * residual.var()
    # Median of chi^2 / 9; shares of a tenth count as 0.095.  Blocks of like information
    # need no correction.
    assert found == pytest.approx(np.median(jackknife / by_noise) / 0.927, rel=0.02)


@pytest.mark.slow
def test_noise_in_blocks_of_unequal_information_is_no_error_of_the_model():
    """A jackknife is larger than the variance, on average; the ratio is not."""
    rng = np.random.default_rng(1)
    n, columns = 200, 6
    size = np.exp(rng.normal(size=(BLOCKS, columns)))[np.repeat(range(BLOCKS), n // 10)]
    A = size * rng.normal(size=(n, columns))
    ratios, jackknives = [], []
    for _ in range(200):
        b = A.sum(axis=1) + 0.1 * rng.normal(size=n)
        fit = joint_fit([np.linalg.qr(np.column_stack([A, b]), mode="r")], [n])
        w, residual = fit.weights[0], b - A @ fit.x
        sums = block_part(A / w, residual / w)
        ratios.append(block_ratio(fit, sums, [0.1 * A]))
        left = np.linalg.inv(np.eye(columns) - fit.steps.T @ sums.normals @ fit.steps)
        moved = (left @ (sums.gradients @ fit.steps)[:, :, None])[:, :, 0] @ fit.steps.T
        known = np.diag(np.linalg.inv(A.T @ A)) * 0.01
        jackknives.append(np.median(0.9 * np.sum(moved**2, axis=0) / known) / 0.927)
    assert np.mean(jackknives) > 1.2
    assert np.mean(ratios) < 1.15


@pytest.mark.slow
def test_noise_in_one_of_several_recordings_of_a_fit_is_no_error_of_the_model():
    """For white noise in equal blocks, the mean of each ratio is that of chi^2 / 9.

    Information that other recordings have must not change it.
    """
    rng = np.random.default_rng(3)
    n, columns = (140, 60), 4
    A = rng.normal(size=(sum(n), columns))
    parts = (slice(0, n[0]), slice(n[0], sum(n)))
    ratios = []
    for _ in range(300):
        b = A.sum(axis=1) + 0.1 * rng.normal(size=sum(n))
        fit = joint_fit([np.linalg.qr(np.column_stack([A, b]), mode="r")], [sum(n)])
        w, residual = fit.weights[0], b - A @ fit.x
        ratios.append(
            [
                block_ratio(
                    fit, block_part(A[part] / w, residual[part] / w), [0.1 * A[part]]
                )
                for part in parts
            ]
        )
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0) / np.sqrt(len(ratios))
    # The median over parameters, between 0.927 and one on average, is over 0.927.
    low, high = 1.0 - 3.0 * error, 1.0 / 0.927 + 3.0 * error
    assert (low < mean).all() and (mean < high).all(), (mean, error)


LACKING = ci.DriveTerms(drag=True, spring=True, offset=True)


def test_columns_of_a_motion_are_those_of_a_model_that_has_the_terms():
    model, _, log = experiment(4, joints=3, noise=0.1, samples=600)
    log = ci.low_passed(log, torque_cutoff=8.0)
    full = replace(model, drive=LACKING)
    Y = motion_of(full, log, None).regressor(full)
    for joint, name in enumerate(model.robot.joint_names):
        own = motion_of(model, log, None).drive_columns(LACKING, joint, joint)
        places = [full.layout.index(f"{name}.{term}") for term in LACKING.names]
        assert own == pytest.approx(Y[joint, places].T, abs=1e-9 * abs(Y).max())


def test_the_ratio_of_lacking_terms_is_that_of_fits_with_and_without_them():
    rng = np.random.default_rng(2)
    n, columns, terms = 600, 4, 3
    A, Z = rng.normal(size=(n, columns)), rng.normal(size=(n, terms))
    Z += A[:, :terms]  # what the model lacks looks like what it has
    b = A.sum(axis=1) + Z @ [0.1, -0.2, 0.1] + rng.normal(size=n)
    fit = joint_fit([np.linalg.qr(np.column_stack([A, b]), mode="r")], [n])
    sigma = 1.3
    rows = np.column_stack([A @ fit.steps, Z, b]) / sigma
    both = np.column_stack([A, Z])
    (x, [square], *_), (y, [less], *_) = (
        np.linalg.lstsq(part, b, rcond=None) for part in (A, both)
    )
    W = (square - less) / sigma**2
    variance = sigma**2 * np.diag(np.linalg.inv(A.T @ A))
    moved = np.median((y[:columns] - x) ** 2 / variance) / 0.455
    assert W > terms
    assert lacking_ratio(fit, rows) == pytest.approx(1.0 + (1.0 - terms / W) * moved)
    small = np.column_stack([A @ fit.steps, 1e-9 * Z, b]) / sigma
    assert lacking_ratio(fit, small) == pytest.approx(lacking_ratio(fit, rows))
    tiny = fit._replace(steps=1e-12 * fit.steps)
    assert lacking_ratio(tiny, rows) == pytest.approx(lacking_ratio(fit, rows))
    still = np.insert(rows, columns, 0.0, axis=1)
    assert lacking_ratio(fit, still) == pytest.approx(lacking_ratio(fit, rows))
    nothing = fit._replace(steps=fit.steps[:, :0])
    assert lacking_ratio(nothing, rows[:, columns:]) == 1.0
    assert lacking_ratio(fit, np.delete(rows, range(columns, columns + terms), 1)) == 1
    # Terms that explain no more than noise does, and terms that the model has.
    assert lacking_ratio(fit, np.column_stack([rows[:, :-1], A @ fit.x])) == 1.0
    has = np.column_stack([A @ fit.steps, A @ rng.normal(size=(columns, terms)), b])
    assert lacking_ratio(fit, has) == 1.0


def swinging(seed, drive):
    """A smooth log of an arm of three joints, with white noise of 2 %."""
    model, truth, log = experiment(seed, joints=3, samples=1500, drive=drive)
    rng = np.random.default_rng(seed)
    angle = np.outer(log.time, rng.uniform(0.8, 5.0, 9)) + rng.uniform(0.0, 6.0, 9)
    rates = np.diff(angle[:2], axis=0)[0] / np.diff(log.time)[0]
    mix = 0.5 * rng.normal(size=(9, 3))
    states = (np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle))
    log = ci.Recording(log.joints, log.time, *(part @ mix for part in states))
    clean = ci.simulate_torque(model, truth, log).torque
    noise = 0.02 * clean.std(axis=0) * rng.normal(size=clean.shape)
    return model, truth, replace(log, torque=clean + noise)


@pytest.mark.slow
def test_friction_that_a_model_lacks_widens_intervals_and_a_right_model_does_not():
    drive = ci.DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.1, stribeck_velocity=0.4
    )
    right, lacking = [], []
    for seed in range(12):
        full, truth, log = swinging(seed, drive)
        plain = replace(full, drive=without_stribeck(drive))
        true = dict(zip(full.layout.names, truth, strict=True))
        for model, found in ((full, right), (plain, lacking)):
            known = np.array([true[name] for name in model.layout.names])
            regression = ci.build_regression(model, log)
            base = ci.regression.base_parameters(model)
            estimate = ci.least_squares(model, regression, base=base)
            z = abs(estimate.base_values - base.projection @ known)
            z = z / estimate.standard_errors
            beyond = regression.noise.beyond
            alone = np.mean(z * np.sqrt(beyond) <= 1.96)
            found.append((beyond, np.mean(z <= 1.96), alone))
    (ratio, held, _), (more, beside, alone) = (
        np.mean(found, axis=0) for found in (right, lacking)
    )
    assert ratio < 1.5 < more
    assert 0.93 < held < 0.975
    # Of 36 logs, 92.5 % +- 1.2 % are within their intervals, and 88.2 % without it.
    assert alone < 0.905 < 0.915 < beside < 0.97


def without_stribeck(drive):
    options = {k: v for k, v in drive.options.items() if not k.startswith("stribeck")}
    return ci.DriveTerms(**options)


def test_the_sums_of_blocks_are_those_of_the_recording():
    rng = np.random.default_rng(1)
    rows, residual = rng.normal(size=(57, 4)), rng.normal(size=57)
    part = block_part(rows, residual)
    assert isinstance(part, BlockPart)
    assert part.gradients.sum(axis=0) == pytest.approx(rows.T @ residual)
    assert part.normals.sum(axis=0) == pytest.approx(rows.T @ rows)


@pytest.mark.slow
def test_standard_errors_grow_by_its_root_and_estimates_do_not_change():
    model, log = noisy(2, shift=0.1)
    regression = ci.build_regression(model, log)
    bare = replace(regression, noise=replace(regression.noise, beyond=1.0))
    one, other = (ci.least_squares(model, r) for r in (regression, bare))
    root = np.sqrt(regression.noise.beyond)
    assert one.standard_errors == pytest.approx(root * other.standard_errors)
    assert np.array_equal(one.parameters, other.parameters)
    assert f"they are {root:.1f} times as large again" in " ".join(one.notes)
    assert "as large again" not in " ".join(other.notes)
    constrained = [ci.constrained_least_squares(model, r) for r in (regression, bare)]
    assert np.array_equal(constrained[0].parameters, constrained[1].parameters)


def test_it_is_kept_in_files_and_averaged_over_recordings(tmp_path):
    model, log = noisy(2, shift=0.1)
    one = ci.build_regression(model, log)
    path = ci.regression.save_regression(one, tmp_path / "one.json")
    assert ci.regression.load_regression(path).noise.beyond == one.noise.beyond
    other = ci.build_regression(*noisy(2))
    both = one.joined([other])
    low, high = sorted((one.noise.beyond, other.noise.beyond))
    assert low < both.noise.beyond < high
    base = ci.regression.base_parameters(model)
    assert unconstrained_fit(both, base).noise.beyond == both.noise.beyond


def test_exact_torque_has_no_scatter():
    model, _, log = experiment(1, joints=2, samples=400)
    noise = ci.build_regression(model, log).noise
    assert np.isfinite(noise.beyond)
    assert noise.beyond >= 1.0


def test_terms_that_a_joint_lacks_are_those_that_its_drive_does_not_have():
    lacking = {
        name
        for law in _lacking(ci.DriveTerms(viscous=True, offset=True), 1.0)
        for name in law.names
    }
    assert lacking == {"drag", "spring", "rotor_inertia", "coulomb"}


@pytest.mark.parametrize("coulomb", [{}, {"coulomb": "sign"}])
def test_joints_that_move_lack_terms_whose_shapes_go_with_their_speed(coulomb):
    """A sharp change of sign, or friction that fades, well within the motion."""
    model, _, log = experiment(4, joints=3, samples=300, drive=ci.DriveTerms(**coulomb))
    still = log.velocity * [1.0, 0.0, 3.0]
    motion = motion_of(model, replace(log, velocity=still), None)
    first, third = lacking_terms(model, [motion])
    assert (first.joint, first.row, third.joint, third.row) == (0, 0, 2, 2)
    for found, joint in ((first, 0), (third, 2)):
        speed = np.sqrt(np.mean(still[:, joint] ** 2))
        names = set(found.terms.names)
        assert {"viscous", "drag", "spring", "rotor_inertia", "offset"} <= names
        (shaped,) = (
            term
            for term in found.terms.terms
            if isinstance(term, (Stribeck if coulomb else Coulomb))
        )
        width = shaped.stribeck_velocity if coulomb else shaped.velocity_scale
        assert 0.02 * speed < width < 0.5 * speed
    twice = motion_of(model, replace(log, velocity=2.0 * still), None)
    pairs = zip(lacking_terms(model, [twice]), (first, third), strict=True)
    for double, single in pairs:
        shapes = [
            [x for term in found.terms.terms for x in term.shapes.values()]
            for found in (double, single)
        ]
        kept = {2.0}  # the exponent of fading
        ratios = {
            round(a / b, 9) for a, b in zip(*shapes, strict=True) if b not in kept
        }
        assert ratios == {2.0}
    two = lacking_terms(model, [motion, motion])
    assert [found.terms for found in two] == [first.terms, third.terms]
    few = replace(model, torque_joints=("j2",))
    assert [t.row for t in lacking_terms(few, [motion])] == [0]


def test_an_offset_is_lacking_unless_friction_is_of_two_levels():
    for drive, lacking in (
        (ci.DriveTerms(coulomb="sign"), True),
        (ci.DriveTerms(coulomb="sign", asymmetric=True), False),
        (ci.DriveTerms(offset=True), False),
    ):
        model, _, log = experiment(4, joints=1, samples=50, drive=drive)
        (found,) = lacking_terms(model, [motion_of(model, log, None)])
        assert ("offset" in found.terms.names) is lacking


def test_the_ratio_of_unequal_blocks_is_that_of_covariances_written_out():
    """Two joints of other units and noise, three parameters of which two are known."""
    rng = np.random.default_rng(3)
    units = np.array([1e-4, 1.0, 30.0])
    rows = [rng.normal(size=(400, 3)) / units * size for size in (1.0, 7.0)]
    for Y in rows:
        Y[:, 2] = 0.0
        Y *= np.linspace(0.2, 2.0, 400)[:, None]
    factors = [
        np.column_stack([Y, Y.sum(axis=1) + size * rng.normal(size=400)])
        for Y, size in zip(rows, (0.3, 4.0), strict=True)
    ]
    # The fit is to twice as much data.
    fit = joint_fit([np.sqrt(2.0) * F for F in factors], [800, 800])
    parts = [
        block_part(Y / w, (F[:, -1] - Y @ fit.x) / w)
        for Y, F, w in zip(rows, factors, fit.weights, strict=True)
    ]
    sums = BlockPart(*(sum(both) for both in zip(*parts, strict=True)))
    scores = [
        rng.normal(size=(3, 3)) / units * size * fit.weights.mean()
        for size in (5.0, 20.0)
    ]
    found = block_ratio(fit, sums, scores)

    S, rank = fit.steps, fit.steps.shape[1]
    assert rank == 2 and not S[2].any()
    shares = [S.T @ N @ S for N in sums.normals]
    assert np.trace(sum(shares)) == pytest.approx(1.0)
    y = [S.T @ (g - sums.gradients.mean(axis=0)) for g in sums.gradients]
    without = [np.linalg.inv(np.eye(rank) - (1.0 - LEFT) * A) for A in shares]
    between = sum((S @ W @ z) ** 2 for W, z in zip(without, y, strict=True))
    by_noise = sum(
        np.sum((S @ (N @ S).T) ** 2, axis=1) / s**4
        for N, s in zip(scores, fit.weights, strict=True)
    )
    # Scores of white residuals, block by block, and what is left of them centred.
    K = np.block(
        [
            [(i == j) * A - A @ B for j, B in enumerate(shares)]
            for i, A in enumerate(shares)
        ]
    )
    centre = np.kron(np.eye(BLOCKS) - 1.0 / BLOCKS, np.eye(rank))
    K = (centre @ K @ centre).reshape(BLOCKS, rank, BLOCKS, rank)
    white = sum(S @ W @ K[i, :, i] @ W @ S.T for i, W in enumerate(without))
    by_white = np.diag(white)[:2] / np.diag(S @ sum(shares) @ S.T)[:2]
    ratio = (1.0 - 1.0 / BLOCKS) * (between[:2] / by_noise[:2] - by_white) + 1.0
    assert found == pytest.approx(np.median(ratio) / 0.927)
    assert block_ratio(fit, sums, [np.zeros((1, 3))] * 2) == 1.0


def test_of_exact_torque_a_part_in_a_million_is_taken_for_noise():
    """Of the joint's own torque, or as little of that of the largest."""
    rng = np.random.default_rng(4)
    Y = [rng.normal(size=(50, 2)) * size for size in (40.0, 1e-3)]
    factors = [np.column_stack([A, A @ [2.0, -1.0]]) for A in Y]
    fit = joint_fit([*factors, np.zeros((1, 3))], [50, 50, 50])
    rms = [np.sqrt(np.mean(F[:, -1] ** 2)) for F in factors]
    np.testing.assert_allclose(fit.noise, [*(1e-6 * np.array(rms)), 1e-12 * rms[0]])
    np.testing.assert_allclose(fit.x, [2.0, -1.0])
    assert joint_fit([np.zeros((1, 3))], [50]).noise.tolist() == [1e-12]


def test_rows_beside_lacking_terms_have_their_place_among_those_of_all_joints():
    rng = np.random.default_rng(5)
    fit = SimpleNamespace(steps=rng.normal(size=(5, 2)))
    rows, expand, Z = (rng.normal(size=size) for size in ((20, 4), (3, 5), (20, 2)))
    found = lacking_factors(fit, rows, expand, [Z[:, :1], Z[:, 1:]], (1, 4))
    X = np.zeros((20, 7))
    X[:, :2], X[:, 3:5] = rows[:, :-1] @ expand @ fit.steps, Z
    X[:, -1] = rows[:, -1]
    np.testing.assert_allclose(found.T @ found, X.T @ X, atol=1e-10)
