"""A robot's file or specification, prepared for replaying commands.

Its base is fixed, unused joints are fixed at their locked positions, contacts and
limits of joints are left out (the log is feasible), and instead of its own actuators
each joint has the PD drive of the log, with its limit.

MuJoCo's velocities are those half a step before its positions.  So commands are half a
step later (`replay`), and half a step of the damping is taken off the inertia, because
MuJoCo damps by the velocity at the end of a step.  Without both, errors are of first
order in the time step: a step of 2.5 ms would be four times as wrong as one of 0.5 ms.

The body of an elastic joint gets a second joint on the same axis.  The first keeps the
name, has rotor inertia, friction and drive, and is where the motor is; the second has
the spring, and is the deflection of the link.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.mjcf_bodies import require_mujoco, spec_tree
from consistent_id.export.mjcf_export import mujoco_spec
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.elastic_joints import DAMPING
from consistent_id.robot.loaders import mjcf_spec
from consistent_id.robot.parameters import require_known

SUFFIX = " spring"  # of the second joint's name

_STEP_OF_VIBRATION = 0.5
"""Longest time step, in radians of the fastest vibration.  Semi-implicit steps are
stable up to 2; at this one its frequency is right to 1 %.
"""

_LEAST_ROTOR = 0.01
"""Least rotor inertia over the link's.  Geared motors have more, and a spring needs two
masses.
"""

_MOST_STEPS = 20  # time steps, at most, in place of one

STEP = 5e-4
"""Longest time step [s] of rollouts whose errors are results."""

SEARCH_STEP = 2.5e-3
"""Longest time step [s] of rollouts that are only compared or refined: there are many.
They differ from finer ones by at most 2 % of the errors of real robots.
"""

_LONGER = 1.02  # times the longest time step that is asked for, at the most
_DAMPED = 0.5  # of inertia, at most, is taken off because damping is implicit


@brief
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


class RobotFile(NamedTuple):
    """A robot's file as MuJoCo reads it back.

    Parameters
    ----------
    path : Path
        MJCF or URDF.
    joints : sequence of str
        Joints that the drives move.
    locked : mapping of str to float, [rad or m]
        Positions of the others; zero where none is given.
    """

    path: Path
    joints: Sequence[str]
    locked: Mapping[str, float]


class _WarningsOff:
    """How many parts of the program, in all threads, keep MuJoCo quiet."""

    lock = Lock()
    count = 0


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the terminal, and out of a file ``MUJOCO_LOG.TXT``.

    A motion that diverges is reported by its caller.  A handler of warnings that
    another program has set stays.
    """
    mujoco = require_mujoco()
    with _WarningsOff.lock:
        if _WarningsOff.count == 0 and mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(_ignored)
        _WarningsOff.count += 1
    try:
        yield
    finally:
        with _WarningsOff.lock:
            _WarningsOff.count -= 1
            if _WarningsOff.count == 0 and mujoco.get_mju_user_warning() is _ignored:
                mujoco.set_mju_user_warning(None)


def _ignored(warning: str) -> None:
    """Do nothing."""


def replay_model(
    robot: Estimate | str | Path,
    joints: Sequence[str],
    gains: PDGains,
    *,
    locked: Mapping[str, float] | None = None,
    period: float = STEP,
    step: float = STEP,
) -> ReplayModel:
    """Return a model for replaying the robot's commands.

    Parameters
    ----------
    robot : Estimate, str or Path
        An estimate; or an MJCF or URDF file, as MuJoCo reads it.
    locked : mapping of str to float, optional, [rad or m]
        Positions of other joints of a file; zero where none is given.
    period : float, [s]
        Period of the commands; the time step is a whole fraction of it.
    step : float, [s]
        The longest time step.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the robot, or a joint is not in it.
    """
    require_type(gains, PDGains, "gains")
    name = robot.method if isinstance(robot, Estimate) else Path(robot).name
    step = time_step(period, step)
    spec = replay_spec(robot, joints, gains, locked=locked, step=step)
    return compiled_model(spec, name, joints, gains)


def time_step(period: float, longest: float = STEP) -> float:
    """Return the longest whole fraction of a period that is hardly longer than a step.

    Clocks are not exact: at 199.96 Hz, 5.001 ms have ten steps of 0.5 ms, not eleven.
    """
    return float(period / np.ceil(period / longest / _LONGER))


