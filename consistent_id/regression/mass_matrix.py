"""The joint-space mass matrix over many poses, and its least eigenvalue.

By composite bodies [Featherstone2008]_, all in the base frame.  A unit rate of joint
``j`` moves the links behind it, taken as one body of mass ``m``, first moment ``h`` and
second moment ``S``, with the twist ``(e, v)``.  That body's momentum is
``f = m v + e x h`` and ``n = tr(S) e - S e + h x v``, and for ``i`` on the way from the
base to ``j`` ``M_ij = e_i.n_j + v_i.f_j``.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    chunks,
)
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.robot.inertia import pseudo_inertia
from consistent_id.robot.kinematics import ancestors
from consistent_id.robot.model import Joint, RobotModel

POSES = 10_000
"""Random poses at which mass matrices are examined."""

_PIVOT = 1e-100  # below, a division may overflow
_FIRST = 64  # poses from whose least eigenvalue the search for a smaller one starts
_SYMMETRIC = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # of xx, yy, zz, xy, xz, yz
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the same entries


class _BodyTree(NamedTuple):
    """Moving joints, those before others that they carry.

    Parameters
    ----------
    parents : ndarray, shape (joints,)
        Places of the joints that carry them; -1 for the base.
    slides : ndarray, shape (joints,)
        Whether a joint slides.
    parts : ndarray, shape (joints, 4, 12)
        Rotation by rows, then origin, of the link in its parent's axes: what is
        constant, and what goes with sine, cosine and position.
    axes : ndarray, shape (joints, 3)
        In the link's own axes.
    """

    parents: IntArray
    slides: BoolArray
    parts: Array
    axes: Array


def random_poses(model: TorqueModel, count: int, seed: int) -> Array:
    """Return random positions within the joints' limits, shape (count, joints)."""
    rng = np.random.default_rng(seed)
    lower, upper = [], []
    for joint in model.robot.driven:
        reach = 1.0 if joint.kind == "prismatic" else np.pi
        low, high = joint.limits.lower, joint.limits.upper
        low = low if np.isfinite(low) else min(-reach, high - reach)
        lower.append(low)
        upper.append(high if np.isfinite(high) else max(reach, low + reach))
    return rng.uniform(lower, upper, (count, len(model.robot)))


def mass_matrices(model: TorqueModel, parameters: Vector, q: Array) -> Array:
    """Return mass matrices, shape (poses, joints, joints), [kg m^2 or kg].

    Symmetric; rotor inertia and couplings are part of them.
    """
    links, drives = _links_and_drives(model, parameters)
    whole = _blocks(model.robot, links, drives, q, [np.arange(len(model.robot))])
    return np.moveaxis(whole[0], 2, 0)


def _links_and_drives(model: TorqueModel, parameters: Vector) -> tuple[Array, Matrix]:
    """Return the bodies, and what accelerations ask of the drives at every pose."""
    n = len(model.robot)
    rest, unit = np.zeros((n, n + 1)), np.eye(n, n + 1)
    torque, loads = np.zeros((n, n + 1)), dict.fromkeys(range(n), np.zeros(n + 1))
    for j, column, values in model.drive_entries(rest, rest, unit, loads):
        torque[j] += parameters[column] * values
    links = parameters[: model.layout.inertial_size].reshape(-1, 10)
    return links, np.asarray(torque[:, :n] - torque[:, n:])


def _blocks(
    robot: RobotModel,
    links: Array,
    drives: Matrix,
    q: Array,
    groups: Sequence[IntArray],
) -> list[Array]:
    """Return blocks of mass matrices, each shape (joints, joints, poses)."""
    blocks = [
        np.repeat(drives[np.ix_(group, group)][:, :, None], len(q), axis=2)
        for group in groups
    ]
    places = {
        a: (block, i)
        for block, group in zip(blocks, groups, strict=True)
        for i, a in enumerate(group.tolist())
    }
    for part, a, b, values in _of_links(robot, links, q):
        (block, i), (_, j) = places[a], places[b]
        block[i, j, part] += values
        if i != j:
            block[j, i, part] += values
    return blocks


