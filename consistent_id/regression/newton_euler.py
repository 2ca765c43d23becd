"""The regressor recursion, written once, on scalars, and a robot's motion for it.

A scalar is anything with ``+``, ``-`` and ``*``: a float, an array of samples, a
CasADi expression.  Vectors are 3-tuples of scalars, so that one text serves every
number type, and structural zeros stay Python numbers, which cost nothing.

Link ``k`` moves with angular velocity ``w``, angular acceleration ``dw`` and linear
acceleration less gravity ``a``, all of its frame's origin and in its own axes.  Its
wrench is ``f = m a + W h`` and ``n = I dw + w x I w + h x a``, where
``W h = dw x h + w x (w x h)``.  A unit rate of a generalised coordinate moves the frame
with the screw ``(e, v)``, so by virtual power that coordinate feels ``v.f + e.n``,
which is linear in ``(m, h, I)``.  No backward pass is needed.  A coordinate is a joint
that moves by itself, with those that follow it: their screws add.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import ProblemError
from consistent_id.robot.model import Joint, RobotModel, Transmission

Scalar = Any
Vec = tuple[Scalar, Scalar, Scalar]
Matrix = tuple[Vec, Vec, Vec]
_Screw = tuple[int, Vec, Vec]
_NONE: Vec = (0.0, 0.0, 0.0)


class JointGeometry(NamedTuple):
    """The geometry of a joint for the recursion, in plain Python numbers.

    The joint turns about (or slides along) the third column of `align`, an
    orthonormal basis given in the joint frame; `rotation` and `translation` place the
    joint frame in the parent link's frame.
    """

    parent: int
    slides: bool
    rotation: Matrix
    translation: Vec
    align: Matrix


class JointMotion(NamedTuple):
    """One joint's position, as sine and cosine too, and its two derivatives.

    All of them follow from the robot's generalised coordinate of number `coordinate`,
    whose unit rate is the rate `ratio` of the joint.
    """

    q: Scalar
    sin: Scalar
    cos: Scalar
    dq: Scalar
    ddq: Scalar
    coordinate: int
    ratio: float = 1.0


class FreeMotion(NamedTuple):
    """The motion of a free base, in its own axes, and the numbers of its coordinates.

    `w` and `dw` are its angular velocity and acceleration, `a` is the acceleration of
    its frame's origin less gravity: what an accelerometer there measures.  The first
    three coordinates move it along its axes, the others turn it about them.
    """

    w: Vec
    dw: Vec
    a: Vec
    coordinates: tuple[int, int, int, int, int, int]


class MovingLink(NamedTuple):
    """A link's motion, and the unit screws ``(coordinate, e, v)`` that move it."""

    w: Vec
    dw: Vec
    a: Vec
    screws: tuple[_Screw, ...]
    W: Matrix


def regressor_entries(
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
) -> Iterator[tuple[int, int, tuple[Scalar, ...]]]:
    """Yield ``(coordinate, link, entries)`` for each link and what moves it.

    `motion` is that of the joints, one by one; where the base is free, that of the base
    first, which knows of gravity.  `entries` are the coefficients of
    ``m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz`` of the link in the coordinate's
    torque (force, for a sliding joint).
    """
    for k, state in enumerate(link_states(joints, gravity, motion)):
        for j, e, v in state.screws:
            yield j, k, _entries(e, v, state)


def torque_parts(
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
    bodies: Sequence[Sequence[Scalar]],
) -> Iterator[tuple[int, int, Scalar]]:
    """Yield ``(coordinate, link, torque)``: the torque to move each link.

    `bodies` holds the ten inertial parameters of each link.  The sum over links is the
    torque; with parameters known, that costs a fraction of `regressor_entries`.
    """
    for k, state in enumerate(link_states(joints, gravity, motion)):
        f, n = link_wrench(state, bodies[k])
        for j, e, v in state.screws:
            yield j, k, plus(dot(v, f), dot(e, n))


def coordinate_torques(
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
    bodies: Sequence[Sequence[Sequence[Scalar]]],
) -> Iterator[tuple[int, int, Scalar]]:
    """Yield ``(robot, coordinate, torque)`` of robots that move alike.

    `bodies` holds for each robot the ten inertial parameters of each link.  A backward
    pass carries the sum of wrenches from link to link: in long chains it takes half as
    long as `torque_parts`, which needs the screws of all coordinates at each link.
    Several torques of one coordinate, of joints that follow it, add up.
    """
    states = list(link_states(joints, gravity, motion, screws=False))
    for robot, each in enumerate(bodies):
        wrenches = [
            link_wrench(link, body) for link, body in zip(states, each, strict=True)
        ]
        for k in reversed(range(len(states))):
            joint, moves, (f, n) = joints[k], motion[k], wrenches[k]
            if isinstance(moves, FreeMotion):
                for j, value in zip(moves.coordinates, (*f, *n), strict=True):
                    yield robot, j, value
                continue
            yield robot, moves.coordinate, along_axis(joint, moves, f, n)
            if joint.parent >= 0:
                f, n = into_parent(joint, moves, f), into_parent(joint, moves, n)
                others_f, others_n = wrenches[joint.parent]
                n = add(n, cross(arm_of(joint, moves), f))
                wrenches[joint.parent] = add(others_f, f), add(others_n, n)