def replay_spec(
    robot: Estimate | str | Path,
    joints: Sequence[str],
    gains: PDGains,
    *,
    locked: Mapping[str, float] | None = None,
    step: float = STEP,
) -> Any:
    """Return the specification (``mujoco.MjSpec``) that `replay_model` compiles."""
    mujoco = require_mujoco()
    if isinstance(robot, Estimate):
        name = robot.method
        spec = mujoco_spec(robot, allow_refused=True).spec
    else:
        name = Path(robot).name
        spec = mjcf_spec.read_spec(Path(robot), mujoco)
    _strip(spec)
    hold_others(spec, joints, {} if locked is None else locked, name)
    _drive(spec, joints, gains.of(joints), mujoco)
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    flags = mujoco.mjtDisableBit
    spec.option.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT
    # Legs are solved together: with so few joints, to separate them takes longer.
    spec.option.disableflags |= flags.mjDSBL_ISLAND
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
    compiled, gains = _compiled(spec, name), gains.of(joints)
    if np.isfinite(gains.stiffness).any():
        add_springs(spec, compiled, joints, gains.stiffness)
        compiled = _compiled(spec, name)
        fit_to_springs(compiled)
    found = [compiled.joint(joint).id for joint in joints]
    velocities = compiled.jnt_dofadr[found].astype(np.intp)
    _centre_damping(compiled, gains, velocities)
    return ReplayModel(
        name,
        tuple(joints),
        compiled,
        gains,
        compiled.jnt_qposadr[found].astype(np.intp),
        velocities,
    )


def _centre_damping(compiled: Any, gains: PDGains, velocities: IntArray) -> None:
    """Take off the inertia that implicit damping adds: half a step of the damping.

    Time steps become shorter where that is much of the inertia.  A robot whose inertia
    is not positive keeps its damping: its motion diverges.
    """
    damping = np.array(compiled.dof_damping)
    damping[velocities] += gains.kd
    damping = np.maximum(damping, 0.0)  # a fit without signs may drive a joint
    inverse = _inverse_inertia(compiled)
    if not np.isfinite(inverse).all():
        return
    rooted = np.sqrt(damping)
    fastest = np.linalg.eigvalsh(rooted[:, None] * inverse * rooted)[-1]
    share = 0.5 * compiled.opt.timestep * fastest / _DAMPED
    count = int(np.clip(np.ceil(share), 1, _MOST_STEPS))
    compiled.opt.timestep /= count
    half = 0.5 * compiled.opt.timestep / max(share / count, 1.0)
    compiled.dof_armature[:] -= half * damping


def _inverse_inertia(compiled: Any) -> Matrix:
    """Return the inverse of the mass matrix where a model is at rest."""
    mujoco = require_mujoco()
    data, inverse = mujoco.MjData(compiled), np.zeros((compiled.nv, compiled.nv))
    with quiet():
        mujoco.mj_forward(compiled, data)
        mujoco.mj_solveM(compiled, data, inverse, np.eye(compiled.nv))
    return inverse


def _compiled(spec: Any, name: str) -> Any:
    mujoco = require_mujoco()
    try:
        with _WarningsOff.lock, catch_warnings():
            simplefilter("ignore", UserWarning)  # of a motion that will diverge
            return spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{name}: MuJoCo refuses it: {cause}") from None


def _strip(spec: Any) -> None:
    """Remove elements without effect on free motion, or with fixed joints."""
    for kind in (spec.keys, spec.sensors, spec.actuators):
        for item in list(kind):
            spec.delete(item)


def hold_others(
    spec: Any, joints: Sequence[str], locked: Mapping[str, float], name: str
) -> None:
    """Take out the joints that do not move; their bodies stay where they were.

    Inertia of bodies that then stand still, such as a base, is replaced: no motion
    depends on it, but MuJoCo refuses what no body has.
    """
    mujoco = require_mujoco()
    found = spec_tree(spec).joints
    require_known(joints, found, f"{name} has no joint", ModelError)
    followers = {e.name1 for e in spec.equalities if e.type == _joint_equality(mujoco)}
    for joint, item in found.items():
        if joint in joints or joint in followers:
            continue
        if item.type != mujoco.mjtJoint.mjJNT_FREE and locked.get(joint):
            _turn(item, locked[joint], mujoco)
        spec.delete(item)
    _make_round(spec.worldbody.bodies)


