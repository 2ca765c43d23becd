"""Drive gains, from currents and a load of known mass."""

import os
from dataclasses import replace
from time import perf_counter
from types import SimpleNamespace

import numpy as np
import pytest
from loaded import GAINS, LOAD, runs
from ur10e_loads import prepared, ur10e_runs

from consistent_id import ProblemError, RecordingError, SolverError
from consistent_id.estimation import gains, identify_gains, identify_payload

KNOWN = {"load.m": LOAD.mass}
AXES = ("hx", "hy", "hz")


def _found(noise, seed=0, known=KNOWN, **options):
    model, unloaded, loaded = runs(noise, seed, gains=GAINS)
    return identify_gains(model, loaded, unloaded, known=known, **options)


@pytest.mark.slow
def test_gains_are_exact_without_noise():
    started = perf_counter()
    found = _found(0.0)
    assert 0.0 < found.seconds <= perf_counter() - started
    assert np.allclose(found.gains, GAINS, rtol=1e-7)
    assert np.allclose(found.linear, GAINS, rtol=1e-7)
    assert found.identifiable
    load = found.parameters[found.robot.load_slice]
    assert np.allclose(load, LOAD.vector, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_gains_are_recovered_within_their_errors_where_least_squares_is_biased():
    misses, bias = [], []
    for seed in range(12):
        found = _found(0.05, seed)
        misses.append((found.gains - GAINS) / found.standard_errors)
        bias.append(found.linear / GAINS - 1.0)
    # 48 errors in units of their standard errors, not independent of each other.
    assert 0.4 < np.mean(np.square(misses)) < 1.8
    assert abs(np.mean(misses)) < 0.6
    # Noise on the regressor shrinks the solution.
    assert np.mean(bias, axis=0).max() < -0.01
    assert np.mean(bias) < -0.03


@pytest.mark.slow
def test_the_whole_load_known_tells_more_than_its_mass():
    every = {f"load.{n}": v for n, v in zip(AXES, LOAD.vector[1:4], strict=True)}
    more = _found(0.05, known=KNOWN | every)
    assert (more.standard_errors < _found(0.05).standard_errors).all()
    assert np.allclose(more.gains, GAINS, rtol=0.05)


@pytest.mark.slow
def test_without_a_known_mass_only_ratios_are_told():
    found = _found(0.02, known={})
    assert not found.identifiable
    assert "absolute scale is open" in found.verdict
    assert np.isinf(found.standard_errors).all()
    ratios = found.gains / found.gains[0]
    assert np.allclose(ratios, GAINS / GAINS[0], rtol=0.05)


def test_a_loaded_run_alone_does_not_tell_the_scale():
    model, _, loaded = runs(0.02, gains=GAINS)
    # Whatever the robot's last link weighs, the load may be part of it.
    found = identify_gains(model, loaded, [], known=KNOWN)
    assert not found.identifiable
    assert "absolute scale is open" in found.verdict


@pytest.mark.slow
def test_what_is_not_known_well_enough_is_named():
    found = _found(0.3, accuracy=1e-3)
    assert not any(found.identified)
    assert "j2" in found.verdict
    assert "heavier" in found.verdict
    assert "10 % or better" not in found.verdict


@pytest.mark.slow
def test_a_gain_is_known_if_its_relative_error_is_below_the_accuracy():
    found = _found(0.3)
    errors = found.standard_errors / found.gains
    assert found.relative_errors == pytest.approx(errors)
    worst = int(errors.argmax())
    for share, known in ((1.001, True), (0.999, False)):
        judged = replace(found, accuracy=share * errors[worst])
        assert judged.identifiable == judged.identified[worst] == known
        others = np.delete(judged.identified, worst)
        assert others.all()
        assert (
            f"{found.joints[worst]} ({errors[worst]:.0%})" in judged.verdict
        ) != known


@pytest.mark.slow
def test_gains_refuse_what_does_not_fit():
    model, unloaded, loaded = runs(0.02, gains=GAINS)
    with pytest.raises(ProblemError, match="no parameter named"):
        identify_gains(model, loaded, unloaded, known={"load.weight": 1.0})
    dead = [
        replace(log, torque=log.torque * [1.0, 1.0, 0.0, 1.0])
        for log in (loaded, unloaded)
    ]
    with pytest.raises(RecordingError, match="zero throughout for j2"):
        identify_gains(model, *dead, known=KNOWN)


@pytest.mark.slow
def test_exchanged_runs_settle_on_nothing():
    model, unloaded, loaded = runs(0.05, gains=GAINS)
    with pytest.raises(SolverError, match="exchanged"):
        identify_gains(model, unloaded, loaded, known=KNOWN)


real = pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)


@pytest.mark.slow
@real
def test_the_ur10es_gains_lie_between_the_published_ones():
    problem, loaded, unloaded = ur10e_runs((1.0,) * 6)
    found = identify_gains(problem.model, loaded, unloaded, known={"load.m": 2.805})
    low = np.array([10.0, 10.6956, 8.4566, 9.0029, 9.48, 10.1232])
    high = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])
    assert (low < found.gains).all()
    assert (found.gains < high).all()
    # The first axis is vertical: it never feels the weight that fixes the scale.
    relative = found.standard_errors / found.gains
    assert relative.argmax() == 0
    assert relative[1:].max() < 0.03


