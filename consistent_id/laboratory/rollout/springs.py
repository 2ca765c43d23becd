"""Springs between motors and links, in MuJoCo.

The body of an elastic joint gets a second joint on the same axis.  The first has rotor
inertia, friction and drive, and is where the motor is; the second has the spring, and
is by how much the link is away from there.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from consistent_id._support.arrays import IntArray, Vector
from consistent_id.errors import ModelError
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.export.mjcf_tree import spec_tree
from consistent_id.regression.elastic_joints import DAMPING

SUFFIX = " spring"  # of the second joint's name

_SHARE = 0.5
"""Of the fastest vibration's radian: the longest time step.  Semi-implicit steps are
stable up to 2; at this one its frequency is right to 1 %."""

_LEAST_ROTOR = 0.01
"""Of the link's inertia: geared motors have more, and a spring needs two masses."""

_MOST = 20  # time steps, at most, in place of one


class SpringError(ModelError):
    """A joint cannot have the spring that it is given."""


def add_springs(
    spec: Any, compiled: Any, joints: Sequence[str], stiffness: Vector
) -> None:
    """Add a spring behind each motor whose stiffness is finite.

    Parameters
    ----------
    compiled : mujoco.MjModel
        Of it, without springs.
    stiffness : ndarray, shape (joints,), [N m/rad or N/m]

    Raises
    ------
    SpringError
        If nothing to speak of is between a drive and its spring.
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
    mujoco = require_mujoco()
    places = compiled.jnt_dofadr[springs]
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    k = compiled.jnt_stiffness[springs]
    inertia = compiled.dof_M0[places]
    compiled.dof_damping[places] = 2.0 * DAMPING * np.sqrt(k * inertia)
    inverse, rooted = np.zeros((compiled.nv, compiled.nv)), np.sqrt(k)
    mujoco.mj_solveM(compiled, data, inverse, np.eye(compiled.nv))
    inverse = inverse[np.ix_(places, places)]
    fastest = np.sqrt(np.linalg.eigvalsh(rooted[:, None] * inverse * rooted)[-1])
    count = int(np.ceil(compiled.opt.timestep * fastest / _SHARE))
    if count > _MOST:
        raise SpringError(
            f"a spring behind a motor vibrates at {fastest / (2 * np.pi):.0f} Hz: too "
            "stiff to be told from a rigid joint by motion; leave the stiffness out"
        )
    compiled.opt.timestep /= max(count, 1)


def spring_joints(compiled: Any) -> IntArray:
    """Return the joints of a compiled model that are springs behind motors."""
    names = [compiled.joint(j).name for j in range(compiled.njnt)]
    return np.array([j for j, n in enumerate(names) if n.endswith(SUFFIX)], np.intp)


def deflect(compiled: Any, data: Any, acceleration: Vector) -> None:
    """Deflect springs as far as what they carry asks for, in a state of the motors.

    Parameters
    ----------
    data : mujoco.MjData
        With positions and velocities of the motors; those of springs are zero.
    acceleration : ndarray, shape (degrees of freedom,), [rad/s^2 or m/s^2]
        Of the motors.
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
