"""The joint-space mass matrix over many poses, and its least eigenvalue."""

from collections.abc import Iterator, Sequence

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.regression.compiled.masses import mass_entries
from consistent_id.regression.compiled.sines import sine_and_cosine
from consistent_id.regression.composite_bodies import (
    entries_by_numpy,
    moments_of,
    tree_of,
)
from consistent_id.regression.drive_entries import drive_entries
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.robot.inertia import pseudo_inertia
from consistent_id.robot.kinematics import ancestors
from consistent_id.robot.model import RobotModel

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
    blocks = [
        np.repeat(drives[np.ix_(group, group)][:, :, None], len(q), axis=2)
        for group in groups
    ]
    places = {
        a: (block, i)
        for block, group in zip(blocks, groups, strict=True)
        for i, a in enumerate(group.tolist())
    }
    for part, a, b, values in _of_links(model.robot, links, q):
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
    tree, moments = tree_of(robot, moving), moments_of(links[moving])
    entries_of = mass_entries(len(q), entries_by_numpy)
    for start in range(0, len(q), CHUNK):
        part = slice(start, start + CHUNK)
        x = robot.joint_positions(q[part]).T[moving]
        positions = np.empty((len(moving), 3, x.shape[1]))
        positions[:, 0] = x
        for row in positions:
            sine_and_cosine(row[0], row[1:])
        entries = entries_of(tree, moments, positions)
        for (i, j), values in zip(tree.pairs, entries, strict=True):
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
