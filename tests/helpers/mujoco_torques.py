"""Torques by MuJoCo's inverse dynamics."""

import numpy as np

from consistent_id import DriveTerms

SPRUNG = DriveTerms(
    viscous=True,
    coulomb="sign",
    offset=True,
    rotor_inertia=True,
    spring=True,
    drag=True,
)


def inverse_dynamics(model, names, states, locked=()):
    """Return torques of joints without limits, shape (samples, joints)."""
    import mujoco

    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    places = [int(model.joint(name).dofadr[0]) for name in names]
    torques = []
    for q, dq, ddq in zip(*states, strict=True):
        for name, position in dict(locked).items():
            data.qpos[model.joint(name).qposadr[0]] = position
        data.qpos[places], data.qvel[places], data.qacc[places] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse[places].copy())
    return np.array(torques)
