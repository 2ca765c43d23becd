"""Figures of a fit: misfit, floor, shares, slopes and independent samples."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment
from judged_logs import log, model

from consistent_id import (
    DriveTerms,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    huber,
    least_squares,
    low_passed,
    simulate_torque,
)
from consistent_id.estimation import weighted_least_squares
from consistent_id.estimation.fit import _excess, fit_of
from consistent_id.estimation.slope_reasons import slope_reasons
from consistent_id.estimation.torque_error import slopes_on
from consistent_id.regression import GearCoupling, base_parameters
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.signals import altered


@pytest.mark.slow
def test_every_estimator_says_how_well_it_fits():
    arm, _, recording = experiment(1, joints=2, noise=0.05)
    regression = build_regression(arm, recording)
    estimates = (
        least_squares(arm, regression),
        weighted_least_squares(arm, regression),
        huber(arm, recording),
        constrained_least_squares(arm, regression),
    )
    for estimate in estimates:
        by_hand = np.linalg.norm(
            recording.torque - estimate.predict(recording)
        ) / np.linalg.norm(recording.torque)
        assert estimate.fit.misfit == pytest.approx(by_hand, rel=1e-6)
        assert estimate.fit.floor <= estimate.fit.misfit * (1 + 1e-9)


def test_slopes_and_shares_are_those_of_least_squares_on_the_samples():
    arm = TorqueModel(model().robot, DriveTerms(viscous=True))
    estimate = least_squares(arm, build_regression(arm, log()))
    bodies = TorqueModel(model().robot)
    raw = log().torque_filter.source
    nominal = simulate_torque(bodies, model().robot.nominal, raw).torque

    def rows(values):  # five per period of 10 Hz, of 100
        return low_passed(replace(raw, torque=values), torque_cutoff=10.0).torque[::2]

    expected, velocity = rows(nominal), rows(raw.velocity)
    for j in range(2):
        columns = np.column_stack([expected[:, j], velocity[:, j]])
        (slope, _), *_ = np.linalg.lstsq(columns, log().torque[::2, j], rcond=None)
        assert estimate.fit.slopes[j] == pytest.approx(slope, rel=1e-8)
    peak = abs(log().torque).max(axis=0)
    np.testing.assert_allclose(estimate.fit.efforts, peak / [90.0, 60.0])


def test_the_largest_torque_survives_cutting_and_merging():
    from consistent_id.regression import segment_regressions

    parts = segment_regressions(model(), log(), count=7)
    whole = sum(parts[1:], parts[0])
    np.testing.assert_array_equal(whole.peaks, abs(log().torque).max(axis=0))


def test_a_joint_that_rests_and_carries_nothing_has_any_slope():
    """Friction turns a slope of no torque by any amount, and nothing overflows."""
    estimate = least_squares(model(), build_regression(model(), log()))
    fit = replace(
        estimate.fit,
        moving=np.array([0.0, 1.0]),
        expected=np.array([0.0, 1.0]),
        holding=np.array([50.0, 50.0]),
    )
    assert "torque sign" not in [reason.kind for reason in slope_reasons(fit, None)]


def test_a_joint_at_rest_gets_no_boundless_friction():
    rng = np.random.default_rng(2)

    def held(recording):
        return replace(
            recording,
            position=recording.position * [1.0, 0.0],
            velocity=np.column_stack(
                [recording.velocity[:, 0], 1e-9 * rng.normal(size=len(recording))]
            ),
            acceleration=recording.acceleration * [1.0, 0.0],
        )

    still = altered(log(), held)
    estimate = constrained_least_squares(model(), build_regression(model(), still))
    assert abs(estimate["elbow.viscous"]) < 1e5


@pytest.mark.filterwarnings("error")
def test_columns_that_underflow_are_no_drive_terms():
    arm, truth, clean = experiment(0, joints=2, samples=300)
    still = clean.velocity.copy()
    still[:, 1] = 1e-170  # what a filter leaves of a joint at rest
    regression = build_regression(arm, replace(clean, velocity=still))
    free = unconstrained_fit(regression, base_parameters(arm))
    assert np.isfinite(fit_of(arm, free, truth).misfit)


def test_independent_samples_are_counted_for_each_parameter():
    arm, truth, clean = experiment(0, joints=2, samples=300)
    regression = build_regression(arm, clean)
    free = unconstrained_fit(regression, base_parameters(arm))
    spare = fit_of(arm, free, truth).spare
    assert spare * free.solution.rank == pytest.approx(regression.effective.sum())


def test_friction_of_a_gear_coupling_counts_and_offsets_and_rotors_do_not():
    arm, _, log = experiment(0, joints=2, samples=50)
    one, other = arm.robot.joint_names
    assert len({joint.kind for joint in arm.robot.joints}) == 1
    gears = GearCoupling(one, other, viscous=True)
    drives = DriveTerms(rotor_inertia=True, offset=True)
    arm = TorqueModel(arm.robot, drives, couplings=(gears,))
    x = np.append(arm.robot.nominal, [0.1, 3.0, 0.2, -2.0, 0.7])
    assert arm.layout.names[-1].endswith("viscous")
    log = simulate_torque(arm, x, log)
    rubbing = np.where(np.arange(len(x)) == len(x) - 1, x, 0.0)
    states = log.position, log.velocity, log.acceleration
    share = np.linalg.norm(arm.predict(rubbing, *states)) / np.linalg.norm(log.torque)
    free = unconstrained_fit(build_regression(arm, log), base_parameters(arm))
    assert fit_of(arm, free, x).friction_share == pytest.approx(share)


def test_figures_of_a_fit_are_those_of_its_samples():
    arm, truth, log = experiment(3, joints=3, noise=2.0, samples=200)
    assert arm.forces.any() and not arm.forces.all()
    velocity = log.velocity.copy()
    velocity[50:100, 1] = 0.0
    log = replace(log, velocity=velocity)
    regression = build_regression(arm, log).weighted([0.5, 2.0, 4.0])
    base = base_parameters(arm)
    free = unconstrained_fit(regression, base)
    found = fit_of(arm, free, truth)

    def rms(torque):
        return np.sqrt(np.mean(torque**2, axis=0))

    def left(x):
        return log.torque - arm.predict(x, log.position, log.velocity, log.acceleration)

    friction = np.where(np.arange(len(truth)) < 30, 0.0, truth)
    torque, misses = np.linalg.norm(log.torque), left(truth)
    assert found.misfit == pytest.approx(np.linalg.norm(misses) / torque)
    least = left(free.parameters)
    assert found.floor == pytest.approx(np.linalg.norm(least) / torque)
    drive = np.linalg.norm(log.torque - left(friction)) / torque
    assert 0.01 < found.drive_share == pytest.approx(drive)
    rubs = [n.endswith(("viscous", "coulomb")) for n in arm.layout.names]
    rubbing = np.linalg.norm(log.torque - left(np.where(rubs, truth, 0.0))) / torque
    assert found.friction_share == pytest.approx(rubbing)
    assert 0.0 < rubbing < drive
    np.testing.assert_allclose(found.torque, rms(log.torque))
    np.testing.assert_allclose(found.misfits, rms(misses) / rms(log.torque))
    kinds = [log.torque[:, kind] for kind in (arm.forces, ~arm.forces)]
    largest = [rms(kind).max() for kind in kinds]
    sizes = np.where(arm.forces, *largest)
    np.testing.assert_allclose(found.shares, rms(log.torque) / sizes)
    np.testing.assert_allclose(found.moving, [1.0, 0.75, 1.0])
    coulomb = [truth[arm.layout.index(f"j{k}.coulomb")] for k in range(3)]
    np.testing.assert_allclose(found.holding, coulomb)
    weighted = [np.sum((x / [0.5, 2.0, 4.0]) ** 2) for x in (misses, least)]
    rows, rank = 600, len(base)
    excess = np.sqrt(weighted[0] / rows / (weighted[1] / (rows - rank)))
    assert found.excess == pytest.approx(excess)
    assert found.correlation == pytest.approx(rows / regression.effective.sum())


@pytest.mark.parametrize(("rank", "excess"), [(9, np.sqrt(0.1)), (10, np.nan)])
def test_of_as_many_parameters_as_rows_there_is_no_excess(rank, excess):
    regression = SimpleNamespace(counts=(4, 6), sigma=np.array([0.5, 2.0]))
    rms = np.array([1.0, 3.0])
    found = _excess(regression, 5.0 * rms, rms, rank)
    assert found == pytest.approx(5.0 * excess, nan_ok=True)


def test_how_much_nominal_bodies_explain_does_not_depend_on_their_size():
    arm, _, clean = experiment(0, joints=2, samples=300)
    bodies = arm.robot.nominal.ravel()
    light = replace(clean, torque=1e-6 * clean.torque)
    whole, small = (
        slopes_on(arm, build_regression(arm, log), body)
        for log, body in ((clean, bodies), (light, 1e-6 * bodies))
    )
    assert whole.explained.min() > 0.5
    np.testing.assert_allclose(small.explained, whole.explained, rtol=1e-6)
    np.testing.assert_allclose(small.slopes, whole.slopes, rtol=1e-6)
    # Nor on the unit of all rows.
    regression = build_regression(arm, clean)
    faint = replace(regression, factors=tuple(1e-9 * F for F in regression.factors))
    other = slopes_on(arm, faint, bodies)
    np.testing.assert_allclose(other.slopes, whole.slopes, rtol=1e-6)


@pytest.mark.parametrize("drive", [DriveTerms(), DriveTerms(viscous=True, offset=True)])
def test_slopes_are_the_coefficients_of_bodies_beside_drive_terms(drive):
    arm, _, log = experiment(1, joints=3, noise=3.0, samples=200, drive=drive)
    rng = np.random.default_rng(0)
    bodies = arm.robot.nominal * rng.uniform(0.5, 2.0, arm.robot.nominal.shape)
    found = slopes_on(arm, build_regression(arm, log), bodies)
    Y = arm.regressor(log.position, log.velocity, log.acceleration)
    for j, own in enumerate(Y):
        body, terms, torque = bodies @ own[:30], own[30:].T, log.torque[:, j]
        columns = np.column_stack([body, terms])
        x = np.linalg.lstsq(columns, torque)[0]
        rest = torque - columns @ x
        alone = torque - terms @ np.linalg.lstsq(terms, torque)[0]
        left = body - terms @ np.linalg.lstsq(terms, body)[0]
        assert found.slopes[j] == pytest.approx(x[0], rel=1e-8)
        share = 1.0 - rest @ rest / (alone @ alone)
        assert found.explained[j] == pytest.approx(share, rel=1e-8)
        size = np.linalg.norm(left) / np.linalg.norm(torque)
        assert found.expected[j] == pytest.approx(size, rel=1e-8)
