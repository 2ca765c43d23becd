"""The text of the stand-alone module: what does not depend on the robot."""

HEAD = '''"""{provenance}

Inverse dynamics, gravity torque and mass matrix, with friction and drive terms. Needs
NumPy and nothing else. SI units; q, dq, ddq have shape (..., {n}), joints in the order
of JOINTS. Bodies: m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the link frame's origin.
"""

import numpy as np

{data}
'''

BODY = '''

def inverse_dynamics(q, dq, ddq):
    """Return joint torques, friction and drive terms included, shape (..., {n})."""
    q, dq, ddq = np.broadcast_arrays(*(np.asarray(x, float) for x in (q, dq, ddq)))
    return rigid_body(q, dq, ddq) + drive(q, dq, ddq)


def gravity(q):
    """Return the torque that holds the bodies at rest, shape (..., {n})."""
    rest = np.zeros_like(np.asarray(q, float))
    return rigid_body(q, rest, rest)


def mass_matrix(q):
    """Return the mass matrix, rotor inertias included, shape (..., {n}, {n})."""
    q = np.asarray(q, float)
    rest = np.zeros_like(q)
    columns = [
        rigid_body(q, rest, rest + unit, gravity=np.zeros(3)) for unit in np.eye({n})
    ]
    return np.stack(columns, axis=-1) + ROTORS


def rigid_body(q, dq, ddq, bodies=BODIES, gravity=GRAVITY):
    """Return joint torques of the bodies alone (recursive Newton-Euler)."""
    q, dq, ddq = (np.asarray(x, float) for x in (q, dq, ddq)){joints}
    state, turns, arms, wrenches = [], [], [], []
    zero = np.zeros((*q.shape[:-1], 3))
    for k, parent in enumerate(PARENT):
        w, dw, a = (zero, zero, zero - gravity) if parent < 0 else state[parent]
        axis, rate, push = AXIS[k], dq[..., k, None], ddq[..., k, None]
        slide = q[..., k, None] * axis if SLIDES[k] else zero
        arm = TRANSLATION[k] + slide @ ROTATION[k].T
        R = ROTATION[k] @ (np.eye(3) if SLIDES[k] else _turn(axis, q[..., k]))
        a = _into(R, a + np.cross(dw, arm) + np.cross(w, np.cross(w, arm)))
        w, dw = _into(R, w), _into(R, dw)
        if SLIDES[k]:
            a = a + push * axis + 2.0 * np.cross(w, rate * axis)
        else:
            dw = dw + push * axis + np.cross(w, rate * axis)
            w = w + rate * axis
        state.append((w, dw, a))
        turns.append(R)
        arms.append(arm)
        m, h, inertia = bodies[k][0], bodies[k][1:4], _inertia(bodies[k])
        force = m * a + np.cross(dw, h) + np.cross(w, np.cross(w, h))
        moment = dw @ inertia + np.cross(w, w @ inertia) + np.cross(h, a)
        wrenches.append((force, moment))
    tau = np.zeros(q.shape)
    for k in reversed(range(len(PARENT))):
        force, moment = wrenches[k]
        tau[..., k] = (force if SLIDES[k] else moment) @ AXIS[k]
        if PARENT[k] >= 0:
            f, n = wrenches[PARENT[k]]
            force, moment = _out_of(turns[k], force), _out_of(turns[k], moment)
            wrenches[PARENT[k]] = (f + force, n + moment + np.cross(arms[k], force))
    return tau{coordinates}


def _inertia(body):
    xx, xy, yy, xz, yz, zz = body[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _turn(axis, angle):
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + s * K + (1.0 - c) * (K @ K)


def _into(R, x):
    return np.einsum("...ji,...j->...i", R, x)


def _out_of(R, x):
    return np.einsum("...ij,...j->...i", R, x)
'''
