"""Stribeck friction whose coefficient no row determines."""

from types import SimpleNamespace

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.problems.file import DriveTable, JointTable, PreparationTable
from consistent_id.problems.study import Study
from consistent_id.rollout.faded_friction import (
    hidden_friction,
    hidden_notes,
    without_slow_friction,
    without_stribeck,
)

DRIVE = DriveTable(viscous=True, coulomb="tanh", stribeck_velocity=0.09)
JOINTS = ("slow", "fast", "plain")
OWN = {
    "fast": JointTable(stribeck_velocity=0.3, stribeck_exponent=1.5),
    "plain": JointTable(stribeck_velocity=0.0),
}


def test_velocities_near_the_least_of_rows_are_left_out():
    rested = PreparationTable(least_joint_speed=0.05)
    kept = without_slow_friction(rested, DRIVE, OWN, JOINTS)
    assert kept["slow"].stribeck_velocity == kept["slow"].stribeck_exponent == 0.0
    assert {name: kept[name] for name in OWN} == OWN
    # Twice the least speed is enough; an own velocity goes before that of all joints.
    slower = PreparationTable(least_joint_speed=0.045)
    assert without_slow_friction(slower, DRIVE, OWN, JOINTS) == OWN
    faster = PreparationTable(least_joint_speed=0.2)
    kept = without_slow_friction(faster, DRIVE, OWN, JOINTS)
    assert kept["fast"].stribeck_exponent == 0.0 and kept["plain"] == OWN["plain"]


@pytest.mark.parametrize("slowest", [None, "estimated"])
def test_all_rows_show_it(slowest):
    every = PreparationTable(least_joint_speed=slowest)
    assert without_slow_friction(every, DRIVE, OWN, JOINTS) == OWN


def study_of(speed):
    """A joint that is never slower than a speed, with a Stribeck velocity of 0.1."""
    arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    drive = ci.DriveTerms(viscous=True, coulomb="sign", stribeck_velocity=0.1)
    model = ci.TorqueModel(arm, drive)
    rng = np.random.default_rng(1)
    q, ddq = rng.normal(size=(2, 200, 1))
    dq = rng.choice([-1.0, 1.0], size=(200, 1)) * rng.uniform(speed, 1.0, (200, 1))
    motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]
    log = ci.simulate_torque(model, [*body, 0.4, 0.5, 0.3], motion)
    regression = ci.build_regression(model, log)
    return SimpleNamespace(problem=SimpleNamespace(model=model), regression=regression)


def test_what_rows_do_not_show_is_found_in_the_rows():
    assert hidden_friction(study_of(0.02)) == ()
    assert hidden_friction(study_of(0.25)) == ("joint1",)
    (said,) = hidden_notes(("joint1",))
    assert said.startswith("Stribeck friction of joint1 is left out")
    assert hidden_notes(()) == ()
    made = without_stribeck(OWN, ("fast", "slow"))
    assert made["fast"].stribeck_velocity == made["slow"].stribeck_velocity == 0.0
    assert made["plain"] == OWN["plain"]


def test_a_model_without_such_friction_is_not_asked():
    study = study_of(0.25)
    plain = ci.TorqueModel(study.problem.model.robot, ci.DriveTerms(viscous=True))
    assert hidden_friction(SimpleNamespace(problem=SimpleNamespace(model=plain))) == ()


@pytest.mark.slow
def test_a_rollout_leaves_out_what_its_rows_do_not_show(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    from commanded_leg import PROBLEM, write_leg

    from consistent_id.rollout import problem_rollout

    write_leg(tmp_path)
    more = PROBLEM.replace("[constraints]", "stribeck_velocity = 0.4\n[constraints]")
    (tmp_path / "problem.toml").write_text(more)
    monkeypatch.setattr(problem_rollout, "hidden_friction", lambda study: ("knee",))
    study = Study(ci.load_problem(tmp_path))
    done = problem_rollout.rollout_of(study, choose=True)
    assert "Stribeck friction of knee is left out" in done.notes[-1]
    assert "knee.stribeck" not in done.estimate.model.layout.names
    stated = problem_rollout.rollout_of(study)  # as it is stated
    assert "knee.stribeck" in stated.estimate.model.layout.names
    assert not stated.notes
