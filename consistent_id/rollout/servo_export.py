"""Identified servos as MuJoCo actuators, and their replay.

MuJoCo's joint friction is viscous and Coulomb, so the form ``plain`` is written: it was
fitted by itself, not cut out of a richer one.  The actuator is ``stall gain (goal +
zero - q)`` within the stall torque; the motor's back-EMF is part of the joint's
damping.  A delay of the goals is not part of the file.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.export.mjcf_bodies import require_mujoco, spec_tree
from consistent_id.robot.loaders import mjcf_spec
from consistent_id.rollout.servo_fit import JointServo, ServoFit, ServoForm
from consistent_id.rollout.servo_log import ServoLog
from consistent_id.rollout.servo_motion import STEP

FORM = "plain"
_HARD = (0.999, 0.9999, 1e-3, 0.5, 2.0)  # friction that hardly creeps (solimp)
_TIME = (2.0 * STEP, 1.0)  # its time constant and damping ratio (solref)


def servo_spec(robot: str | Path, fit: ServoFit, gains: Sequence[float]) -> Any:
    """Return a robot's ``mujoco.MjSpec`` with the identified servos.

    Parameters
    ----------
    robot : str or Path
        URDF or MJCF file.
    gains : sequence of float, [1/rad]
        Of the firmware: share of full duty over position error, one for each joint.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the file, or the form ``plain`` was not
        fitted.
    """
    mujoco = require_mujoco()
    spec = mjcf_spec.read_spec(Path(robot), mujoco)
    joints = spec_tree(spec).joints
    for item in list(spec.actuators):
        if item.target in {servo.joint for servo in fit.joints}:
            spec.delete(item)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for servo, gain in zip(fit.joints, gains, strict=True):
        values = _plain(servo).values
        joint = joints[servo.joint]
        joint.armature = values["armature"]
        joint.damping[0] = values["viscous"] + values.get("back_emf", 0.0)
        joint.frictionloss = values["coulomb"]
        joint.solimp_friction, joint.solref_friction = _HARD, _TIME
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        stiffness = values["stall"] * gain
        drive = spec.add_actuator(name=servo.joint)
        drive.target, drive.trntype = servo.joint, mujoco.mjtTrn.mjTRN_JOINT
        drive.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.gainprm[0] = stiffness
        drive.biasprm[:3] = stiffness * values["zero"], -stiffness, 0.0
        drive.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        drive.forcerange = [-values["stall"], values["stall"]]
    return spec


def _plain(servo: JointServo) -> ServoForm:
    if FORM not in (form.name for form in servo.forms):
        raise ModelError(
            f"joint {servo.joint}: MuJoCo has viscous and Coulomb friction alone; fit "
            f"the form {FORM!r}, too"
        )
    return servo.form(FORM)


def servo_mjcf(robot: str | Path, fit: ServoFit, gains: Sequence[float]) -> str:
    """Return the MJCF text of `servo_spec`."""
    spec = servo_spec(robot, fit, gains)
    spec.compile()
    return str(spec.to_xml())


def replayed_in_mujoco(
    robot: str | Path, fit: ServoFit, log: ServoLog, gains: Sequence[float]
) -> Vector:
    """Return mean absolute position errors of a log's goals in MuJoCo [rad].

    Goals are delayed as identified, and a motor that is not driven has no torque and no
    back-EMF.  All joints move together.

    Returns
    -------
    ndarray, shape (joints,)
    """
    mujoco = require_mujoco()
    spec = servo_spec(robot, fit, gains)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    forms = [_plain(servo) for servo in fit.joints]
    joints = [compiled.joint(servo.joint).id for servo in fit.joints]
    drives = [compiled.actuator(servo.joint).id for servo in fit.joints]
    at, dofs = compiled.jnt_qposadr[joints], compiled.jnt_dofadr[joints]
    zero = np.array([form.values["zero"] for form in forms])
    data.qpos[at] = log.position[0] + zero
    usual = compiled.actuator_gainprm.copy(), compiled.actuator_biasprm.copy()
    emf = np.array([form.values.get("back_emf", 0.0) for form in forms])
    damping = compiled.dof_damping[dofs].copy()
    delays = [form.values["delay"] for form in forms]
    steps = int(log.time[-1] / STEP) + 2
    q: Matrix = np.empty((steps, len(joints)))
    for step in range(steps):
        q[step] = data.qpos[at] - zero
        driven = np.ones(len(joints))
        for place, delay in enumerate(delays):
            row = _row(log, (step + 0.5) * STEP - delay)
            data.ctrl[drives[place]] = log.goal[row, place]
            if log.enabled is not None:
                driven[place] = log.enabled[_row(log, step * STEP), place] > 0.5
        compiled.actuator_gainprm[drives] = usual[0][drives] * driven[:, None]
        compiled.actuator_biasprm[drives] = usual[1][drives] * driven[:, None]
        compiled.dof_damping[dofs] = damping - emf * (1.0 - driven)
        mujoco.mj_step(compiled, data)
    grid = np.arange(steps) * STEP
    return np.array(
        [
            abs(np.interp(log.time, grid, column) - seen).mean()
            for column, seen in zip(q.T, log.position.T, strict=True)
        ]
    )


def _row(log: ServoLog, time: float) -> int:
    row = int(np.searchsorted(log.time, time, side="right")) - 1
    return min(max(row, 0), len(log.time) - 1)
