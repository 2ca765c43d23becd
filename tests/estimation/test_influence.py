"""What a part of the data changes: rows, a joint, and joints that others confirm."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from known_arm import logged

from consistent_id import (
    InertialParameters,
    NonNegativeDrive,
    PhysicalConsistency,
    build_regression,
    constrained_least_squares,
)
from consistent_id.estimation import judge
from consistent_id.estimation.influence import (
    _cross_slopes,
    _determined,
    _elsewhere,
    _lost,
    confirmed_slopes,
    influence,
    least_squares_on,
    without,
)
from consistent_id.estimation.slope_reasons import confirmed_joints, doubtful_joints
from consistent_id.estimation.torque_error import Slopes
from consistent_id.regression.row_structure import random_rows

KNOWN = (PhysicalConsistency(), NonNegativeDrive())
LOAD = InertialParameters.from_central(1.0, [0.1, 0.0, 0.2], 0.005 * np.eye(3))


def estimated(model, log):
    return constrained_least_squares(
        model, build_regression(model, log), constraints=KNOWN
    )


def hidden(log, rows):
    known = np.ones(log.position.shape, dtype=bool)
    known[rows] = False
    return replace(log, torque_known=known)


def changed(estimate, log, **leaving):
    refit = without(estimate, [log], **leaving)
    change = estimate.parameters - refit.parameters
    whole = least_squares_on(estimate, [log])
    return influence(estimate, change, refit.free, whole)


def verdict_on(estimate, log):
    crossed = confirmed_slopes(estimate, [log])
    return judge(replace(estimate.evidence(), crossed=crossed))


@pytest.mark.slow
def test_parameters_that_do_not_move_have_no_influence():
    model, log = logged(0)
    estimate = estimated(model, log)
    refit = without(estimate, [log])
    nothing = influence(estimate, np.zeros(len(model.layout)), refit.free)
    assert (nothing.parameters, nothing.torque) == (0.0, 0.0)
    assert nothing.elsewhere == 0.0
    assert nothing.small


@pytest.mark.slow
def test_what_data_determine_is_spanned_by_orthonormal_combinations():
    model, log = logged(0)
    free = least_squares_on(estimated(model, log), [log])
    size = np.random.default_rng(0).uniform(0.1, 10.0, len(model.layout))
    rows = _determined(free, size)
    np.testing.assert_allclose(rows @ rows.T, np.eye(len(free.base)), atol=1e-9)
    seen = free.base.projection / size  # what they determine, of scaled parameters
    np.testing.assert_allclose(seen @ rows.T @ rows, seen, atol=1e-9 * abs(seen).max())


@pytest.mark.slow
def test_influence_is_the_change_of_a_draw_of_noise():
    # Another draw of the noise moves every parameter by the root of two errors.
    changes = []
    for seed in range(6):
        (model, one), (_, other) = (
            logged(3, noise=0.05),
            logged(3, noise=0.05 + 1e-9 * seed),
        )
        rng = np.random.default_rng(seed)
        other = replace(
            other, torque=other.torque + 0.05 * rng.normal(size=other.torque.shape)
        )
        estimate = estimated(model, one)
        first = without(estimate, [one])
        second = without(estimated(model, other), [other])
        change = second.parameters - first.parameters
        found = influence(estimate, change, first.free)
        changes.append((found.parameters, found.torque))
    assert np.mean(changes) == pytest.approx(1.0, abs=0.35)


@pytest.mark.slow
def test_a_few_right_rows_change_less_than_an_error_and_wrong_ones_more():
    model, log = logged(1)
    rows = slice(300, 315)
    assert changed(estimated(model, log), hidden(log, rows)).small
    torque = log.torque.copy()
    torque[rows] += 20.0
    spoilt = replace(log, torque=torque)
    found = changed(estimated(model, spoilt), hidden(spoilt, rows))
    assert not found.small
    assert found.largest > 3.0


@pytest.mark.slow
def test_what_only_the_part_determines_is_not_small():
    # Others determine the bodies; the joint's own friction is lost with its torque.
    model, log = logged(1)
    found = changed(estimated(model, log), log, joints=model.torque_joints[1:2])
    assert found.largest < 1.0
    assert found.elsewhere > 3.0
    assert not found.small


def test_without_all_joints_there_is_no_estimate():
    model, log = logged(0)
    assert without(estimated(model, log), [log], joints=model.torque_joints) is None


@pytest.mark.slow
def test_joints_without_rows_of_their_own_have_no_slopes():
    # As base.ny of a robot on its feet: its rows belong to several joints.
    model, log = logged(0)
    known = np.ones(log.position.shape, dtype=bool)
    known[:, 1] = False
    unknown = replace(log, torque_known=known)
    joint = model.torque_joints[1:2]
    assert _cross_slopes(estimated(model, log), [unknown], joint) is None


@pytest.mark.slow
def test_joints_that_show_a_load_are_confirmed_by_the_others():
    model, log = logged(5, load=LOAD)
    estimate = estimated(model, log)
    doubtful = doubtful_joints(estimate.fit)
    assert doubtful
    crossed = confirmed_slopes(estimate, [log])
    assert doubtful == ("joint3", "joint4")
    assert confirmed_joints(crossed) == ("joint3",)
    assert "nominal model" in [r.kind for r in estimate.verdict.grounds]
    verdict = verdict_on(estimate, log)
    (doubt,) = [r for r in verdict.grounds if r.kind == "nominal model"]
    assert "joint3" not in doubt.statement.split(";")[0]
    note = [r for r in verdict.reasons if r.kind == "nominal model"][1]
    assert "gains are right" in note.statement


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.7, 1.35])
@pytest.mark.parametrize("joint", [1, 2])
def test_a_wrong_gain_of_one_joint_is_not_confirmed(joint, gain):
    model, log = logged(5)
    log = replace(log, torque=log.torque * np.where(np.arange(4) == joint, gain, 1.0))
    estimate = estimated(model, log)
    name = model.torque_joints[joint]
    assert name in doubtful_joints(estimate.fit)
    assert name not in confirmed_joints(confirmed_slopes(estimate, [log]))
    assert "nominal model" in [r.kind for r in verdict_on(estimate, log).grounds]


@pytest.mark.slow
def test_a_wrong_gain_beside_a_load_is_still_doubted():
    model, log = logged(5, load=LOAD)
    log = replace(log, torque=log.torque * [1.0, 1.0, 1.35, 1.0])
    estimate = estimated(model, log)
    crossed = confirmed_slopes(estimate, [log])
    assert model.torque_joints[2] not in confirmed_joints(crossed)
    # Slopes of lines through independent samples, of which bodies explain a share.
    own = replace(model, torque_joints=doubtful_joints(estimate.fit))
    samples = build_regression(own, log).effective
    misses = np.sqrt((1.0 / crossed.explained - 1.0) / samples)
    np.testing.assert_allclose(crossed.errors / crossed.slopes, misses, rtol=1e-9)
    (doubt,) = [
        r for r in verdict_on(estimate, log).grounds if r.kind == "nominal model"
    ]
    assert "that the other joints determine: joint3 1.35" in doubt.statement


def test_slopes_that_bodies_hardly_explain_confirm_nothing():
    ones = np.ones(3)
    crossed = Slopes(("a", "b", "c"), ones, [0.9, 0.2, 0.9], [0.5, 0.5, 0.2], 0.01)
    assert confirmed_joints(crossed) == ("a",)
    for error in (0.07, np.inf):
        assert confirmed_joints(replace(crossed, errors=np.full(3, error))) == ()


@pytest.mark.slow
def test_what_is_lost_counts_by_its_torque_on_random_motions():
    """Parts that data determine are orthogonal, each parameter times its torque."""
    model, log = logged(1)
    estimate = estimated(model, log)
    whole = least_squares_on(estimate, [log])
    others = without(estimate, [log], joints=model.torque_joints[1:2]).free
    rows = random_rows(model)
    size = np.where(rows.norms > 0.0, rows.norms, 1.0)
    assert rows.norms.min() == 0.0  # of bodies that do not turn in all directions

    def onto(free, p):
        B = free.base.projection / size
        return np.linalg.pinv(B) @ (B @ p)

    seen = onto(whole, estimate.parameters * size)
    lost = (seen - onto(others, seen)) / size
    missed = estimate.fit.misfits * rows.rms(estimate.parameters)
    found = influence(estimate, np.zeros(len(size)), others, whole)
    assert found.elsewhere == pytest.approx(max(rows.rms(lost) / missed), rel=1e-6)
    # Whatever the unit of torque.
    again = _lost(1e-3 * rows.norms, estimate.parameters, others, whole)
    felt = rows.norms > 1e-9
    np.testing.assert_allclose(again[felt], lost[felt], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("connected", "fit"), [(True, None), (False, object())])
def test_there_is_no_torque_elsewhere_without_a_fit_or_a_chain(connected, fit):
    robot = SimpleNamespace(connected=connected)
    estimate = SimpleNamespace(model=SimpleNamespace(robot=robot), fit=fit)
    assert np.isnan(_elsewhere(estimate, np.zeros(1), None, None))
