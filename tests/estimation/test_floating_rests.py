"""Torque errors and robust estimates of floating bases whose joints rest."""

from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci
from consistent_id.estimation.estimate import torque_errors

THREE = np.array([[i != j for j in range(4)] for i in range(4)] * 50)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    drive = ci.DriveTerms(coulomb="tanh", velocity_scale=0.5)
    return ci.TorqueModel(ci.robot.load_mjcf(path, base="floating"), drive)


@pytest.fixture(scope="module")
def log(model):
    """Three feet on the ground, and joints so slow that friction may hold them."""
    whole = standing(model.robot, THREE, noise=0.1)
    return replace(whole, velocity=0.1 * whole.velocity)


@pytest.mark.slow
@pytest.mark.parametrize("measured", [True, False])
def test_errors_of_a_floating_base_whose_joints_rest_are_found(model, log, measured):
    used = log if measured else replace(log, wrenches=())
    base = ci.regression.contact_free_base(model, used.contacts)
    found = ci.least_squares(model, ci.build_regression(model, used), base=base)
    (error,) = torque_errors([found], used)
    # Friction can hold joints, never the base.
    assert error.beyond[:6] == pytest.approx(error.rms[:6])
    assert (error.beyond <= error.rms * (1 + 1e-12)).all()
    assert (error.beyond[6:] < error.rms[6:]).any() == measured


@pytest.mark.slow
def test_the_scale_of_a_robust_fit_is_of_rows_that_count(model, log):
    """Most torques of a joint are unknown; of the others the noise is what it is."""
    rng = np.random.default_rng(0)
    known = np.ones((len(log), 12), dtype=bool)
    known[:, 3] = rng.random(len(log)) < 0.3
    used = replace(log, wrenches=(), torque_known=known)
    base = ci.regression.contact_free_base(model, used.contacts)
    enough = {"base": base, "tolerance": 0.01}  # for scales that are compared
    whole = ci.huber(model, replace(used, torque_known=None), **enough)
    part = ci.huber(model, used, **enough)
    assert part.certificate.verdict == "certified"
    assert part.sigma[9] == pytest.approx(whole.sigma[9], rel=0.5)
