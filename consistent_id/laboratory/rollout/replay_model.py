"""A robot's file or specification, made ready for the commands that the robot had.

Its base is held, joints that are not looked at are held at their locked positions,
contacts and limits of joints are left out (the robot was where the log says), and in
place of its own actuators each joint has the PD drive of the log, with its limit.  An
elastic joint is two: the motor's, which keeps the name, and behind it the spring's, on
the same axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import IntArray
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.export.mjcf_export import mujoco_spec
from consistent_id.export.mjcf_tree import spec_tree
from consistent_id.laboratory.rollout.springs import add_springs, fit_to_springs
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.loaders import mjcf_assets
from consistent_id.robot.parameters import require_known

STEP = 5e-4
"""Longest time step [s].  MuJoCo's steps are of first order: a drive's stiffness counts
as damping for half a step, which at 1 ms is a few per cent of what drives have."""


@dataclass(frozen=True, slots=True, eq=False)
class ReplayModel:
    """A compiled model whose controls are the drives' torque at rest in zero.

    Parameters
    ----------
    gains : PDGains
        One each; the drives' feedback is in the model, `kp q_command` and the like are
        its controls.
    positions, velocities : ndarray of int, shape (joints,)
        Places of the joints in MuJoCo's state.
    """

    name: str
    joints: tuple[str, ...]
    compiled: Any
    gains: PDGains
    positions: IntArray
    velocities: IntArray


def replay_model(
    robot: Estimate | str | Path,
    joints: Sequence[str],
    gains: PDGains,
    *,
    locked: Mapping[str, float] | None = None,
    period: float = STEP,
) -> ReplayModel:
    """Return a model that can be given the commands that the robot had.

    Parameters
    ----------
    robot : Estimate, str or Path
        An estimate; or an MJCF or URDF file, as MuJoCo reads it.
    locked : mapping of str to float, optional, [rad or m]
        Positions of other joints of a file; zero where none is given.
    period : float, [s]
        Of the commands; the time step is a whole fraction of it.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the robot, or a joint is not in it.
    """
    name = robot.method if isinstance(robot, Estimate) else Path(robot).name
    spec = replay_spec(robot, joints, gains, locked=locked, period=period)
    return compiled_model(spec, name, joints, gains)


def replay_spec(
    robot: Estimate | str | Path,
    joints: Sequence[str],
    gains: PDGains,
    *,
    locked: Mapping[str, float] | None = None,
    period: float = STEP,
) -> Any:
    """Return the specification (``mujoco.MjSpec``) that `replay_model` compiles."""
    mujoco = require_mujoco()
    if isinstance(robot, Estimate):
        name = robot.method
        spec = mujoco_spec(robot, allow_refused=True).spec
    else:
        name = Path(robot).name
        spec = mjcf_assets.read_spec(Path(robot), mujoco)
    _strip(spec)
    _hold(spec, joints, {} if locked is None else locked, name, mujoco)
    _drive(spec, joints, gains.of(len(joints)), mujoco)
    spec.option.timestep = period / np.ceil(period / STEP * (1.0 - 1e-9))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    flags = mujoco.mjtDisableBit
    spec.option.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT
    return spec


def compiled_model(
    spec: Any, name: str, joints: Sequence[str], gains: PDGains
) -> ReplayModel:
    """Compile a specification of `replay_spec`, perhaps changed since.

    Raises
    ------
    ModelError
        If MuJoCo refuses it, or a joint's spring.
    """
    compiled, gains = _compiled(spec, name), gains.of(len(joints))
    if np.isfinite(gains.stiffness).any():
        add_springs(spec, compiled, joints, gains.stiffness)
        compiled = _compiled(spec, name)
        fit_to_springs(compiled)
    found = [compiled.joint(joint).id for joint in joints]
    return ReplayModel(
        name,
        tuple(joints),
        compiled,
        gains,
        compiled.jnt_qposadr[found].astype(np.intp),
        compiled.jnt_dofadr[found].astype(np.intp),
    )


def _compiled(spec: Any, name: str) -> Any:
    mujoco = require_mujoco()
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{name}: MuJoCo refuses it: {cause}") from None


def _strip(spec: Any) -> None:
    """Leave out what has no part in free motion, or names joints that are held."""
    for kind in (spec.keys, spec.sensors, spec.actuators):
        for item in list(kind):
            spec.delete(item)


def _hold(
    spec: Any,
    joints: Sequence[str],
    locked: Mapping[str, float],
    name: str,
    mujoco: Any,
) -> None:
    """Take out the joints that do not move; bodies stay where the joints held them."""
    found = spec_tree(spec).joints
    require_known(joints, found, f"{name} has no joint", ModelError)
    followers = {e.name1 for e in spec.equalities if e.type == _joint_equality(mujoco)}
    for joint, item in found.items():
        if joint in joints or joint in followers:
            continue
        if item.type != mujoco.mjtJoint.mjJNT_FREE and locked.get(joint):
            _turn(item, locked[joint], mujoco)
        spec.delete(item)


def _joint_equality(mujoco: Any) -> Any:
    return mujoco.mjtEq.mjEQ_JOINT


def _turn(joint: Any, value: float, mujoco: Any) -> None:
    """Move a joint's body to where the joint's position puts it."""
    body, axis = joint.parent, np.array(joint.axis)
    axis /= np.linalg.norm(axis)
    R, turned = np.zeros(9), np.zeros(4)
    mujoco.mju_quat2Mat(R, body.quat)
    frame = R.reshape(3, 3)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        body.pos = body.pos + frame @ (value * axis)
        return
    mujoco.mju_axisAngle2Quat(turned, axis, value)
    mujoco.mju_quat2Mat(R, turned)
    rotation, anchor = R.reshape(3, 3).copy(), np.array(joint.pos)
    whole = np.zeros(4)
    mujoco.mju_mulQuat(whole, body.quat, turned)
    body.pos = body.pos + frame @ (anchor - rotation @ anchor)
    body.quat = whole


def _drive(spec: Any, joints: Sequence[str], gains: PDGains, mujoco: Any) -> None:
    """Add one drive per joint: ``control - kp q - kd dq``, within its limit."""
    found = spec_tree(spec).joints
    for joint, kp, kd, limit in zip(
        joints, gains.kp, gains.kd, gains.torque_limit, strict=True
    ):
        found[joint].actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        drive = spec.add_actuator(name=f"drive of {joint}")
        drive.target, drive.trntype = joint, mujoco.mjtTrn.mjTRN_JOINT
        drive.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.gainprm[0] = 1.0
        drive.biasprm[:3] = 0.0, -kp, -kd
        drive.ctrllimited = False
        drive.forcelimited = bool(np.isfinite(limit))
        if drive.forcelimited:
            drive.forcerange = [-limit, limit]