def _of_links(
    robot: RobotModel, links: Array, q: Array
) -> Iterator[tuple[slice, int, int, Vector]]:
    """Yield ``(poses, a, b, values)`` of coordinates that share links.

    Values of the same coordinates add up; of ``(a, b)`` and ``(b, a)`` one comes.
    """
    moves = robot.transmissions
    moving = [k for k, moved in enumerate(moves) if moved.ratio]
    tree, moments = _tree_of(robot, moving), _moments_of(links[moving])
    every = robot.joint_positions(q).T[moving]
    for part in chunks(len(q), CHUNK):
        x = every[:, part]
        positions = np.stack([x, np.sin(x), np.cos(x)], axis=1)
        for (i, j), values in _entries(tree, moments, positions):
            first, second = moves[moving[i]], moves[moving[j]]
            a, b = first.coordinate, second.coordinate
            both = first.ratio * second.ratio * (2.0 if a == b and i != j else 1.0)
            yield part, a, b, values if both == 1.0 else both * values


def least_mass_eigenvalue(model: TorqueModel, parameters: Vector, q: Array) -> float:
    """Return the smallest eigenvalue of the mass matrix over poses.

    That of the joints: a base that floats counts as held.  Bodies without joints have
    the least eigenvalue of their pseudo-inertias.

    Limbs that share no moving body are blocks of the matrix, with eigenvalues of their
    own.  These are computed where ``M - least 1`` is not positive definite, with the
    least eigenvalue of some of the poses: elsewhere all are larger.
    """
    if not len(model.robot):
        bodies = parameters[: model.layout.inertial_size].reshape(-1, 10)
        return float(np.linalg.eigvalsh(pseudo_inertia(bodies)).min())
    links, drives = _links_and_drives(model, parameters)
    limbs = _limbs(model.robot, drives)
    blocks = _blocks(model.robot, links, drives, q, limbs)
    least = min(_least(M[:, :, :_FIRST]) for M in blocks)
    below = (M[:, :, ~_positive_definite(M, least)] for M in blocks)
    return min(least, *map(_least, below))


def _least(M: Array) -> float:
    """Return the least eigenvalue of matrices, shape (joints, joints, poses)."""
    values = np.linalg.eigvalsh(np.moveaxis(M, 2, 0))
    return float(values.min(initial=np.inf))


def _limbs(robot: RobotModel, drives: Matrix) -> list[IntArray]:
    """Return groups of joints between which all entries are zero, at every pose."""
    G = robot.joint_rates != 0.0
    linked = np.eye(len(robot.joints), dtype=bool)
    for j in range(len(robot.joints)):
        linked[list(ancestors(robot, j)), j] = True
    pattern = G.T @ linked @ G | (drives != 0.0)
    pattern |= pattern.T
    # The import of scipy.sparse.csgraph takes longer than all else here.
    while ((further := pattern @ pattern) != pattern).any():
        pattern = further
    first = pattern.argmax(axis=1)
    return [np.flatnonzero(first == k) for k in np.unique(first)]


def _positive_definite(M: Array, shift: float) -> BoolArray:
    """Return where ``M - shift 1`` has positive pivots alone, shape (poses,)."""
    A = M.copy()
    A[range(len(A)), range(len(A))] -= shift
    positive = np.ones(A.shape[2], dtype=bool)
    for k in range(len(A)):
        positive &= A[k, k] > _PIVOT
        row = np.where(positive, A[k, k + 1 :], 0.0) / np.where(positive, A[k, k], 1.0)
        for i in range(k + 1, len(A)):
            A[i, i:] -= row[i - k - 1] * A[k, i:]
    return np.asarray(positive)


def _tree_of(robot: RobotModel, moving: list[int]) -> _BodyTree:
    """Return a robot's moving joints, as if each moved by itself."""
    place = {k: i for i, k in enumerate(moving)}
    joints = [robot.joints[k] for k in moving]
    return _BodyTree(
        np.array([place.get(joint.parent, -1) for joint in joints], dtype=np.intp),
        np.array([joint.kind == "prismatic" for joint in joints], dtype=bool),
        np.array([_parts(joint) for joint in joints]).reshape(-1, 4, 12),
        np.array([joint.axis for joint in joints]).reshape(-1, 3),
    )


