"""A joint at rest: friction may hold any torque up to breakaway, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from logged import DRIVE, URDF, moved
from some_fast import some_fast

from consistent_id import (
    DriveTerms,
    InertialParameters,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    differentiated,
    simulate_torque,
)
from consistent_id.estimation.estimate import torque_errors
from consistent_id.estimation.torque_error import BREAKAWAY, beyond_friction, holding
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.robot import load_urdf
from consistent_id.signals import altered, low_passed

COULOMB = 1.5  # N m, of the elbow; see FRICTION of `logged`


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(URDF)
    return TorqueModel(load_urdf(file), DRIVE)


@pytest.fixture(scope="module")
def log(arm):
    return differentiated(moved(arm))


def at_rest(model, log, joint, held):
    """The log with one joint still at 0.3 rad, friction holding a torque there."""
    return altered(log, lambda raw: _at_rest(model, raw, joint, held))


def _at_rest(model, log, joint, held):
    position, velocity, acceleration = (
        np.array(x) for x in (log.position, log.velocity, log.acceleration)
    )
    position[:, joint], velocity[:, joint], acceleration[:, joint] = 0.3, 0.0, 0.0
    still = replace(
        log, position=position, velocity=velocity, acceleration=acceleration
    )
    robot = model.robot
    drive = {"viscous": [2.0, 1.0], "coulomb": [3.0, COULOMB], "offset": [0.5, -0.3]}
    x = np.append(robot.nominal, np.zeros(len(model.layout) - 20))
    for term, values in drive.items():
        if model.layout.drive_indices(term):
            x[list(model.layout.drive_indices(term))] = values
    torque = np.array(simulate_torque(model, x, still).torque)
    torque[:, joint] += held
    return replace(still, torque=torque)


def fitted(model, recording):
    return constrained_least_squares(model, build_regression(model, recording))


def kinds(verdict):
    return [reason.kind for reason in verdict.grounds]


def test_in_motion_errors_are_errors_and_at_rest_less_what_friction_holds(arm, log):
    velocity = np.zeros_like(log.velocity)
    velocity[:100] = 1.0  # fifty times the width of the sign change
    error = np.full(velocity.shape, 1.2)
    left = beyond_friction(arm, log.position, velocity, error, np.array([0.5, np.nan]))
    np.testing.assert_allclose(left[:100], 1.2)
    np.testing.assert_allclose(left[100:], [[0.7, 0.0]] * (len(left) - 100))


@pytest.mark.slow
def test_the_error_on_a_filtered_recording_of_one_row_is_a_number(arm, log):
    """So short a recording comes of a log whose clock counts another unit."""
    whole = replace(log, torque_filter=None)
    short = low_passed(replace(whole, time=1e-3 * log.time), torque_cutoff=2.0)
    assert len(motion_of(arm, short, None).torque) == 1
    (error,) = torque_errors([fitted(arm, log)], short)
    assert error.rms.shape == (2,) and np.isfinite(error.rms).all()
    assert (error.beyond <= error.rms).all()


def test_what_friction_holds_is_its_level_or_a_share_of_the_drive_s_effort(arm):
    x = np.zeros(len(arm.layout))
    x[list(arm.layout.drive_indices("coulomb"))] = [0.5, 1.0]
    np.testing.assert_allclose(
        holding(arm, x, np.array([0.9, 0.01])), [0.5, BREAKAWAY * 60.0]
    )
    frictionless = TorqueModel(arm.robot, DriveTerms(viscous=True))
    x = np.zeros(len(frictionless.layout))
    np.testing.assert_array_equal(holding(frictionless, x, np.full(2, np.nan)), 0.0)


def test_a_joint_that_never_moved_is_named_and_its_held_torque_refuses_nothing(
    arm, log
):
    # The elbow's axis stands nearly upright: what it carries is little.
    recording = at_rest(arm, log, 1, held=-4.0)
    verdict = fitted(arm, recording).verdict
    assert verdict.word == "use with care"
    (reason,) = [r for r in verdict.reasons if r.kind == "joint at rest"]
    assert "elbow hardly moved" in reason.statement
    assert "torque sign" not in kinds(verdict)


@pytest.mark.slow
@pytest.mark.parametrize("held", some_fast([20.0, 0.0, -20.0]))
def test_a_reversed_torque_is_found_at_rest_where_gravity_outweighs_friction(
    arm, log, held
):
    # Six times as heavy, gravity is 107 N m there; the drive's friction can hold 22.5.
    links = tuple(
        replace(link, nominal=InertialParameters(6.0 * link.nominal.vector))
        for link in arm.robot.links
    )
    # With an offset, what is constant would not be gravity's.
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)
    heavy = TorqueModel(replace(arm.robot, links=links), drive)
    recording = at_rest(heavy, log, 0, held)
    good = fitted(heavy, recording).verdict
    assert "torque sign" not in kinds(good)
    reversed_ = altered(
        recording, lambda raw: replace(raw, torque=raw.torque * [-1.0, 1.0])
    )
    bad = fitted(heavy, reversed_).verdict
    assert bad.word == "do not use"
    assert "torque sign" in kinds(bad)


@pytest.mark.slow
def test_a_joint_held_while_others_are_tested_is_no_error_within_its_friction(arm, log):
    good = fitted(arm, log)
    within, beyond = (
        compare([good], [at_rest(arm, log, 1, held)]).reports[0].validation[0]
        for held in (1.4, 30.0)
    )
    assert within.relative[1] > 0.3
    assert within.beyond[1] < 0.3 * within.rms[1]
    assert beyond.beyond[1] == pytest.approx(beyond.rms[1] - COULOMB, rel=0.05)
    said = [
        kinds(compare([good], [at_rest(arm, log, 1, held)]).reports[0].verdict)
        for held in (1.4, 30.0)
    ]
    assert ["held-out error" in one for one in said] == [False, True]
