"""Scatter between blocks of one recording: what a fit has absorbed shows in it."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment

import consistent_id as ci
from consistent_id.regression.model_errors import (
    BLOCKS,
    BlockPart,
    block_part,
    block_ratio,
    joint_fit,
)
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
    # Median of chi^2 / 9; shares of a tenth count as 0.095.
    assert found == pytest.approx(np.median(jackknife / by_noise) / 0.927, rel=0.02)


def test_the_sums_of_blocks_are_those_of_the_recording():
    rng = np.random.default_rng(1)
    rows, residual = rng.normal(size=(57, 4)), rng.normal(size=57)
    part = block_part(rows, residual)
    assert isinstance(part, BlockPart)
    assert part.gradients.sum(axis=0) == pytest.approx(rows.T @ residual)
    assert part.normals.sum(axis=0) == pytest.approx(rows.T @ rows)


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
