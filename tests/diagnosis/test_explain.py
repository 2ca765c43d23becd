"""What a log leaves unexplained, beside what laws of friction always leave."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from faulty_logs import DRIVE

from consistent_id import (
    DHRow,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.corrections import LOOKS_ALIKE, Cause, corrections
from consistent_id.diagnosis.explain import (
    Explanation,
    Explanations,
    _of_friction,
    corrected,
    datasheet_constraints,
    fitted_log,
    unexplained_findings,
)
from consistent_id.regression.base import base_parameters
from consistent_id.robot.model import Link

FRICTION = np.array([1.0, 2.0, 0.0])  # viscous, coulomb, offset


def _swing(inertia):
    """Return a level joint with a body [kg m^2], and its log: friction has a ripple."""
    robot = from_modified_dh("pan", [DHRow(0, 0)])
    body = InertialParameters.from_central(5.0, [0.0, 0.0, 0.0], inertia * np.eye(3))
    links = tuple(Link(link.name, body) for link in robot.links)
    model = TorqueModel(replace(robot, links=links), DRIVE)
    time = np.arange(3000) / 100.0
    omega, phase = 2 * np.pi * np.array([[0.13], [0.29], [0.47]]), [[0.0], [1.0], [2.0]]
    q = (0.6 * np.sin(omega * time + phase)).sum(axis=0)
    dq = (0.6 * omega * np.cos(omega * time + phase)).sum(axis=0)
    ddq = (-0.6 * omega**2 * np.sin(omega * time + phase)).sum(axis=0)
    states = (x[:, None] for x in (q, dq, ddq))
    motion = Recording(model.robot.joint_names, time, *states)
    rubbed = simulate_torque(model, np.append(np.zeros(10), FRICTION), motion).torque
    whole = np.append(np.asarray(model.robot.nominal), FRICTION)
    torque = simulate_torque(model, whole, motion).torque
    torque = torque + 0.14 * np.sin(9.0 * motion.position) * rubbed
    noise = 0.02 * np.random.default_rng(0).normal(size=torque.shape)
    return model, replace(motion, torque=torque + noise), rubbed


def _fitted(model, log):
    base = base_parameters(model)
    return fitted_log(model, log, datasheet_constraints(model), base)


@pytest.mark.parametrize("inertia", [0.01, 1.0, 10.0])
def test_the_share_of_friction_is_that_with_which_the_log_was_made(inertia):
    model, log, rubbed = _swing(inertia)
    share = np.linalg.norm(rubbed) / np.linalg.norm(log.torque)
    assert _fitted(model, log).friction == pytest.approx(min(share, 1.0), abs=0.03)


@pytest.mark.slow
def test_friction_that_varies_is_no_other_robot():
    model, log, _ = _swing(0.01)
    assert _fitted(model, log).misfit > 0.08
    assert diagnose(model, log).of("model does not explain") == ()
    # As much beside a torque that bodies make is not friction's.
    model, log, _ = _swing(3.0)
    ripple = 0.14 * np.std(log.torque) * np.sin(9.0 * log.position)
    odd = replace(log, torque=log.torque + ripple)
    assert diagnose(model, odd).of("model does not explain") != ()


def test_a_width_of_friction_is_no_scale_of_the_position():
    """A log with friction 1.25 times as wide as the model's is no encoder's fault."""
    model, log, _ = _swing(0.01)
    wide = replace(DRIVE, velocity_scale=1.25 * DRIVE.velocity_scale)
    truth = np.append(np.asarray(model.robot.nominal), FRICTION)
    made = simulate_torque(TorqueModel(model.robot, wide), truth, log)
    as_is = _fitted(model, made)
    every = corrections(model.robot, model.torque_joints)
    scales = [c for c in every if c.cause.excuse == LOOKS_ALIKE]
    assert as_is.misfit > 0.005
    # Only the width is off: no scale explains what the width does.
    left = [c.factors.least_misfit() for c in corrected(as_is, scales)]
    assert min(left, default=1.0) > 0.9 * as_is.misfit


def test_a_misfit_is_as_sure_as_stretches_of_the_log_agree_on_it():
    model, log, _ = _swing(3.0)
    motion = _fitted(model, log)
    truth = simulate_torque(model, motion.fit.parameters, log).torque
    steady = 0.1 * np.std(truth) * np.where(np.arange(len(log)) % 2, 1.0, -1.0)
    # In all stretches alike: the misfit is what it is.
    spread = replace(motion, recording=replace(log, torque=truth + steady[:, None]))
    rms = np.sqrt(np.mean((truth + steady[:, None]) ** 2))
    assert spread.least_likely == pytest.approx(0.1 * np.std(truth) / rms, rel=0.01)
    # In one of twenty alone: by chance it might as well have been in none.
    once = np.where(np.arange(len(log)) < len(log) // 20, steady, 0.0)[:, None]
    rare = replace(motion, recording=replace(log, torque=truth + once))
    assert rare.least_likely == 0.0


def test_what_helps_most_is_said_first_with_its_option():
    def tried(statement, advice, misfit):
        cause = Cause("kind", "all joints", statement, advice, 3.0, of_residual=True)
        return Explanation(cause, misfit, 0.876)

    found = Explanations(
        (
            tried(
                "with the torque of all joints reversed", "say --torque-gain -1", 0.113
            ),
            tried("with joint_1 in degrees", "say --units deg", 0.6),
        ),
        floor=0.05,
        usual=0.1,
    )
    as_is = SimpleNamespace(
        misfit=0.876,
        least_likely=0.8,
        factors=SimpleNamespace(least_misfit=lambda: 0.09),
    )
    (finding,) = unexplained_findings(as_is, found)
    assert finding.statement.startswith(
        "with the torque of all joints reversed the misfit would be 11.3% instead of "
        "87.6%; no robot with the datasheet's values"
    )
    assert "with joint_1 in degrees the misfit would be 60.0%" in finding.statement
    assert finding.advice.startswith("try this first: say --torque-gain -1. Else check")
    (alone,) = unexplained_findings(as_is, replace(found, tried=()))
    assert alone.statement.startswith("no robot with the datasheet's values")
    assert alone.advice.startswith("check that model and log")


@pytest.mark.parametrize("inertia", [0.01, 1.0, 10.0])
def test_a_joint_s_torque_is_friction_if_its_law_misses_more_than_bodies_are(inertia):
    model, log, rubbed = _swing(inertia)
    share = np.linalg.norm(rubbed) / np.linalg.norm(log.torque)
    assert (share >= 0.85) == (inertia < 1.0)
    assert _fitted(model, log).rubs(model.robot.joint_names[0]) == (share >= 0.85)


def test_joints_that_only_rub_are_not_exchanged_altogether():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.3), DHRow(0, 0.2)])
    names = robot.joint_names
    every = corrections(robot, names)
    as_is = SimpleNamespace(rubs=lambda joint: joint != names[0])
    left_out = [c for c in every if _of_friction(as_is, c)]
    (found,) = left_out  # the first joint carries bodies
    assert (found.fault.kind, found.fault.channels) == ("channel order", "both")
    assert found.where == f"{names[1]}, {names[2]}"