@pytest.mark.slow
@real
def test_gains_from_one_load_weigh_the_other_of_the_ur10e(tmp_path):
    problem, loaded, unloaded = ur10e_runs((1.0,) * 6)
    known = identify_gains(problem.model, loaded, unloaded, known={"load.m": 2.805})
    gains = known.gains
    other = [
        _moving(file, gains, tmp_path)
        for file in (
            "payload/ur-20_02_19_15harm50secLoad.parquet",
            "identification/ur-20_02_19_15harm50sec.parquet",
        )
    ]
    found = identify_payload(problem.model, *other, constraints=problem.constraints)
    # The mass is known to 2.805 kg; the published gains say 2.34 and 3.04 kg.
    assert found.free.mass == pytest.approx(2.805, abs=0.03)
    # Residuals are correlated: errors are several times those of white noise.
    assert abs(found.free.mass - 2.805) < found.standard_errors[0] < 0.125
    assert found.body.mass == pytest.approx(2.805, abs=0.03)
    assert "assumed to be exact" in found.condition
    stated = identify_payload(
        problem.model,
        *other,
        constraints=problem.constraints,
        gain_errors=known.relative_errors,
    )
    error = stated.standard_errors[0]
    assert found.standard_errors[0] < error < 0.2
    assert abs(stated.free.mass - 2.805) < 2.0 * error
    assert "uncertain by" in stated.condition


def _moving(file, gains, folder):
    """A run without its first rows, of which one is garbage, and standstill."""
    import pyarrow.parquet as pq

    table = pq.read_table(os.environ["CONSISTENT_ID_DATASETS"] + "/ur10e/" + file)
    copy = folder / "rows.parquet"
    pq.write_table(table.slice(6), copy)
    _, log = prepared(copy, gains)
    moving = np.flatnonzero(abs(log.velocity).max(axis=1) > 0.05)
    return log.samples(slice(moving[0], moving[-1]))


@pytest.mark.slow
def test_gains_scatter_as_much_more_as_the_noise_is_correlated(monkeypatch):
    seen = []
    monkeypatch.setattr(
        gains, "correlation_length", lambda left, _: seen.append(left) or 4.0
    )
    monkeypatch.setattr(gains, "_spread", lambda _: np.eye(len(GAINS)))
    found = _found(0.0)
    # Residuals of the current, of both runs with their own bodies: there is no noise.
    assert max(abs(part).max() for part in seen[0]) < 1e-6
    assert found.correlation == 4.0
    np.testing.assert_array_equal(found.covariance, 4.0 * np.eye(len(GAINS)))


def test_slopes_over_gains_are_orthogonal_to_what_parameters_fit():
    rng = np.random.default_rng(0)
    joint = np.repeat([0, 1], 6)
    A, known, current = rng.normal(size=(12, 3)), rng.normal(size=12), np.ones(12)
    rows = gains.Currents(A, known, current, joint)
    log_gains, noise = np.array([0.4, -1.0]), np.array([0.1, 3.0])
    fit = rows.at(log_gains, noise)
    scale = np.exp(log_gains)[joint] * noise[joint]
    weighted, b = A / scale[:, None], current / noise[joint] - known / scale
    np.testing.assert_allclose(fit.x, np.linalg.lstsq(weighted, b, rcond=None)[0])
    np.testing.assert_allclose(fit.residual, weighted @ fit.x - b)
    step = 1e-6 * np.eye(2)
    slopes = [
        (
            (A @ fit.x + known) / (np.exp(log_gains + d)[joint] * noise[joint])
            - (A @ fit.x + known) / (np.exp(log_gains - d)[joint] * noise[joint])
        )
        / 2e-6
        for d in step
    ]
    np.testing.assert_allclose(fit.raw, np.transpose(slopes), rtol=1e-6, atol=1e-6)
    Q = np.linalg.qr(weighted)[0]
    np.testing.assert_allclose(fit.jacobian, fit.raw - Q @ (Q.T @ fit.raw), atol=1e-12)


def test_gains_and_noise_are_most_likely_together():
    """Noise of all degrees of freedom, and no slope of the misfit that is left."""
    rng = np.random.default_rng(1)
    joint = np.repeat([0, 1], [30, 60])
    A, known = rng.normal(size=(90, 3)), rng.normal(size=90)
    noise = np.array([0.1, 0.6])[joint] * rng.normal(size=90)
    current = (A @ [1.0, -2.0, 0.5] + known) / np.array([2.0, 5.0])[joint] + noise
    rows = gains.Currents(A, known, current, joint)
    regression = SimpleNamespace(
        counts=(30, 60),
        torque_rms=np.sqrt(np.bincount(joint, current**2) / [30, 60]),
    )
    found = gains.most_likely_gains(rows, regression, np.array([3.0, 3.0]))
    assert np.exp(found.log_gains) == pytest.approx([2.0, 5.0], rel=0.2)
    squares = np.bincount(joint, found.fit.residual**2) / [30, 60]
    assert squares == pytest.approx([1.0 - 5.0 / 90.0] * 2, rel=1e-3)
    assert abs(found.fit.jacobian.T @ found.fit.residual).max() < 1e-2
