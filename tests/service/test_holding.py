"""An identified arm that floats on compensation in MuJoCo stays where it is."""

import sys
from pathlib import Path

import numpy as np
import pytest
from carrying import urdf
from estimates import estimate_of

from consistent_id import (
    DriveTerms,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    simulate_torque,
)
from consistent_id.export import mujoco_spec
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.robot import load_urdf
from consistent_id.service import control_model

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
import holding  # noqa: E402

POSES = 50
LEVELS = np.array([1.2, 0.8])  # viscous, dry friction of each joint


def drift(true, control, poses):
    """Largest angle by which the true robot leaves each pose, in degrees."""
    model = mujoco_spec(true).spec.compile()
    model.opt.timestep = 2e-3
    return holding.drift(model, control, poses, 5.0)


@pytest.mark.slow
def test_gravity_and_friction_compensation_hold_fifty_poses(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(urdf())
    robot = load_urdf(file)
    rng = np.random.default_rng(0)
    model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign"))
    true = estimate_of(
        model, [link.nominal for link in robot.links], np.tile(LEVELS, 4)
    )
    tones = rng.uniform(0.1, 0.5, (4, 5, 3))
    joints = [[Sinusoid(a, a, f, p) for a, f, p in own] for own in tones]
    motion = SinusoidalMotion(20.0, 100.0, joints).recording(robot.joint_names)
    log = simulate_torque(model, true.parameters, motion, noise=0.5, rng=rng)
    estimate = constrained_least_squares(model, build_regression(model, log))
    poses = rng.uniform(-1.5, 1.5, (POSES, 4))
    held = drift(true, control_model(estimate), poses)
    assert held.max() < 0.2
    # Bodies that are a tenth too heavy: dry friction does not hold the arm any more.
    heavy = estimate_of(
        model, [_heavier(link.nominal) for link in robot.links], np.tile(LEVELS, 4)
    )
    fallen = drift(true, control_model(heavy), poses[:10])
    assert fallen.max() > 10.0


def _heavier(body):
    return type(body)(1.1 * body.vector)
