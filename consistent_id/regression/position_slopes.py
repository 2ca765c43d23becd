"""The derivative of the torque by the positions of joints, exact.

A joint that turns leaves the motion behind it as the link before sees it.  In the axes
of its own link, with the joint's axis ``e``, the motion ``(w, dw, a)`` then changes by
``(w x e, dw x e, a x e)``.  A joint that slides changes ``a`` alone, by ``W e``.
Changes are carried outwards like the motion itself, and change the wrenches ``f`` and
``n`` of links.  Changes of wrenches are carried inwards; beyond the joint, the wrench
that it passes on turns or moves as well.  Links that it does not carry take no part.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector, chunks
from consistent_id.regression.newton_euler import (
    JointGeometry,
    JointMotion,
    Matrix,
    MovingLink,
    Scalar,
    Vec,
    add,
    along_axis,
    arm_of,
    axis_of,
    cross,
    floats,
    into_link,
    into_parent,
    joint_geometry,
    joint_motions,
    link_states,
    link_wrench,
    matvec,
    mul,
    plus,
    scaled,
    spin_of,
)
from consistent_id.regression.regressor import CHUNK, TorqueModel

_STEP = 1e-4  # rad or m, of the finite differences of drive terms
_NONE: Vec = (0.0, 0.0, 0.0)


class _MotionSlope(NamedTuple):
    """Slopes of a link's motion, as in `MovingLink`."""

    w: Vec
    dw: Vec
    a: Vec
    W: Matrix


class _CarriedLinks(NamedTuple):
    """Links along a motion, and what each passes on to its parent, in its own axes."""

    joints: Sequence[JointGeometry]
    motion: Sequence[JointMotion]
    states: Sequence[MovingLink]
    bodies: Sequence[Sequence[float]]
    passed: Sequence[tuple[Vec, Vec]]


def position_slopes(
    model: TorqueModel, x: Vector, state: Sequence[Array], joints: Sequence[int]
) -> Array:
    """Return slopes of the torque of parameters over positions of some joints.

    Drive terms that depend on position or load are differentiated numerically.

    Parameters
    ----------
    model : TorqueModel
        With a fixed base.
    x : ndarray, shape (parameters,)
    state : three ndarray, each shape (samples, joints)
        Positions and their two derivatives.
    joints : sequence of int

    Returns
    -------
    ndarray, shape (torque joints, joints given, samples)
    """
    size, row = model.layout.inertial_size, model.rows
    reference = model.load_reference if x[size:].any() else None
    slopes = np.zeros((len(model.torque_joints), len(joints), len(state[0])))
    for part in chunks(len(state[0]), CHUNK):
        few = [np.ascontiguousarray(values[part].T) for values in state]
        _, own = _rigid(model, x[:size], few, joints)
        for j, i in row.items():
            slopes[i, :, part] = own[j]
        if reference is not None:
            loads, moved = _rigid(model, reference, few, joints)
            slopes[:, :, part] += _drives(model, x, few, joints, (loads, moved))
        elif x[size:].any():
            slopes[:, :, part] += _drives(model, x, few, joints, None)
    return slopes


def _rigid(
    model: TorqueModel, bodies: Vector, state: Sequence[Array], joints: Sequence[int]
) -> tuple[Array, Array]:
    """Return torque of all coordinates, (joints, samples), and its slopes over some."""
    robot = model.robot
    tree = _tree(model, bodies, state)
    torque = np.zeros((len(robot), state[0].shape[1]))
    slopes = np.zeros((len(robot), len(joints), state[0].shape[1]))
    for joint, moves, wrench in zip(tree.joints, tree.motion, tree.passed, strict=True):
        torque[moves.coordinate] += along_axis(joint, moves, *wrench)
    for k, moves in enumerate(tree.motion):
        for place in (c for c, j in enumerate(joints) if j == moves.coordinate):
            for i, value in _of_joint(tree, k).items():
                slopes[tree.motion[i].coordinate, place] += moves.ratio * value
    return torque, slopes


def _tree(model: TorqueModel, bodies: Vector, state: Sequence[Array]) -> _CarriedLinks:
    joints = joint_geometry(model.robot)
    motion = joint_motions(model.robot, state, lambda x: (np.sin(x), np.cos(x)))
    gravity, each = floats(model.robot.gravity), bodies.reshape(-1, 10).tolist()
    states = list(link_states(joints, gravity, motion, screws=False))
    passed = [link_wrench(link, body) for link, body in zip(states, each, strict=True)]
    for k in reversed(range(len(states))):
        if (parent := joints[k].parent) >= 0:
            passed[parent] = _sum(
                passed[parent], _inwards(joints[k], motion[k], passed[k])
            )
    return _CarriedLinks(joints, motion, states, each, passed)


def _of_joint(tree: _CarriedLinks, k: int) -> dict[int, Scalar]:
    """Return slopes of the torques of joints over the position of one of them."""
    joints, motion, states = tree.joints, tree.motion, tree.states
    changes = {k: _own(joints[k], states[k])}
    for i in range(k + 1, len(joints)):
        if joints[i].parent in changes:
            before = changes[joints[i].parent]
            changes[i] = _carried(joints[i], motion[i], states[i], before)
    wrenches = {i: _wrench(states[i], c, tree.bodies[i]) for i, c in changes.items()}
    slopes = {}
    for i in sorted(changes, reverse=True):
        slopes[i] = along_axis(joints[i], motion[i], *wrenches[i])
        if i != k:
            inwards = _inwards(joints[i], motion[i], wrenches[i])
            wrenches[joints[i].parent] = _sum(wrenches[joints[i].parent], inwards)
    wrench, i = _beyond(joints[k], motion[k], tree.passed[k], wrenches[k]), k
    while (i := joints[i].parent) >= 0:
        slopes[i] = along_axis(joints[i], motion[i], *wrench)
        wrench = _inwards(joints[i], motion[i], wrench)
    return slopes


