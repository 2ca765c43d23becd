"""A base that leans, beside gains, which look like it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.alternatives import (
    gravity_in,
    leaning_findings,
    turned_gravity,
)
from consistent_id.diagnosis.torque_parts import torque_parts
from consistent_id.robot.model import Link

_DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)


def _arm(angle=0.0):
    """Return two level joints on a base that leans by an angle about them."""
    rows = [DHRow(0, 0), DHRow(0, 0.4)]
    robot = from_modified_dh("two links", rows)
    gravity = 9.81 * np.array([-np.cos(angle), np.sin(angle), 0.0])
    bodies = [
        InertialParameters.from_central(m, [0.2, 0.01, 0.0], 0.02 * np.eye(3))
        for m in (6.0, 3.0)
    ]
    links = (
        Link(link.name, body) for link, body in zip(robot.links, bodies, strict=True)
    )
    return TorqueModel(replace(robot, links=tuple(links), gravity=gravity), _DRIVE)


def _log(model, gain=1.0):
    rng = np.random.default_rng(0)
    time = np.arange(2400) / 100.0
    omega = 2 * np.pi * rng.uniform(0.05, 0.6, (2, 4))[..., None]
    angle = omega * time + rng.uniform(0, 6, (2, 4))[..., None]
    q = 0.3 * np.sin(angle).sum(axis=1).T
    dq = 0.3 * (omega * np.cos(angle)).sum(axis=1).T
    ddq = -0.3 * (omega**2 * np.sin(angle)).sum(axis=1).T
    motion = Recording(model.robot.joint_names, time, q, dq, ddq)
    friction = np.tile([1.0, 2.0, 0.0], 2)
    parameters = np.append(np.asarray(model.robot.nominal), friction)
    log = simulate_torque(model, parameters, motion)
    noise = 0.05 * rng.normal(size=log.torque.shape)
    return replace(log, torque=gain * (log.torque + noise))


@pytest.mark.parametrize("degrees", [-40.0, 30.0, 120.0])
def test_gravity_is_found_in_the_direction_with_which_the_log_was_made(degrees):
    leaning = _arm(np.radians(degrees))
    turned = turned_gravity(_arm(), _log(leaning))
    np.testing.assert_allclose(turned, leaning.robot.gravity, atol=0.05)
    assert turned_gravity(leaning, _log(leaning)) is None


@pytest.mark.parametrize("size", [0.85, 1.3])
def test_the_log_tells_the_direction_and_the_model_the_size(size):
    """Which is a gain, or masses."""
    leaning = _arm(np.radians(30.0))
    log = _log(leaning)
    turned = turned_gravity(_arm(), replace(log, torque=size * log.torque))
    np.testing.assert_allclose(turned, leaning.robot.gravity, atol=0.06)


@pytest.mark.parametrize(
    ("degrees", "gain"), [(3.0, 1.0), (30.0, 0.6), (30.0, 1.5), (30.0, -1.0)]
)
def test_a_floor_that_is_not_level_and_what_is_no_gravity_are_left(degrees, gain):
    log = _log(_arm(np.radians(degrees)))
    turned = turned_gravity(_arm(), replace(log, torque=gain * log.torque))
    # Torque that is reversed is gravity of its size, in the opposite direction.
    assert (turned is None) == (gain > 0.0)


@pytest.mark.slow
def test_a_nominal_robot_that_explains_as_little_when_it_leans_does_not_lean():
    log, model = _log(_arm(np.radians(30.0))), _arm()
    (finding,) = leaning_findings(model, log, torque_parts(model, log))
    assert finding.score > 1.0
    rng = np.random.default_rng(1)
    noise = 0.8 * log.torque.std() * rng.normal(size=log.torque.shape)
    noisy = replace(log, torque=log.torque + noise)
    assert turned_gravity(model, noisy) is not None
    assert leaning_findings(model, noisy, torque_parts(model, noisy)) == []


@pytest.mark.slow
def test_a_base_that_leans_is_no_gain_and_a_gain_no_base_that_leans():
    model = _arm()
    found = diagnose(model, _log(_arm(np.radians(35.0)))).faults
    assert {f.kind for f in found} <= {"gravity", "offset zero"}
    assert found
    scaled = _log(model, gain=0.7)
    assert leaning_findings(model, scaled, torque_parts(model, scaled)) == []
    assert [f.kind for f in diagnose(model, scaled).faults] == ["torque gain"]


@pytest.mark.slow
def test_how_a_robot_is_mounted_is_a_fault_where_training_shows_it():
    """What validation alone shows is a warning: no estimate is fitted to it."""
    model = _arm()
    upright, hung = (_log(_arm(angle)) for angle in (0.0, 2.0))
    hung = replace(hung, name="hung")
    assert "gravity" in {f.kind for f in diagnose(model, hung).faults}
    found = diagnose(model, upright, [hung])
    (gravity,) = (f for f in found.findings if f.kind == "gravity")
    assert gravity.severity == "warning" and gravity.recording == "hung"
    assert "no training recording shows it" in gravity.statement


def test_the_option_that_is_printed_is_the_gravity_of_the_log():
    upright, leaning = _arm(), _arm(np.radians(30))
    log = _log(leaning)
    (found,) = leaning_findings(upright, log, torque_parts(upright, log))
    option = re.search(r"--gravity ([-\d. ]+)\)", str(found))[1]
    np.testing.assert_allclose(
        [float(word) for word in option.split()], leaning.robot.gravity, atol=0.05
    )


def other_bodies(model, seed):
    """The robot with bodies as far from its own as designers' usually are."""
    rng, links = np.random.default_rng(seed), []
    for link in model.robot.links:
        body = link.nominal
        moved = InertialParameters.from_central(
            body.mass, body.com * rng.uniform(0.85, 1.15, 3), body.central_inertia
        )
        links.append(replace(link, nominal=moved))
    return replace(model, robot=replace(model.robot, links=tuple(links)))


def degrees_between(one, other):
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


@pytest.mark.parametrize("seed", range(3))
def test_gravity_settles_beside_free_bodies(seed):
    """That which fits wrong nominal bodies best is farther off."""
    leaning, nominal = _arm(np.radians(35.0)), other_bodies(_arm(), seed)
    log = _log(leaning)
    true = np.asarray(leaning.robot.gravity)
    settled = degrees_between(turned_gravity(nominal, log), true)
    assert settled < 0.5
    assert settled < 0.5 * degrees_between(gravity_in(nominal, log), true)
