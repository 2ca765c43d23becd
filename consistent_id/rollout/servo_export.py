"""Identified servos as MuJoCo actuators, and their replay.

MuJoCo's joint friction is viscous and Coulomb, so the form ``plain`` is written: it was
fitted by itself, not cut out of a richer one.  The actuator is ``stall gain (goal +
zero - q)`` within the stall torque, which is that at the supply and the temperature of
one log; the motor's back-EMF is part of the joint's damping, and the delay of the goals
that of the actuator.  Joints without an identified servo are removed, and their bodies
placed where these joints were.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.given_values import require_type
from consistent_id.errors import ModelError
from consistent_id.export.mjcf_bodies import require_mujoco, spec_tree
from consistent_id.robot.loaders import mjcf_spec
from consistent_id.rollout.servo_log import ServoLog, supply_of
from consistent_id.rollout.servo_motion import STEP as SERVO_STEP
from consistent_id.rollout.servo_motion import warmth_of
from consistent_id.rollout.servo_result import JointServo, ServoFit, ServoForm

FORM = "plain"
_HARD = (0.999, 0.9999, 1e-3, 0.5, 2.0)  # friction that hardly creeps (solimp)
STEP = 0.2 * SERVO_STEP
"""Time step of the file [s]: MuJoCo's damping acts a step late."""

_LINEAR = 1  # interpolation of delayed goals
_TIME = (2.0 * STEP, 1.0)  # its time constant and damping ratio (solref)


def servo_spec(
    robot: str | Path,
    fit: ServoFit,
    gains: Sequence[float],
    held: Mapping[str, float] | None = None,
    *,
    log: ServoLog | None = None,
) -> Any:
    """Return a robot's ``mujoco.MjSpec`` with the identified servos.

    Parameters
    ----------
    robot : str or Path
        URDF or MJCF file.
    gains : sequence of float, [1/rad]
        Gains of the firmware: share of full duty over position error, one for each
        joint.
    held : mapping of str to float, optional, [rad] or [m]
        Where joints without an identified servo are; by default those that did not move
        where the fit says, others at zero.
    log : ServoLog, optional
        At whose supply and temperature motors pull; by default nominal ones.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the file, or the form ``plain`` was not
        fitted.
    """
    mujoco = require_mujoco()
    spec = mjcf_spec.read_spec(Path(robot), mujoco)
    joints = dict(spec_tree(spec).joints)
    moving = {servo.joint for servo in fit.joints}
    where = {**fit.not_moved, **(held or {})}
    still = {name: where.get(name, 0.0) for name in joints if name not in moving}
    for item in list(spec.actuators):
        if item.target in joints:
            spec.delete(item)
    for key in list(spec.keys):  # they would have the old number of joints
        spec.delete(key)
    for tie in list(spec.equalities):
        if {tie.name1, tie.name2} & set(still):
            spec.delete(tie)
    if still:
        _lock(spec, joints, still)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for servo, gain in zip(fit.joints, gains, strict=True):
        values = _plain(servo).values
        stall = values["stall"] * (1.0 if log is None else _pull(servo, fit, log))
        joint = joints[servo.joint]
        joint.armature = values["armature"]
        joint.damping[0] = values["viscous"] + values.get("back_emf", 0.0)
        joint.frictionloss = values["coulomb"]
        joint.solimp_friction, joint.solref_friction = _HARD, _TIME
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        stiffness, delay = stall * gain, values["delay"]
        drive = spec.add_actuator(name=servo.joint)
        drive.target, drive.trntype = servo.joint, mujoco.mjtTrn.mjTRN_JOINT
        drive.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.gainprm[0] = stiffness
        drive.biasprm[:3] = stiffness * values["zero"], -stiffness, 0.0
        drive.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        drive.forcerange = [-stall, stall]
        # The file's default class may have a delay: without one, it is 0.
        drive.delay, drive.interp = delay, _LINEAR if delay > 0.0 else 0
        drive.nsample = int(np.ceil(delay / STEP)) + 2 if delay > 0.0 else 0
    return spec


def _pull(servo: JointServo, fit: ServoFit, log: ServoLog) -> float:
    """Return the stall torque at a log's supply and temperature over `stall`."""
    warmth = warmth_of(log, log.joints.index(servo.joint))
    warm = 1.0 - _plain(servo).values.get("heat", 0.0) * warmth
    return supply_of(log, fit.volts) * warm


