"""The mass matrix over many poses, by composite bodies [Featherstone2008]_.

All in the base frame.  A unit rate of joint ``j`` moves the links behind it, taken as
one body of mass ``m``, first moment ``h`` and second moment ``S``, with the twist
``(e, v)``.  That body's momentum is ``f = m v + e x h`` and
``n = tr(S) e - S e + h x v``, and for ``i`` on the way from the base to ``j``
``M_ij = e_i.n_j + v_i.f_j``.
"""

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.regression.compiled.masses import Tree
from consistent_id.robot.model import Joint, RobotModel

_SYMMETRIC = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # of xx, yy, zz, xy, xz, yz


def tree_of(robot: RobotModel, moving: list[int]) -> Tree:
    """Return a robot's moving joints, as if each moved by itself."""
    place = {k: i for i, k in enumerate(moving)}
    joints = [robot.joints[k] for k in moving]
    return Tree(
        np.array([place.get(joint.parent, -1) for joint in joints], dtype=np.intp),
        np.array([joint.kind == "prismatic" for joint in joints], dtype=np.intp),
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


def moments_of(links: Array) -> Array:
    """Return ``m, h`` and ``S = tr(I) 1 / 2 - I`` of inertial parameters."""
    Ixx, Ixy, Iyy, Ixz, Iyz, Izz = links[:, 4:].T
    half = (Ixx + Iyy + Izz) / 2
    second = half - Ixx, half - Iyy, half - Izz, -Ixy, -Ixz, -Iyz
    return np.column_stack([links[:, :4], *second])


def entries_by_numpy(tree: Tree, moments: Array, positions: Array) -> Array:
    """Return entries of the mass matrix; see `compiled.masses.MassEntries`."""
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
    return _met(tree, twists, bodies)


def _met(tree: Tree, twists: list[Array], bodies: list[Array]) -> Array:
    """Return what each joint meets of the momenta of those behind it."""
    entries = []
    for j in reversed(range(len(tree.parents))):
        momentum, i = _momentum(bodies[j], twists[j]), j
        while i >= 0:
            entries.append(np.einsum("an,an->n", twists[i], momentum))
            i = int(tree.parents[i])
        if (parent := int(tree.parents[j])) >= 0:
            bodies[parent] = bodies[parent] + bodies[j]
    return np.array(entries)


def _moved(moments: Array, pose: Array) -> Array:
    """Return a link's moments ``[[S h] [h^T m]]`` at the base, shape (4, 4, poses)."""
    J = np.empty((4, 4))
    J[:3, :3], J[:3, 3], J[3, :3] = moments[4:][_SYMMETRIC], *([moments[1:4]] * 2)
    J[3, 3] = moments[0]
    whole = np.concatenate([pose, np.zeros((1, 4, pose.shape[2]))])
    whole[3, 3] = 1.0
    half = np.einsum("abn,bc->acn", whole, J)
    return np.asarray(np.einsum("acn,dcn->adn", half, whole))


def _momentum(body: Array, twist: Array) -> Array:
    """Return ``(n, f)``, shape (6, poses)."""
    S, h, m, e, v = body[:3, :3], body[:3, 3], body[3, 3], twist[:3], twist[3:]
    n = np.einsum("aan->n", S) * e - np.einsum("abn,bn->an", S, e)
    return np.concatenate([n + _cross(h, v), m * v + _cross(e, h)])


def _times(A: Array, B: Array) -> Array:
    return np.asarray(np.einsum("abn,bcn->acn", A, B))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors, shape (3, poses)."""
    x, y, z = a
    u, v, w = b
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
