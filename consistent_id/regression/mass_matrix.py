"""The joint-space mass matrix over many poses, by composite bodies [Featherstone2008]_.

All in the base frame.  A unit rate of joint ``j`` moves the links behind it, taken as
one body of mass ``m``, first moment ``h`` and second moment ``Sigma``, with the twist
``(e, v)``.  That body's momentum is ``f = m v + e x h`` and
``n = tr(Sigma) e - Sigma e + h x v``, and for ``i`` on the way from the base to ``j``
``M_ij = e_i.n_j + v_i.f_j``.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.regression.drive_entries import drive_entries
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.robot.inertia import pseudo_inertia
from consistent_id.robot.kinematics import ancestors
from consistent_id.robot.model import Joint, RobotModel

POSES = 10_000
"""Random poses at which mass matrices are examined."""

_PIVOT = 1e-100  # below, a division may overflow
_FIRST = 64  # poses from whose least eigenvalue the search for a smaller one starts


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
    every = range(len(model.robot))
    return np.moveaxis(_blocks(model, parameters, q, [np.array(every)])[0], 2, 0)


def _blocks(
    model: TorqueModel, parameters: Vector, q: Array, groups: Sequence[IntArray]
) -> list[Array]:
    """Return blocks of mass matrices, each shape (joints, joints, poses)."""
    links = parameters[: model.layout.inertial_size].reshape(-1, 10)
    drives = _of_drives(model, parameters)
    blocks = [np.empty((len(group), len(group), len(q))) for group in groups]
    for start in range(0, len(q), CHUNK):
        part = slice(start, start + CHUNK)
        M = _of_links(model.robot, links, q[part])
        for block, group in zip(blocks, groups, strict=True):
            own = np.ix_(group, group)
            np.add(M[own], drives[own][:, :, None], out=block[:, :, part])
    return blocks


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
    blocks = _blocks(model, parameters, q, _limbs(model, parameters))
    least = min(_least(M[:, :, :_FIRST]) for M in blocks)
    below = (M[:, :, ~_positive_definite(M, least)] for M in blocks)
    return min(least, *map(_least, below))


def _least(M: Array) -> float:
    """Return the least eigenvalue of matrices, shape (joints, joints, poses)."""
    values = np.linalg.eigvalsh(np.moveaxis(M, 2, 0))
    return float(values.min(initial=np.inf))


def _limbs(model: TorqueModel, parameters: Vector) -> list[IntArray]:
    """Return groups of joints between which all entries are zero, at every pose."""
    from scipy.sparse.csgraph import connected_components

    robot, G = model.robot, model.robot.joint_rates != 0.0
    linked = np.eye(len(robot.joints), dtype=bool)
    for j in range(len(robot.joints)):
        linked[list(ancestors(robot, j)), j] = True
    pattern = G.T @ linked @ G | (_of_drives(model, parameters) != 0.0)
    count, group = connected_components(pattern, directed=False)
    return [np.flatnonzero(group == k) for k in range(count)]


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


def _of_drives(model: TorqueModel, parameters: Vector) -> Matrix:
    """Return what accelerations ask of the drives, the same at every pose."""
    n = len(model.robot)
    rest, unit = np.zeros((n, n + 1)), np.eye(n, n + 1)
    torque, loads = np.zeros((n, n + 1)), dict.fromkeys(range(n), np.zeros(n + 1))
    for j, column, values in drive_entries(model, rest, rest, unit, loads):
        torque[j] += parameters[column] * values
    return np.asarray(torque[:, :n] - torque[:, n:])


def _of_links(robot: RobotModel, links: Array, q: Array) -> Array:
    """Return the links' part, shape (joints, joints, poses)."""
    every = _of_all_joints(
        robot, links, np.ascontiguousarray(robot.joint_positions(q).T)
    )
    if len(robot) == len(robot.joints):
        return every
    G = robot.joint_rates
    return np.asarray(np.einsum("ia,ijn,jb->abn", G, every, G, optimize=True))


def _of_all_joints(robot: RobotModel, links: Array, q: Array) -> Array:
    """Return the links' part as if every joint moved by itself."""
    n = len(robot.joints)
    M = np.zeros((n, n, q.shape[1]))
    masses = links[:, 0].tolist()
    poses: list[Array] = []
    twists: list[Array] = []
    moments: list[Array] = []
    for joint, x, position in zip(robot.joints, links, q, strict=True):
        pose = _relative_pose(joint, position)
        if joint.parent >= 0:
            R, p = poses[joint.parent][:, :3], poses[joint.parent][:, 3]
            pose = np.einsum("abn,bcn->acn", R, pose)
            pose[:, 3] += p
        poses.append(pose)
        moments.append(_moments(x, pose))
        twists.append(_twist(joint, pose))
    for j in reversed(range(n)):
        momentum = _momentum(masses[j], moments[j], twists[j])
        path = list(ancestors(robot, j))
        M[path, j] = M[j, path] = np.einsum(
            "ian,an->in", [twists[i] for i in path], momentum
        )
        parent = robot.joints[j].parent
        if parent >= 0:
            masses[parent] += masses[j]
            moments[parent] += moments[j]
    return M


def _relative_pose(joint: Joint, q: Array) -> Array:
    """Return rotation and translation ``[R p]`` to the parent, shape (3, 4, poses)."""
    pose = np.empty((3, 4, len(q)))
    if joint.kind == "prismatic":
        pose[:, :3] = joint.rotation[:, :, None]
        pose[:, 3] = joint.translation[:, None] + np.outer(
            joint.rotation @ joint.axis, q
        )
        return pose
    K = np.cross(np.eye(3), joint.axis)  # ``K u = axis x u``, of Rodrigues' formula
    parts = [joint.rotation @ part for part in (np.eye(3) + K @ K, K, -K @ K)]
    waves = [np.ones(len(q)), np.sin(q), np.cos(q)]
    pose[:, :3] = np.stack(parts, axis=2) @ np.array(waves)
    pose[:, 3] = joint.translation[:, None]
    return pose


def _moments(x: Vector, pose: Array) -> Array:
    """Return a link's second and first moments ``[Sigma h]``, shape (3, 4, poses)."""
    half = pseudo_inertia(x) @ pose
    second = np.einsum("acn,dcn->adn", half, pose)
    return np.concatenate([second, half[:, 3:]], axis=1)


def _twist(joint: Joint, pose: Array) -> Array:
    """Return ``(e, v)`` of a unit rate, shape (6, poses)."""
    axis = np.einsum("abn,b->an", pose[:, :3], joint.axis)
    if joint.kind == "prismatic":
        return np.concatenate([np.zeros_like(axis), axis])
    return np.concatenate([axis, _cross(pose[:, 3], axis)])


def _momentum(m: float, moments: Array, twist: Array) -> Array:
    """Return ``(n, f)``, shape (6, poses)."""
    S, h, e, v = moments[:, :3], moments[:, 3], twist[:3], twist[3:]
    n = np.einsum("aan->n", S) * e - np.einsum("abn,bn->an", S, e)
    n += _cross(h, v)
    return np.concatenate([n, m * v + _cross(e, h)])


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors, shape (3, poses)."""
    x, y, z = a
    u, v, w = b
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
