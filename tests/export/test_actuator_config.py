"""Drives for Isaac Lab and mjlab: the source runs, and says what was identified."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from estimates import random_estimate
from robots import random_robot

from consistent_id import DriveTerms
from consistent_id.export import to_isaac_lab, to_mjlab
from consistent_id.signals import PDGains

DRIVE = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True)
GAINS = PDGains(np.array([20.0, 40.0, 60.0]), 1.5, 30.0)


@pytest.fixture
def estimate():
    rng = np.random.default_rng(4)
    return random_estimate(rng, random_robot(rng, 3)[1], DRIVE)


def run(export, monkeypatch, module, *names):
    """Run a source where its environment is a module that keeps what it is given."""
    fake = ModuleType(module)
    for name in names:
        setattr(fake, name, lambda **given: SimpleNamespace(**given))
    monkeypatch.setitem(
        sys.modules, module.partition(".")[0], ModuleType("environment")
    )
    monkeypatch.setitem(sys.modules, module, fake)
    space = {}
    exec(compile(str(export), "actuators.py", "exec"), space)
    return space["actuators"]


def test_isaac_lab_gets_gains_delay_armature_and_friction(estimate, monkeypatch):
    export = to_isaac_lab(estimate, gains=GAINS, delay=0.0076, allow_refused=True)
    made = run(export, monkeypatch, "isaaclab.actuators", "DelayedPDActuatorCfg")
    drives = made(0.0025)["drives"]
    joints = estimate.model.robot.joint_names
    assert tuple(drives.joint_names_expr) == joints
    assert drives.stiffness == dict(zip(joints, (20.0, 40.0, 60.0), strict=True))
    assert set(drives.damping.values()) == {1.5}
    assert set(drives.effort_limit.values()) == {30.0}
    assert drives.min_delay == drives.max_delay == 3
    for joint in joints:
        assert drives.armature[joint] == estimate[f"{joint}.rotor_inertia"]
        assert drives.viscous_friction[joint] == estimate[f"{joint}.viscous"]
        assert drives.friction[joint] == estimate[f"{joint}.coulomb"]
        assert drives.dynamic_friction[joint] == estimate[f"{joint}.coulomb"]


def test_mjlab_gets_gains_and_delay(estimate, monkeypatch):
    export = to_mjlab(estimate, gains=GAINS, delay=0.01, allow_refused=True)
    names = ("BuiltinPositionActuatorCfg", "DelayedActuatorCfg")
    drives = run(export, monkeypatch, "mjlab.actuator", *names)(0.005)
    assert [d.base_cfg.stiffness for d in drives] == [20.0, 40.0, 60.0]
    assert {d.delay_min_lag for d in drives} == {d.delay_max_lag for d in drives} == {2}
    assert [d.base_cfg.target_names_expr for d in drives] == [
        (joint,) for joint in estimate.model.robot.joint_names
    ]
    assert "export it, too" in export.notes[0]


def test_what_is_not_known_is_left_to_be_filled_in(estimate, monkeypatch):
    export = to_isaac_lab(estimate, allow_refused=True)
    made = run(export, monkeypatch, "isaaclab.actuators", "DelayedPDActuatorCfg")
    drives = made(0.005)["drives"]
    assert drives.stiffness is None is drives.damping
    assert drives.min_delay == 0
    assert any("no gains are known" in note for note in export.notes)
