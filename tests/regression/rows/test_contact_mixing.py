"""Rows of which contact forces are taken out, each under its own name."""

from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci
from consistent_id.regression.motion_arrays import motion_of

THREE = [[i != j for j in range(4)] for i in range(4)]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    return ci.robot.load_mjcf(path, base="floating")


@pytest.fixture(scope="module")
def log(robot):
    """On three feet, whose forces are not measured."""
    whole = standing(robot, np.array(THREE * 100), noise=0.1)
    return replace(whole, wrenches=())


@pytest.mark.slow
def test_they_hold_what_the_fewer_rows_without_names_hold(robot, log):
    model = ci.TorqueModel(robot)
    named = ci.build_regression(model, log).stacked()
    few = ci.regression.contact_free_regression(
        ci.regression.contact_free_model(model), log
    ).stacked()
    squares = [R.T @ R for R in (named, few)]
    assert np.allclose(*squares, rtol=0, atol=1e-11 * abs(squares[1]).max())


def test_contact_forces_leave_no_trace(robot, log):
    """Any forces at the feet on the ground, in all 18 rows."""
    rng, model = np.random.default_rng(1), ci.TorqueModel(robot)
    mixing = motion_of(model, log, None).mixing
    acting = np.zeros((len(log), 18))
    for flags in log.contacts:
        J = ci.regression.contact_jacobian(
            robot, log.position, frame=flags.frame, point=flags.point
        )
        push = 50.0 * rng.normal(size=(len(log), 3)) * flags.closed[:, None]
        acting += np.einsum("nij,ni->nj", J[:, :3], push)
    assert abs(acting).max() > 10.0
    assert abs(mixing.mixed(acting)).max() < 1e-10 * abs(acting).max()


def test_the_mixed_rows_of_the_true_parameters_are_the_mixed_torque(robot):
    model = ci.TorqueModel(robot)
    exact = replace(standing(robot, np.array(THREE * 2)), wrenches=())
    motion = motion_of(model, exact, None)
    kept = [np.arange(len(model.layout))] * 18
    ((part, blocks),) = motion.rows(model, kept)
    assert part == slice(0, len(exact)) and abs(motion.torque).max() > 1.0
    for row, block in enumerate(blocks):
        measured, predicted = block[:, -1], block[:, :-1] @ robot.nominal
        np.testing.assert_allclose(measured, motion.torque[:, row], atol=1e-12)
        np.testing.assert_allclose(predicted, measured, atol=1e-9)


def test_contacts_whose_wrenches_are_measured_are_no_unknowns(robot):
    whole = standing(robot, np.array(THREE * 5))
    assert motion_of(ci.TorqueModel(robot), whole, None).mixing is None


def test_predictions_are_of_the_same_rows_as_torque(robot, log):
    model = ci.TorqueModel(robot)
    exact = replace(standing(robot, np.array(THREE * 20)), wrenches=())
    base = ci.regression.contact_free_base(model, exact.contacts)
    found = ci.least_squares(model, ci.build_regression(model, exact), base=base)
    rest = motion_of(model, exact, None).torque - found.predict(exact)
    assert abs(rest).max() < 1e-8
    assert found.score(exact).stacked < 1e-9
    assert found.score(log).stacked > 1e-4


@pytest.mark.slow
def test_degrees_of_freedom_are_counted_once(robot, log):
    """Of 18 rows three feet take nine; counts are what is left, rounded row by row."""
    regression = ci.build_regression(ci.TorqueModel(robot), log)
    assert sum(regression.counts) == pytest.approx(9 * len(log), abs=9)


