"""Simulated runs of a robot with a load and without, whose truth Pinocchio knows."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from consistent_id import DriveTerms, InertialParameters, TorqueModel, simulate_torque
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.robot.loaders.urdf import from_pinocchio

LOAD = InertialParameters.from_central(
    3.0, [0.05, 0.02, 0.15], np.diag([0.03, 0.04, 0.02])
)
DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True)
GAINS = np.array([12.0, 11.0, 9.0, 7.0])


def arm() -> tuple[pin.Model, TorqueModel]:
    """Four turning joints that feel gravity, as Pinocchio and the package see them."""
    model = pin.Model()
    joints = (pin.JointModelRZ(), pin.JointModelRY(), pin.JointModelRY())
    for k, joint in enumerate((*joints, pin.JointModelRX())):
        place = pin.SE3(np.eye(3), np.array([0.1 * (k == 1), 0.0, 0.4 * (k > 0)]))
        index = model.addJoint(k, joint, place, f"j{k}")
        body = pin.Inertia(
            5.0 - k, np.array([0.02, 0.03, 0.15]), np.diag([0.10, 0.09, 0.04])
        )
        model.appendBodyToJoint(index, body, pin.SE3.Identity())
    return model, TorqueModel(from_pinocchio(model), DRIVE)


def with_load(model: pin.Model) -> pin.Model:
    """The robot, its last body with the load."""
    loaded = model.copy()
    body = pin.Inertia(LOAD.mass, LOAD.com, LOAD.central_inertia)
    loaded.appendBodyToJoint(model.njoints - 1, body, pin.SE3.Identity())
    return loaded


def runs(noise: float, seed: int = 0, *, gains: np.ndarray | None = None):
    """Return the model, and an unloaded and a loaded run; currents for gains.

    Noise is relative to each joint's torque in the unloaded run.
    """
    rng = np.random.default_rng(seed)
    bare, model = arm()
    friction = np.concatenate([rng.uniform(0.5, 2.0, 3) for _ in range(4)])
    logs, scale = [], None
    for robot in (bare, with_load(bare)):
        data = robot.createData()
        joints = tuple(
            tuple(Sinusoid(a, a, f, p) for a, f, p in rng.uniform(0.1, 0.5, (5, 3)))
            for _ in range(4)
        )
        motion = SinusoidalMotion(20.0, 50.0, joints).recording(model.robot.joint_names)
        x = np.concatenate([np.zeros(40), friction])
        torque = simulate_torque(model, x, motion).torque + np.array(
            [
                pin.rnea(robot, data, *state).copy()
                for state in zip(
                    motion.position, motion.velocity, motion.acceleration, strict=True
                )
            ]
        )
        if scale is None:
            scale = noise * np.sqrt(np.mean(torque**2, axis=0))
        torque = torque + rng.normal(size=torque.shape) * scale
        logs.append(replace(motion, torque=torque / (1.0 if gains is None else gains)))
    return model, *logs