def link_states(
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
    *,
    screws: bool = True,
) -> Iterator[MovingLink]:
    """Yield the state of each link, parents first; perhaps without its screws."""
    at_rest = (-gravity[0], -gravity[1], -gravity[2])
    base = MovingLink(_NONE, _NONE, at_rest, (), (_NONE, _NONE, _NONE))
    states: list[MovingLink] = []
    for joint, moves in zip(joints, motion, strict=True):
        if isinstance(moves, FreeMotion):
            states.append(_free(moves))
            yield states[-1]
            continue
        parent = base if joint.parent < 0 else states[joint.parent]
        states.append(_child(joint, moves, parent, screws=screws))
        yield states[-1]


def _free(base: FreeMotion) -> MovingLink:
    """Return the state of a free base; unit rates push and turn it along its axes."""
    units: tuple[Vec, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    screws = [(_NONE, unit) for unit in units] + [(unit, _NONE) for unit in units]
    numbered = zip(base.coordinates, screws, strict=True)
    of_base = tuple((j, e, v) for j, (e, v) in numbered)
    return MovingLink(base.w, base.dw, base.a, of_base, _spin(base.w, base.dw))


def link_wrench(link: MovingLink, body: Sequence[Scalar]) -> tuple[Vec, Vec]:
    """``f = m a + W h`` and ``n = I dw + w x I w + h x a``."""
    m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz = body
    h = (hx, hy, hz)
    J = ((Ixx, Ixy, Ixz), (Ixy, Iyy, Iyz), (Ixz, Iyz, Izz))
    f = add(scaled(m, link.a), matvec(link.W, h))
    n = add(matvec(J, link.dw), cross(link.w, matvec(J, link.w)))
    return f, add(n, cross(h, link.a))


def _child(
    joint: JointGeometry, moves: JointMotion, parent: MovingLink, *, screws: bool
) -> MovingLink:
    """Carry the parent's state over a joint into its link's frame."""
    axis, arm = axis_of(joint), arm_of(joint, moves)
    w = into_link(joint, moves, parent.w)
    dw = into_link(joint, moves, parent.dw)
    a = into_link(joint, moves, add(parent.a, matvec(parent.W, arm)))
    rate, push = scaled(moves.dq, axis), scaled(moves.ddq, axis)
    coupled = cross(w, rate)
    if joint.slides:
        a = add(add(a, push), scaled(2.0, coupled))
    else:
        w, dw = add(w, rate), add(add(dw, push), coupled)
    if not screws:
        return MovingLink(w, dw, a, (), _spin(w, dw))
    carried = tuple(
        (j, into_link(joint, moves, e), into_link(joint, moves, add(v, cross(e, arm))))
        for j, e, v in parent.screws
    )
    own = _moved(carried, joint.slides, axis, moves)
    return MovingLink(w, dw, a, own, _spin(w, dw))


def axis_of(joint: JointGeometry) -> Vec:
    """Return a joint's axis, in the joint's frame as in its link's."""
    return joint.align[0][2], joint.align[1][2], joint.align[2][2]


def arm_of(joint: JointGeometry, moves: JointMotion) -> Vec:
    """Return the place of a link's frame in that of its parent."""
    if not joint.slides:
        return joint.translation
    slid = scaled(moves.q, matvec(joint.rotation, axis_of(joint)))
    return add(joint.translation, slid)


def along_axis(joint: JointGeometry, moves: JointMotion, f: Vec, n: Vec) -> Scalar:
    """Return the torque of a joint's coordinate that balances a wrench on its link."""
    return mul(moves.ratio, dot(axis_of(joint), f if joint.slides else n))


def _moved(
    screws: tuple[_Screw, ...], slides: bool, axis: Vec, moves: JointMotion
) -> tuple[_Screw, ...]:
    """Add a joint's own screw to that of its coordinate."""
    own = scaled(moves.ratio, axis)
    e, v = (_NONE, own) if slides else (own, _NONE)
    for place, (j, others_e, others_v) in enumerate(screws):
        if j == moves.coordinate:
            whole = (j, add(others_e, e), add(others_v, v))
            return (*screws[:place], whole, *screws[place + 1 :])
    return (*screws, (moves.coordinate, e, v))


def _spin(w: Vec, dw: Vec) -> Matrix:
    """``W = [dw x] + w w^T - (w.w) 1``, so that ``W h = dw x h + w x (w x h)``."""
    xx, yy, zz = mul(w[0], w[0]), mul(w[1], w[1]), mul(w[2], w[2])
    xy, xz, yz = mul(w[0], w[1]), mul(w[0], w[2]), mul(w[1], w[2])
    return spin_of((xx, yy, zz), (xy, xz, yz), dw)


def spin_of(squares: Vec, products: Vec, dw: Vec) -> Matrix:
    """Return `_spin`, or its slope, from ``xx, yy, zz`` and ``xy, xz, yz`` of w w^T."""
    (xx, yy, zz), (xy, xz, yz), (x, y, z) = squares, products, dw
    return (
        (minus(0.0, plus(yy, zz)), minus(xy, z), plus(xz, y)),
        (plus(xy, z), minus(0.0, plus(xx, zz)), minus(yz, x)),
        (minus(xz, y), plus(yz, x), minus(0.0, plus(xx, yy))),
    )


def _entries(e: Vec, v: Vec, link: MovingLink) -> tuple[Scalar, ...]:
    """Coefficients of the ten inertial parameters in ``v.f + e.n``.

    The inertia's are those of ``e dw^T + (e x w) w^T``, symmetrised; written out, each
    is linear in ``e`` with entries of ``W`` (or products of rates) as coefficients.
    """
    (x, y, z), (wx, wy, wz), (dwx, dwy, dwz), W = e, link.w, link.dw, link.W
    ux, uy, uz = cross(e, link.w)
    xx, yy, zz = W[0][0], W[1][1], W[2][2]
    return (
        dot(v, link.a),
        *add(matvec_transposed(W, v), cross(link.a, e)),
        plus(mul(x, dwx), mul(ux, wx)),
        plus(minus(mul(y, W[2][1]), mul(x, W[2][0])), mul(z, minus(xx, yy))),
        plus(mul(y, dwy), mul(uy, wy)),
        plus(minus(mul(x, W[1][0]), mul(z, W[1][2])), mul(y, minus(zz, xx))),
        plus(minus(mul(z, W[0][2]), mul(y, W[0][1])), mul(x, minus(yy, zz))),
        plus(mul(z, dwz), mul(uz, wz)),
    )


def into_link(joint: JointGeometry, moves: JointMotion, x: Vec) -> Vec:
    """Turn a vector of the parent link's axes into the link's own axes."""
    x = matvec_transposed(joint.rotation, x)
    if joint.slides:
        return x
    x1, x2, x3 = matvec_transposed(joint.align, x)
    turned = (
        plus(mul(moves.cos, x1), mul(moves.sin, x2)),
        minus(mul(moves.cos, x2), mul(moves.sin, x1)),
        x3,
    )
    return matvec(joint.align, turned)


def into_parent(joint: JointGeometry, moves: JointMotion, x: Vec) -> Vec:
    """Turn a vector of the link's axes into the parent link's axes."""
    if not joint.slides:
        x1, x2, x3 = matvec_transposed(joint.align, x)
        turned = (
            minus(mul(moves.cos, x1), mul(moves.sin, x2)),
            plus(mul(moves.sin, x1), mul(moves.cos, x2)),
            x3,
        )
        x = matvec(joint.align, turned)
    return matvec(joint.rotation, x)


def mul(x: Scalar, y: Scalar) -> Scalar:
    """Product that keeps structural zeros and ones out of the arithmetic."""
    if type(x) is float:
        if x == 0.0:
            return 0.0
        if x == 1.0:
            return y
    if type(y) is float:
        if y == 0.0:
            return 0.0
        if y == 1.0:
            return x
    return x * y


def plus(x: Scalar, y: Scalar) -> Scalar:
    """Sum that keeps structural zeros out."""
    if type(x) is float and x == 0.0:
        return y
    if type(y) is float and y == 0.0:
        return x
    return x + y


def minus(x: Scalar, y: Scalar) -> Scalar:
    """Difference that keeps structural zeros out."""
    return x if type(y) is float and y == 0.0 else x - y


def scaled(s: Scalar, x: Vec) -> Vec:
    """Return ``s x``."""
    return mul(s, x[0]), mul(s, x[1]), mul(s, x[2])


def add(x: Vec, y: Vec) -> Vec:
    """Return ``x + y``."""
    return plus(x[0], y[0]), plus(x[1], y[1]), plus(x[2], y[2])


def dot(x: Vec, y: Vec) -> Scalar:
    """Return ``x.y``."""
    return plus(plus(mul(x[0], y[0]), mul(x[1], y[1])), mul(x[2], y[2]))


def cross(x: Vec, y: Vec) -> Vec:
    """Return ``x x y``."""
    return (
        minus(mul(x[1], y[2]), mul(x[2], y[1])),
        minus(mul(x[2], y[0]), mul(x[0], y[2])),
        minus(mul(x[0], y[1]), mul(x[1], y[0])),
    )


def matvec(m: Matrix, x: Vec) -> Vec:
    """Return ``m x``."""
    return dot(m[0], x), dot(m[1], x), dot(m[2], x)


def matvec_transposed(m: Matrix, x: Vec) -> Vec:
    """Return ``m^T x``."""
    return add(add(scaled(x[0], m[0]), scaled(x[1], m[1])), scaled(x[2], m[2]))


def joint_geometry(robot: RobotModel) -> tuple[JointGeometry, ...]:
    """Return the data of each joint for the recursion, in plain Python numbers."""
    return tuple(
        JointGeometry(
            parent=joint.parent,
            slides=joint.kind == "prismatic",
            rotation=matrix_rows(joint.rotation),
            translation=floats(joint.translation),
            align=matrix_rows(_basis_with_axis(joint)),
        )
        for joint in robot.joints
    )


def joint_motions(
    robot: RobotModel,
    state: Sequence[Sequence[Scalar] | Array],
    sine_and_cosine: Callable[[Scalar], tuple[Scalar, Scalar]],
) -> list[JointMotion]:
    """Return the motion of all joints, from that of the generalised coordinates.

    `state` holds their positions and the two derivatives; `sine_and_cosine` is that of
    the scalars, whatever they are.

    Raises
    ------
    ProblemError
        If the robot's base floats: see `link_motions`.
    """
    if robot.floating:
        raise ProblemError(
            f"robot {robot.name!r}: its base floats, but how it moves was not given; "
            "give base motion (BaseMotion), or load the robot with a fixed base"
        )
    return _joint_motions(robot.transmissions, state, sine_and_cosine)


def link_motions(
    robot: RobotModel,
    state: Sequence[Sequence[Scalar] | Array],
    sine_and_cosine: Callable[[Scalar], tuple[Scalar, Scalar]],
    base: Sequence[Scalar] | Array | None,
) -> Sequence[JointMotion | FreeMotion]:
    """Return the motion of all joints, and before them that of a base that floats.

    `base` holds the nine numbers of `BaseMotion`, or none for a fixed base.  The
    coordinates of the base are numbered after those of the joints.

    Raises
    ------
    ProblemError
        If a base floats whose motion is not given, or bodies are not connected.
    """
    if not robot.connected:
        raise ProblemError(
            f"robot {robot.name!r}: the connections of its bodies are not known, so "
            "their regressor does not follow from a motion; give it (given_rows)"
        )
    if not robot.floating or base is None:
        return joint_motions(robot, state, sine_and_cosine)
    w, dw, a = ((base[i], base[i + 1], base[i + 2]) for i in (0, 3, 6))
    n = len(robot)
    motions: list[JointMotion | FreeMotion] = [
        FreeMotion(w, dw, a, (n, n + 1, n + 2, n + 3, n + 4, n + 5))
    ]
    motions += _joint_motions(robot.transmissions[1:], state, sine_and_cosine)
    return motions


def _joint_motions(
    transmissions: Sequence[Transmission],
    state: Sequence[Sequence[Scalar] | Array],
    sine_and_cosine: Callable[[Scalar], tuple[Scalar, Scalar]],
) -> list[JointMotion]:
    motions, (q, dq, ddq) = [], state
    for j, ratio, offset in transmissions:
        position, rate, push = q[j], dq[j], ddq[j]
        if (ratio, offset) != (1.0, 0.0):
            position = ratio * position + offset
            rate, push = ratio * rate, ratio * push
        turned = sine_and_cosine(position)
        motions.append(JointMotion(position, *turned, rate, push, j, ratio))
    return motions


def _basis_with_axis(joint: Joint) -> Array:
    """Return a rotation whose third column is the joint's axis.

    A cyclic permutation where the axis is a coordinate axis, so that it costs nothing.
    """
    axis = joint.axis
    if np.count_nonzero(axis) == 1:
        place = int(np.argmax(abs(axis)))
        basis = np.roll(np.eye(3), place - 2, axis=0)
        return basis if axis[place] > 0 else basis * np.array([1.0, -1.0, -1.0])
    helper = np.eye(3)[np.argmin(abs(axis))]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def floats(vector: Vector) -> tuple[float, float, float]:
    """Return the three entries of a vector as Python numbers."""
    x, y, z = vector.tolist()
    return x, y, z


def matrix_rows(matrix: Array) -> tuple[Any, Any, Any]:
    """Return the three rows of a matrix as Python numbers."""
    return floats(matrix[0]), floats(matrix[1]), floats(matrix[2])