def _lock(spec: Any, joints: Mapping[str, Any], places: Mapping[str, float]) -> None:
    """Place the bodies of joints where these are, and remove the joints."""
    mujoco = require_mujoco()
    model = compiled(spec)
    for name, place in places.items():
        body, joint = joints[name].parent, model.joint(name)
        moved = place - float(model.qpos0[joint.qposadr[0]])
        if moved and len(list(body.joints)) > 1:
            raise ModelError(
                f"joint {name} is one of several joints of body {body.name} and cannot "
                "be held; log its position, or give it a body of its own"
            )
        pose = model.body(body.name)
        position, turn = np.array(pose.pos), np.array(pose.quat)
        frame, turned = np.empty(9), np.array([1.0, 0.0, 0.0, 0.0])
        mujoco.mju_quat2Mat(frame, turn)
        if int(joint.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE):
            mujoco.mju_axisAngle2Quat(turned, joint.axis, moved)
            arm = np.empty(3)
            mujoco.mju_rotVecQuat(arm, joint.pos, turned)
            shift = joint.pos - arm
        elif int(joint.type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE):
            shift = moved * joint.axis
        else:
            continue  # a free or ball joint has no single position
        whole = np.empty(4)
        mujoco.mju_mulQuat(whole, turn, turned)
        body.pos, body.quat = position + frame.reshape(3, 3) @ shift, whole
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        spec.delete(joints[name])


def compiled(spec: Any) -> Any:
    """Return a specification's ``mujoco.MjModel``.

    Raises
    ------
    ModelError
        If MuJoCo refuses it.
    """
    mujoco = require_mujoco()
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(
            f"MuJoCo refuses the robot with identified servos: {cause}"
        ) from None


def _plain(servo: JointServo) -> ServoForm:
    if FORM not in (form.name for form in servo.forms):
        raise ModelError(
            f"joint {servo.joint}: MuJoCo has viscous and Coulomb friction alone; fit "
            f"the form {FORM!r}, too"
        )
    return servo.form(FORM)


def servo_mjcf(
    robot: str | Path,
    fit: ServoFit,
    gains: Sequence[float],
    held: Mapping[str, float] | None = None,
    *,
    log: ServoLog | None = None,
) -> str:
    """Return the MJCF text of `servo_spec`."""
    require_type(fit, ServoFit, "fit")
    spec = servo_spec(robot, fit, gains, held, log=log)
    compiled(spec)
    return str(spec.to_xml())


def replayed_in_mujoco(
    robot: str | Path,
    fit: ServoFit,
    log: ServoLog,
    gains: Sequence[float],
    held: Mapping[str, float] | None = None,
) -> Vector:
    """Return mean absolute position errors of a log's goals in MuJoCo [rad].

    Motors pull as the log's supply and temperature let them.  All joints move together.

    Returns
    -------
    ndarray, shape (joints,)
        Values of the joints with an identified servo.
    """
    return _replayed(servo_spec(robot, fit, gains, held, log=log), fit, log)


def replayed_file(text: str, fit: ServoFit, log: ServoLog) -> Vector:
    """Return the same errors of a file that `servo_mjcf` wrote, read back."""
    mujoco = require_mujoco()
    return _replayed(mujoco.MjSpec.from_string(text), fit, log)


def _replayed(spec: Any, fit: ServoFit, log: ServoLog) -> Vector:
    """Return position errors; a motor that is not driven has no torque or back-EMF."""
    mujoco = require_mujoco()
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    model = compiled(spec)
    data = mujoco.MjData(model)
    forms = [_plain(servo) for servo in fit.joints]
    joints = [model.joint(servo.joint).id for servo in fit.joints]
    drives = [model.actuator(servo.joint).id for servo in fit.joints]
    at, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    zero = np.array([form.values["zero"] for form in forms])
    columns = [log.joints.index(servo.joint) for servo in fit.joints]
    data.qpos[at] = log.position[0, columns] + zero
    usual = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    emf = np.array([form.values.get("back_emf", 0.0) for form in forms])
    damping = model.dof_damping[dofs].copy()
    for drive, column in zip(drives, columns, strict=True):
        count = int(model.actuator_history[drive, 0])
        if count:
            before = np.full((count, 1), log.goal[0, column])
            mujoco.mj_initCtrlHistory(model, data, drive, None, before)
    steps = int(log.time[-1] / STEP) + 2
    q: Matrix = np.empty((steps, len(joints)))
    for step in range(steps):
        q[step] = data.qpos[at] - zero
        data.ctrl[drives] = log.goal[_row(log, step * STEP), columns]
        driven = np.ones(len(joints))
        if log.enabled is not None:
            driven[log.enabled[_row(log, step * STEP), columns] <= 0.5] = 0.0
        model.actuator_gainprm[drives] = usual[0][drives] * driven[:, None]
        model.actuator_biasprm[drives] = usual[1][drives] * driven[:, None]
        model.dof_damping[dofs] = damping - emf * (1.0 - driven)
        mujoco.mj_step(model, data)
    grid = np.arange(steps) * STEP
    return np.array(
        [
            abs(np.interp(log.time, grid, column) - seen).mean()
            for column, seen in zip(q.T, log.position[:, columns].T, strict=True)
        ]
    )


def _row(log: ServoLog, time: float) -> int:
    row = int(np.searchsorted(log.time, time, side="right")) - 1
    return min(max(row, 0), len(log.time) - 1)