@pytest.mark.slow
def test_torque_that_is_not_known_gets_into_no_row(robot, log):
    rng, model = np.random.default_rng(2), ci.TorqueModel(robot)
    known = rng.uniform(size=log.position.shape) > 0.2
    wrong = np.where(known, log.torque, 1e3)
    factors = [
        ci.build_regression(model, replace(x, torque_known=known)).stacked()
        for x in (log, replace(log, torque=wrong))
    ]
    squares = [R.T @ R for R in factors]
    assert np.allclose(*squares, rtol=0, atol=1e-9 * abs(squares[0]).max())
    rows = model.torque_joints
    weights = ci.signals.row_weights(log, ~known, rows, others=ci.regression.BASE_ROWS)
    R = ci.build_regression(model, log, row_weights=[weights]).stacked()
    assert np.allclose(R.T @ R, squares[0], rtol=0, atol=1e-9 * abs(squares[0]).max())


def test_rows_of_weight_zero_are_rows_of_unknown_torque(robot, log):
    rng, model = np.random.default_rng(3), ci.TorqueModel(robot)
    part = log.samples(slice(0, 40))
    known = rng.uniform(size=part.position.shape) > 0.2
    rows, others = model.torque_joints, ci.regression.BASE_ROWS
    weights = ci.signals.row_weights(part, ~known, rows, others=others)
    weighted = motion_of(model, part, weights)
    unknown = motion_of(model, replace(part, torque_known=known), None)
    assert (weighted.weights == unknown.weights).all()
    assert np.allclose(weighted.torque, unknown.torque, rtol=0, atol=1e-9)
    assert np.allclose(weighted.shares, unknown.shares, rtol=0, atol=1e-9)
    # Torque of weight zero gets into no other row.
    wrong = replace(part, torque=np.where(known, part.torque, 1e3))
    counted = weights > 0.0
    assert weighted.shares[~counted].max() < 1e-12 < weighted.shares[counted].min()
    rows = motion_of(model, wrong, weights).torque[counted]
    assert np.allclose(rows, weighted.torque[counted], rtol=0, atol=1e-9)


def test_of_a_fixed_base_such_rows_do_not_count():
    arm = ci.from_modified_dh("arm", [ci.DHRow(0, 0), ci.DHRow(-np.pi / 2, 0.3)])
    rng = np.random.default_rng(0)
    q, dq, ddq, torque = rng.normal(size=(4, 50, 2))
    known = np.ones((50, 2), dtype=bool)
    known[:10, 1] = False
    log = ci.Recording(arm.joint_names, 0.01 * np.arange(50), q, dq, ddq, torque)
    model = ci.TorqueModel(arm)
    masked = ci.build_regression(model, replace(log, torque_known=known))
    assert masked.counts == (50, 40)
    with pytest.raises(ci.RecordingError, match="torque_known has shape"):
        replace(log, torque_known=known[:5])


def test_joints_at_rest_have_no_known_torque():
    time = 0.01 * np.arange(400)
    position = np.column_stack([np.sin(3 * time), np.where(time < 2, 0.0, time - 2)])
    log = ci.Recording(("a", "b"), time, position)
    found = ci.signals.without_rests(log, 0.1, reach=0.05)
    assert not found.torque_known[:190, 1].any() and found.torque_known[220:, 1].all()
    # The first joint turns back every pi / 3 seconds.
    slow = abs(3 * np.cos(3 * time)) < 0.09
    assert not found.torque_known[slow, 0].any() and found.torque_known[:, 0].any()


@pytest.mark.slow
def test_the_fewer_rows_hold_no_unknown_torque_either(robot, log):
    rng, model = np.random.default_rng(3), ci.TorqueModel(robot)
    part = replace(log, torque_known=rng.uniform(size=log.position.shape) > 0.2)
    one = ci.regression.contact_free_regression(
        ci.regression.contact_free_model(model), part
    )
    named = ci.build_regression(model, part)
    squares = [R.T @ R for R in (one.stacked(), named.stacked())]
    assert np.allclose(*squares, rtol=0, atol=1e-9 * abs(squares[0]).max())
    assert one.counts[0] == pytest.approx(sum(named.counts), abs=9)