def _make_round(bodies: Sequence[Any]) -> None:
    """Give bodies that stand still the inertia of a ball; their mass stays."""
    for body in bodies:
        if not body.joints:
            body.fullinertia, body.inertia = np.full(6, np.nan), np.full(3, body.mass)
            _make_round(body.bodies)


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
        drive.delay, drive.nsample = 0.0, 0  # the file's default may have one
        drive.forcelimited = bool(np.isfinite(limit))
        if drive.forcelimited:
            drive.forcerange = [-limit, limit]


class SpringError(ModelError):
    """A joint cannot have the spring that it is given."""


def add_springs(
    spec: Any, compiled: Any, joints: Sequence[str], stiffness: Vector
) -> None:
    """Add a spring behind each motor whose stiffness is finite.

    Parameters
    ----------
    compiled : mujoco.MjModel
        The compiled model, without springs.
    stiffness : ndarray, shape (joints,), [N m/rad or N/m]

    Raises
    ------
    SpringError
        If there is hardly any inertia between a drive and its spring.
    """
    found = spec_tree(spec).joints
    for name, k in zip(joints, stiffness.tolist(), strict=True):
        if not np.isfinite(k):
            continue
        place = compiled.jnt_dofadr[compiled.joint(name).id]
        rotor = float(compiled.dof_armature[place])
        link = float(compiled.dof_M0[place]) - rotor
        if rotor < _LEAST_ROTOR * link:
            raise SpringError(
                f"{name} has a spring behind its motor, but a rotor inertia of "
                f"{rotor:.2g} beside the link's {link:.2g} only; identify it "
                "(rotor_inertia = true), or leave the stiffness out"
            )
        motor = found[name]
        motor.parent.add_joint(
            name=name + SUFFIX,
            type=motor.type,
            axis=np.array(motor.axis),
            pos=np.array(motor.pos),
            stiffness=k,
        )


def fit_to_springs(compiled: Any) -> None:
    """Give springs their damping, and the model time steps that follow vibrations.

    Raises
    ------
    SpringError
        If a spring is so stiff that it would take too many time steps.
    """
    springs = spring_joints(compiled)
    places = compiled.jnt_dofadr[springs]
    k = compiled.jnt_stiffness[springs]
    inertia = compiled.dof_M0[places]
    compiled.dof_damping[places] = 2.0 * DAMPING * np.sqrt(k * inertia)
    inverse, rooted = _inverse_inertia(compiled)[np.ix_(places, places)], np.sqrt(k)
    fastest = np.sqrt(np.linalg.eigvalsh(rooted[:, None] * inverse * rooted)[-1])
    count = int(np.ceil(compiled.opt.timestep * fastest / _STEP_OF_VIBRATION))
    if count > _MOST_STEPS:
        raise SpringError(
            f"a spring behind a motor vibrates at {fastest / (2 * np.pi):.0f} Hz: "
            f"too stiff to be distinguished from a rigid joint; leave the stiffness out"
        )
    compiled.opt.timestep /= max(count, 1)


def spring_joints(compiled: Any) -> IntArray:
    """Return the joints of a compiled model that are springs behind motors."""
    names = [compiled.joint(j).name for j in range(compiled.njnt)]
    return np.array([j for j, n in enumerate(names) if n.endswith(SUFFIX)], np.intp)


def deflect(compiled: Any, data: Any, acceleration: Vector) -> None:
    """Deflect springs into equilibrium with their load, in a state of the motors.

    Parameters
    ----------
    data : mujoco.MjData
        With positions and velocities of the motors; those of springs are zero.
    acceleration : ndarray, shape (degrees of freedom,), [rad/s^2 or m/s^2]
        Acceleration of the motors.
    """
    springs = spring_joints(compiled)
    if not len(springs):
        return
    mujoco = require_mujoco()
    data.qacc[:] = acceleration
    mujoco.mj_inverse(compiled, data)
    carried = data.qfrc_inverse[compiled.jnt_dofadr[springs]]
    data.qpos[compiled.jnt_qposadr[springs]] = (
        -carried / compiled.jnt_stiffness[springs]
    )
