"""The radius of round feet, found in rows free of contact forces."""

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci

PATTERNS = np.array([[i != j for j in range(4)] for i in range(4)] * 150)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    return ci.robot.load_mjcf(path, base="floating")


@pytest.fixture(scope="module")
def known(robot):
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    values = dict(zip(model.layout.names[10:], robot.nominal[10:], strict=True))
    return model, [ci.constraints.FixedParameters(values)]


@pytest.mark.slow
def test_an_offset_is_found_to_half_a_percent_of_it_without_noise(robot, known):
    model, constraints = known
    log = ci.estimation.with_radii(standing(robot, PATTERNS, radius=0.02), 3e-4)
    found = ci.estimation.contact_radius(model, log, constraints=constraints)
    assert found.offset == pytest.approx(-3e-4, rel=5e-3)
    right = ci.estimation.with_radii(log, found.offset)
    assert [f.radius for f in right.contacts] == pytest.approx([0.02] * 4, rel=1e-3)


@pytest.mark.slow
def test_its_standard_error_is_that_of_many_logs(robot, known):
    model, constraints = known
    found = [
        ci.estimation.contact_radius(
            model,
            standing(robot, PATTERNS, noise=0.5, seed=seed, radius=0.02),
            constraints=constraints,
        )
        for seed in range(12)
    ]
    offsets = np.array([one.offset for one in found])
    errors = np.array([one.standard_error for one in found])
    ratio = np.sqrt(np.mean(errors**2) / np.mean(offsets**2))
    assert 2 / 3 < ratio < 3 / 2  # of twelve logs it is known to a fifth


@pytest.mark.slow
def test_what_a_log_does_not_tell_stays_as_it_was_said(robot, known):
    """Of noise that hides all forces the offset is none, a tenth of the radius off."""
    model, constraints = known
    log = standing(robot, PATTERNS[:80], noise=3e4, radius=0.02)
    found = ci.estimation.contact_radius(model, log, constraints=constraints)
    assert abs(found.offset) < 1e-3
    assert found.standard_error == pytest.approx(0.002, rel=0.05)


def test_feet_that_are_points_have_no_radius(robot, known):
    log = standing(robot, PATTERNS[:40])
    with pytest.raises(ci.RecordingError, match="no contact has a radius"):
        ci.estimation.contact_radius(known[0], log)
    assert all(
        flags.radius == 0.0 for flags in ci.estimation.with_radii(log, 1e-3).contacts
    )
