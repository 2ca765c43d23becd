"""Smooth motion of a quadruped that pushes itself off with its feet, as a log."""

from typing import NamedTuple

import numpy as np
from quadrupeds import FEET, FOOT

from consistent_id import DriveTerms, TorqueModel
from consistent_id.recordings import BaseMotion
from consistent_id.regression import contact_jacobian
from consistent_id.signals import rotations

RATE = 200.0
STEP = 2.0  # s, in half of which each foot in turn is in the air


def waves(rng, time, columns, size):
    """Return sums of three sinusoids and their first two derivatives."""
    f = 2 * np.pi * rng.uniform(0.2, 1.0, (3, 1, columns))
    phase = rng.uniform(0, 2 * np.pi, (3, 1, columns))
    s, c = np.sin(f * time[:, None] + phase), np.cos(f * time[:, None] + phase)
    return [size * x.sum(axis=0) for x in (s, f * c, -(f**2) * s)]


def loads(time):
    """Return how much each foot bears: nothing in the air, and no jump before or after.

    Shape (samples, feet).
    """
    phase = (time[:, None] / STEP - np.arange(4)) % 4
    ramp = np.clip(np.minimum(2 * phase - 1, 8 - 2 * phase), 0, 1)
    return ramp**3 * (10 - 15 * ramp + 6 * ramp**2)


def turns(rng, time):
    """Return turns about a fixed axis, then one of the base: rates in closed form.

    Quaternions, real part first; rates and their derivatives in base axes.
    """
    (angle, inner), (rate, spin), (push, twist) = (
        w.T[:, :, None] for w in waves(rng, time, 2, 0.3)
    )
    fixed, own = np.array([0.36, 0.48, 0.8]), np.array([0.8, -0.6, 0.0])
    first = np.hstack([np.cos(angle / 2), np.sin(angle / 2) * fixed])
    second = np.hstack([np.cos(inner / 2), np.sin(inner / 2) * own])
    (p, u), (r, v) = ((x[:, :1], x[:, 1:]) for x in (first, second))
    vector = p * v + r * u + np.cross(u, v)
    quaternion = np.hstack([p * r - (u * v).sum(axis=1, keepdims=True), vector])
    seen = fixed @ rotations(second, "wxyz")  # the fixed axis in base axes
    w = spin * own + rate * seen
    dw = twist * own + push * seen - rate * spin * np.cross(own, seen)
    return quaternion, w, dw


class Walk(NamedTuple):
    """A motion on feet: states, torques, and the forces of the feet in base axes."""

    time: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    place: np.ndarray
    quaternion: np.ndarray
    base: BaseMotion
    torque: np.ndarray
    closed: np.ndarray
    forces: np.ndarray


def walked(robot, parameters, *, seconds=20.0, seed=0, drive=None, radius=0.0):
    """Return a walk of a robot with parameters of its links, then of its drives if any.

    Forces act where the feet are and balance the base's rows, whatever the ground.  A
    foot is a point, or a ball of a radius [m] about it.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * RATE)) / RATE
    q, dq, ddq = waves(rng, time, len(robot), 0.1)
    x, _, a = waves(rng, time, 3, 0.05)
    quaternion, w, dw = turns(rng, time)
    R = rotations(quaternion, "wxyz")
    felt = np.einsum("nij,ni->nj", R, a + np.array([0.0, 0.0, 9.81]))
    spin = BaseMotion(w, dw, felt, R)
    model = TorqueModel(robot, drive or DriveTerms())
    forces = model.predict(parameters, q, dq, ddq, base=spin)
    load = loads(time)
    lowest = -radius * R[:, 2, :, None]  # point of a foot, from its centre
    J = [contact_jacobian(robot, q, frame=foot, point=FOOT) for foot in FEET]
    J = [whole[:, :3] + np.cross(whole[:, 3:], lowest, axis=1) for whole in J]
    pushes, share = np.concatenate(J, axis=1), np.repeat(load, 3, axis=1)
    balance = np.linalg.pinv(np.swapaxes(share[..., None] * pushes[:, :, :6], 1, 2))
    acting = share * np.einsum("nfr,nr->nf", balance, forces[:, :6])
    torque = (forces - np.einsum("nfr,nf->nr", pushes, acting))[:, 6:]
    return Walk(time, q, dq, ddq, x, quaternion, spin, torque, load > 0.0, acting)


def walk(robot, parameters, *, seconds=20.0, seed=0, drive=None):
    """Return columns of a log of `walked`, by name, and the wrenches of the feet."""
    moved = walked(robot, parameters, seconds=seconds, seed=seed, drive=drive)
    log = {"time": moved.time}
    log |= {f"q_{j}": moved.q[:, i] for i, j in enumerate(robot.joint_names)}
    log |= {f"tau_{j}": moved.torque[:, i] for i, j in enumerate(robot.joint_names)}
    for name, values in (
        ("gyro", moved.base.angular_velocity),
        ("acc", moved.base.specific_force),
        ("place", moved.place),
    ):
        log |= {f"{name}_{c}": values[:, i] for i, c in enumerate("xyz")}
    log |= {f"quat_{c}": moved.quaternion[:, i] for i, c in enumerate("wxyz")}
    log |= {f"contact_{foot}": 1.0 * moved.closed[:, i] for i, foot in enumerate(FEET)}
    for i, foot in enumerate(FEET):
        log |= {f"{foot}_f{c}": moved.forces[:, 3 * i + k] for k, c in enumerate("xyz")}
    return log


def write_csv(path, log):
    """Write columns as a table."""
    rows = np.column_stack(list(log.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(log), comments="")
