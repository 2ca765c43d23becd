"""A planted robot in MuJoCo: dry friction, no shapes, one torque for each joint."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.export.mjcf_export import mujoco_spec
from consistent_id.laboratory.rehearsal.planted import PlantedRobot
from consistent_id.regression.base import base_parameters


@dataclass(frozen=True, slots=True, eq=False)
class MujocoRobot:
    """A compiled MuJoCo model, and where the joints of a robot are in it.

    Parameters
    ----------
    positions, velocities : ndarray, shape (joints,)
        Places in ``qpos`` and ``qvel``.
    """

    model: Any
    positions: IntArray
    velocities: IntArray

    @property
    def step(self) -> float:
        """Of the integrator [s]."""
        return float(self.model.opt.timestep)

    def at(self, q: Vector, dq: Vector) -> Any:
        """Return ``mujoco.MjData`` in a state."""
        mujoco = require_mujoco()
        data = mujoco.MjData(self.model)
        data.qpos[self.positions], data.qvel[self.velocities] = q, dq
        mujoco.mj_forward(self.model, data)
        return data

    def advance(self, data: Any, torque: Vector, steps: int) -> None:
        """Let it move under torques that hold for some steps."""
        data.qfrc_applied[self.velocities] = torque
        require_mujoco().mj_step(self.model, data, steps)


def mujoco_robot(robot: PlantedRobot, step: float) -> MujocoRobot:
    """Return a planted robot in MuJoCo.

    Parameters
    ----------
    step : float, [s]
        Of the integrator.

    Raises
    ------
    ModelError
        If MuJoCo is not installed, refuses the robot, or joints follow others.
    """
    mujoco, arm = require_mujoco(), robot.model.robot
    if len(arm.joints) != len(arm.driven):
        raise ModelError(
            f"robot {arm.name!r}: joints that follow others cannot be rehearsed; lock "
            "them in the model"
        )
    spec = mujoco_spec(_as_estimate(robot), allow_refused=True).spec
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    try:
        model = spec.compile()
    except ValueError as cause:
        raise ModelError(f"MuJoCo refuses the planted robot: {cause}") from None
    # A design is to be judged by what it asks, not by what MuJoCo would cut off.
    model.jnt_limited[:] = 0
    model.jnt_actfrclimited[:] = 0
    joints = [model.joint(name) for name in arm.joint_names]
    return MujocoRobot(
        model,
        np.array([joint.qposadr[0] for joint in joints]),
        np.array([joint.dofadr[0] for joint in joints]),
    )


def _as_estimate(robot: PlantedRobot) -> Estimate:
    """Return the truth as an estimate, which is what exporters take."""
    base, size = base_parameters(robot.model), len(robot.model.layout)
    noise: Array = np.zeros(len(robot.model.torque_joints))
    unproven = Certificate("uncertified", "planted, not estimated")
    return Estimate(
        "planted", robot.model, base, robot.parameters, None, ("data",) * size, (),
        noise, unproven,
    )  # fmt: skip