def _own(joint: JointGeometry, link: MovingLink) -> _MotionSlope:
    """Return the derivative of a link's motion by the position of its own joint."""
    axis = axis_of(joint)
    if joint.slides:
        return _MotionSlope(_NONE, _NONE, matvec(link.W, axis), (_NONE, _NONE, _NONE))
    w, dw, a = (cross(rate, axis) for rate in (link.w, link.dw, link.a))
    return _MotionSlope(w, dw, a, _spin(link.w, w, dw))


def _carried(
    joint: JointGeometry, moves: JointMotion, link: MovingLink, before: _MotionSlope
) -> _MotionSlope:
    """Carry the change of the parent's motion over a joint."""
    w, dw = into_link(joint, moves, before.w), into_link(joint, moves, before.dw)
    arm = matvec(before.W, arm_of(joint, moves))
    a = into_link(joint, moves, add(before.a, arm))
    coupled = cross(w, scaled(moves.dq, axis_of(joint)))
    if joint.slides:
        a = add(a, scaled(2.0, coupled))
    else:
        dw = add(dw, coupled)
    return _MotionSlope(w, dw, a, _spin(link.w, w, dw))


def _spin(w: Vec, u: Vec, du: Vec) -> Matrix:
    """Return the slope of ``W``, with those of ``w`` and ``dw``."""

    def both(i: int, j: int) -> Scalar:
        return plus(mul(w[i], u[j]), mul(w[j], u[i]))

    squares, products = (
        (both(0, 0), both(1, 1), both(2, 2)),
        (both(0, 1), both(0, 2), both(1, 2)),
    )
    return spin_of(squares, products, du)


def _wrench(
    link: MovingLink, change: _MotionSlope, body: Sequence[Scalar]
) -> tuple[Vec, Vec]:
    """Return the slope of a link's wrench."""
    m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz = body
    h = (hx, hy, hz)
    J = ((Ixx, Ixy, Ixz), (Ixy, Iyy, Iyz), (Ixz, Iyz, Izz))
    f = add(scaled(m, change.a), matvec(change.W, h))
    turned = add(cross(change.w, matvec(J, link.w)), cross(link.w, matvec(J, change.w)))
    n = add(matvec(J, change.dw), turned)
    return f, add(n, cross(h, change.a))


def _sum(one: tuple[Vec, Vec], other: tuple[Vec, Vec]) -> tuple[Vec, Vec]:
    return add(one[0], other[0]), add(one[1], other[1])


def _inwards(
    joint: JointGeometry, moves: JointMotion, wrench: tuple[Vec, Vec]
) -> tuple[Vec, Vec]:
    """Carry a wrench into the axes and to the origin of the parent link."""
    f, n = (into_parent(joint, moves, x) for x in wrench)
    return f, add(n, cross(arm_of(joint, moves), f))


def _beyond(
    joint: JointGeometry,
    moves: JointMotion,
    passed: tuple[Vec, Vec],
    change: tuple[Vec, Vec],
) -> tuple[Vec, Vec]:
    """Return the derivative of a joint's passed-on wrench by its own position."""
    axis = axis_of(joint)
    if not joint.slides:
        f, n = (
            add(x, cross(axis, whole)) for x, whole in zip(change, passed, strict=True)
        )
        return _inwards(joint, moves, (f, n))
    f, n = _inwards(joint, moves, change)
    along = cross(matvec(joint.rotation, axis), into_parent(joint, moves, passed[0]))
    return f, add(n, along)


def _drives(
    model: TorqueModel,
    x: Vector,
    state: Sequence[Array],
    joints: Sequence[int],
    loads: tuple[Array, Array] | None,
) -> Array:
    """Return the slopes of drive terms, shape (torque joints, joints given, samples).

    Parameters
    ----------
    loads : tuple of ndarray, shapes (joints, samples) and (joints, moved, samples)
        Transmitted torque of all joints, and its slopes.
    """
    (q, dq, ddq), column = state, model.layout.inertial_size
    slopes = np.zeros((len(model.torque_joints), len(joints), q.shape[1]))
    for i, terms in enumerate(model.terms):
        own, column = x[column : column + len(terms.names)], column + len(terms.names)
        loaded = terms.needs_load and loads is not None
        if i not in model.rows or not own.any() or (terms.needs_load and not loaded):
            continue
        for place, j in enumerate(joints):
            if i != j and not loaded:
                continue
            sides = []
            for step in (_STEP, -_STEP):
                place_of_joint = q[i] + step if i == j else q[i]
                load = None
                if loaded and loads is not None:
                    load = loads[0][i] + step * loads[1][i, place]
                columns = terms.columns(place_of_joint, dq[i], ddq[i], load)
                sides.append(sum(c * v for c, v in zip(own, columns, strict=True)))
            slopes[model.rows[i], place] = (sides[0] - sides[1]) / (2.0 * _STEP)
    return slopes
