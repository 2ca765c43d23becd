"""Feet that slip, seen from the rates of a base and of joints."""

from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import CORNERS, FEET, FOOT, quadruped_text

import consistent_id as ci

SAMPLES = 40


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text(hips=CORNERS))
    return ci.robot.load_mjcf(path, base="floating")


@pytest.fixture(scope="module")
def held(robot):
    """Any motion of the trunk, and of the legs what keeps all feet in place."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.5, 0.5, (SAMPLES, 12)) + np.tile([0.0, 0.6, -1.2], 4)
    v, w = rng.uniform(-0.5, 0.5, (2, SAMPLES, 3))
    dq = np.zeros((SAMPLES, 12))
    for leg, foot in enumerate(FEET):
        own = slice(3 * leg, 3 * leg + 3)
        J = ci.regression.contact_jacobian(robot, q, frame=foot, point=FOOT)[:, :3]
        carried = np.einsum("nij,nj->ni", J[:, :, :6], np.hstack([v, w]))
        legs = J[:, :, 6:][:, :, own]
        dq[:, own] = -np.linalg.solve(legs, carried[..., None])[..., 0]
    still = np.zeros((SAMPLES, 3))
    return ci.Recording(
        robot.joint_names,
        0.01 * np.arange(SAMPLES),
        q,
        dq,
        base=ci.recordings.BaseMotion(w, still, still + np.array([0, 0, 9.81])),
        contacts=[
            ci.recordings.ContactFlags(foot, np.ones(SAMPLES, bool), FOOT)
            for foot in FEET
        ],
    )


def test_feet_that_are_held_do_not_slip(robot, held):
    assert ci.regression.contact_slip(robot, held).max() < 1e-10


def test_a_foot_that_slips_is_seen_and_left_out(robot, held):
    faster = held.velocity.copy()
    faster[10:20, 2] += 1.0  # the knee of the first leg, 0.2 m above its foot
    slipping = replace(held, velocity=faster)
    slip = ci.regression.contact_slip(robot, slipping)
    # Against the mean of four, of which it is one: three quarters of 0.2 m/s.
    assert slip[10:20, 0] == pytest.approx(0.15)
    assert slip[10:20, 1:] == pytest.approx(0.05)
    assert slip[:10].max() < 1e-10
    certain = ci.regression.without_slip(robot, slipping, 0.1).contacts[2].certain
    assert np.flatnonzero(~certain).tolist() == list(range(10, 20))


def test_an_open_contact_may_move(robot, held):
    faster = held.velocity.copy()
    faster[:, 2] += 1.0
    lifted = replace(held.contacts[0], closed=np.zeros(SAMPLES, bool))
    log = replace(held, velocity=faster, contacts=(lifted, *held.contacts[1:]))
    assert ci.regression.contact_slip(robot, log).max() < 1e-10


def test_what_is_missing_is_named(robot, held):
    with pytest.raises(ci.RecordingError, match="velocity, base motion and contacts"):
        ci.regression.contact_slip(robot, replace(held, velocity=None))
    with pytest.raises(ci.ProblemError, match="positive"):
        ci.regression.without_slip(robot, held, 0.0)


def test_of_a_single_closed_contact_no_slip_is_known(robot, held):
    faster = held.velocity.copy()
    faster[:, 2] += 1.0
    others = [replace(c, closed=np.zeros(SAMPLES, bool)) for c in held.contacts[1:]]
    log = replace(held, velocity=faster, contacts=(held.contacts[0], *others))
    assert ci.regression.contact_slip(robot, log).max() < 1e-10


def test_the_speed_of_a_surface_is_that_of_its_point(robot, held):
    moved = replace(held, velocity=held.velocity + np.linspace(0.1, 1.0, 12))
    feet = moved.contacts
    flat = replace(moved, contacts=(replace(feet[0], surface=True), *feet[1:]))
    found = ci.regression.contact_slip(robot, flat)
    assert found.max() > 0.01
    np.testing.assert_array_equal(found, ci.regression.contact_slip(robot, moved))