def _parts(joint: Joint) -> Array:
    """Return the parts of a link's pose that go with 1, sine, cosine and position."""
    R, parts = joint.rotation, np.zeros((4, 12))
    parts[0, 9:] = joint.translation
    if joint.kind == "prismatic":
        parts[0, :9] = R.ravel()
        parts[3, 9:] = R @ joint.axis
        return parts
    K = np.cross(np.eye(3), joint.axis)  # ``K u = axis x u``, of Rodrigues' formula
    rotations = R @ (np.eye(3) + K @ K), R @ K, -R @ K @ K
    parts[:3, :9] = [rotation.ravel() for rotation in rotations]
    return parts


def _moments_of(links: Array) -> Array:
    """Return ``m, h`` and ``S = tr(I) 1 / 2 - I`` of inertial parameters."""
    Ixx, Ixy, Iyy, Ixz, Iyz, Izz = links[:, 4:].T
    half = (Ixx + Iyy + Izz) / 2
    second = half - Ixx, half - Iyy, half - Izz, -Ixy, -Ixz, -Iyz
    return np.column_stack([links[:, :4], *second])


def _entries(
    tree: _BodyTree, moments: Array, positions: Array
) -> Iterator[tuple[tuple[int, int], Vector]]:
    """Yield ``(i, j)``, ``i`` on the way from the base to ``j``, and their entry.

    Of the links' moments, shape (joints, 10), and ``q, sin q, cos q``, shape (joints,
    3, poses).
    """
    poses: list[Array] = []
    twists: list[Array] = []
    bodies: list[Array] = []
    count = positions.shape[2]
    for k, parent in enumerate(tree.parents.tolist()):
        q, sine, cosine = positions[k]
        waves = np.array([np.ones(count), sine, cosine, q])
        flat = tree.parts[k].T @ waves
        R, p = flat[:9].reshape(3, 3, count), flat[9:]
        if parent >= 0:
            before, origin = poses[parent][:, :3], poses[parent][:, 3]
            R, p = _times(before, R), np.einsum("abn,bn->an", before, p) + origin
        poses.append(np.concatenate([R, p[:, None]], axis=1))
        axis = np.einsum("abn,b->an", R, tree.axes[k])
        still = np.zeros_like(axis)
        e, v = (still, axis) if tree.slides[k] else (axis, _cross(p, axis))
        twists.append(np.concatenate([e, v]))
        bodies.append(_moved(moments[k], poses[-1]))
    for j in reversed(range(len(tree.parents))):
        momentum, i = _momentum(bodies[j], twists[j]), j
        while i >= 0:
            yield (i, j), np.einsum("an,an->n", twists[i], momentum)
            i = int(tree.parents[i])
        if (parent := int(tree.parents[j])) >= 0:
            bodies[parent] = bodies[parent] + bodies[j]


def _moved(moments: Vector, pose: Array) -> Array:
    """Return a link's moments at the base, shape (10, poses).

    ``h' = R h + m p`` and ``S' = R S R^T + (R h) p^T + p h'^T``.
    """
    R, p, m, S = pose[:, :3], pose[:, 3], moments[0], moments[4:][_SYMMETRIC]
    turned, before = S @ R, np.asarray(moments[1:4] @ R)
    h = before + m * p
    second = [
        np.einsum("cn,cn->n", turned[a], R[b]) + before[a] * p[b] + p[a] * h[b]
        for a, b in _PAIRS
    ]
    return np.concatenate([np.full((1, p.shape[1]), m), h, second])


def _momentum(body: Array, twist: Array) -> Array:
    """Return ``(n, f)``, shape (6, poses)."""
    m, h, (xx, yy, zz, xy, xz, yz) = body[0], body[1:4], body[4:]
    e, v = twist[:3], twist[3:]
    x, y, z = e
    turning = [
        (yy + zz) * x - xy * y - xz * z,
        (xx + zz) * y - xy * x - yz * z,
        (xx + yy) * z - xz * x - yz * y,
    ]
    return np.concatenate([turning + _cross(h, v), m * v + _cross(e, h)])


def _times(A: Array, B: Array) -> Array:
    return np.asarray(np.einsum("abn,bcn->acn", A, B))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors, shape (3, poses)."""
    x, y, z = a
    u, v, w = b
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
