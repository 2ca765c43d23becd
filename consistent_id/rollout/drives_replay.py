"""A file with drives of its own, moved by the commands as they were logged.

The file's actuators have the gains and the delay, so nothing is added: in each of its
time steps, MuJoCo gets the command that is valid then.  As in other replays, the base
is fixed, unused joints are at their locked positions, and there are no contacts.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.robot.loaders import mjcf_spec
from consistent_id.rollout.replay_model import RobotFile, hold_others, quiet


def drives_error(robot: RobotFile, logs: Sequence[Recording]) -> float:
    """Return the root-mean-square error of a file that has drives, [rad or m].

    Parameters
    ----------
    robot : RobotFile
        An MJCF file with a drive for each joint, as `to_mjcf` writes it with a delay.
    logs : sequence of Recording
        With commands, on uniform clocks.

    Raises
    ------
    ModelError
        If MuJoCo refuses the file.
    RecordingError
        If the motion diverges.
    """
    compiled = _compiled(robot)
    errors = [_errors(compiled, robot, log.of(robot.joints)) for log in logs]
    return float(np.sqrt((np.vstack(errors) ** 2).mean()))


def _compiled(robot: RobotFile) -> Any:
    mujoco = require_mujoco()
    spec = mjcf_spec.read_spec(robot.path, mujoco)
    others = [a for a in spec.actuators if a.target not in robot.joints]
    for item in (*spec.keys, *spec.sensors, *others):
        spec.delete(item)
    hold_others(spec, robot.joints, robot.locked, robot.path.name)
    flags = mujoco.mjtDisableBit
    spec.option.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT
    return spec.compile()


def _errors(compiled: Any, robot: RobotFile, log: Recording) -> Matrix:
    """Return the motion's position less that of a log, shape (samples, joints)."""
    from mujoco import rollout

    mujoco = require_mujoco()
    step = float(compiled.opt.timestep)
    # The last step may end behind the log.
    steps = int(np.ceil(log.duration / step - 1e-6))
    control = _controls(compiled, robot, log, step, steps)
    joints = [compiled.joint(name) for name in robot.joints]
    places = [int(joint.qposadr[0]) for joint in joints]
    data = mujoco.MjData(compiled)
    data.qpos[places] = log.position[0]
    data.qvel[[int(joint.dofadr[0]) for joint in joints]] = velocities(log)[0]
    for k in np.flatnonzero(compiled.actuator_delay).tolist():
        first = np.full((int(compiled.actuator_history[k][0]), 1), control[0, k])
        mujoco.mj_initCtrlHistory(compiled, data, k, None, first)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(compiled, kind))
    mujoco.mj_getState(compiled, data, start, kind)
    with quiet():
        states = np.asarray(rollout.rollout(compiled, data, start, control)[0])[0]
    states = np.vstack([start, states])
    if not np.isfinite(states).all() or np.ptp(states[:, 0]) < 0.9 * log.duration:
        raise RecordingError(
            f"{robot.path.name}: its motion under the commands of {log.name} diverges; "
            "check gains, units and the robot's inertias"
        )
    time = log.time[0] + np.arange(steps + 1) * step
    moved = [np.interp(log.time, time, states[:, 1 + place]) for place in places]
    return np.asarray(np.column_stack(moved) - log.position)


def _controls(
    compiled: Any, robot: RobotFile, log: Recording, step: float, steps: int
) -> Matrix:
    """Return the commands that are valid in each step, for each of the actuators."""
    at = log.time[0] + np.arange(steps) * step
    samples = np.searchsorted(log.time, at + 1e-6 * step, side="right") - 1
    control = np.zeros((steps, compiled.nu))
    further = {"velocity": log.velocity_command, "torque": log.torque_command}
    for k in range(compiled.nu):
        joint = compiled.joint(int(compiled.actuator_trnid[k][0])).name
        kind = compiled.actuator(k).name.removeprefix(f"{joint} ")
        if compiled.actuator_biasprm[k].any():  # feedback: the drive, of any name
            kind = "position"
        commands = further.get(kind, log.position_command)
        if commands is not None:
            control[:, k] = commands[samples, robot.joints.index(joint)]
    return control
