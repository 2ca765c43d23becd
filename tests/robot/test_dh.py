"""Both Denavit-Hartenberg conventions against products of 4x4 matrices."""

import numpy as np
import pytest

from consistent_id import DHRow, ModelError, TorqueModel, from_modified_dh
from consistent_id.robot import from_classical_dh

PUMA_LENGTHS = (0.0, 0.4318, 0.0203, 0.0, 0.0, 0.0)
PUMA_OFFSETS = (0.0, 0.0, 0.15005, 0.4318, 0.0, 0.0)
PUMA_TWISTS = tuple(np.array([1, 0, -1, 1, -1, 0]) * np.pi / 2)


def _turn(axis, angle):
    T, (i, j) = np.eye(4), {"x": (1, 2), "z": (0, 1)}[axis]
    T[[i, j], [i, j]] = np.cos(angle)
    T[j, i], T[i, j] = np.sin(angle), -np.sin(angle)
    return T


def _shift(axis, length):
    T = np.eye(4)
    T["xyz".index(axis), 3] = length
    return T


def _link_poses(robot, q):
    """Poses of all links of a serial robot from its joints."""
    pose, poses = np.eye(4), []
    for joint, x in zip(robot.joints, q, strict=True):
        T, motion = np.eye(4), np.eye(4)
        T[:3, :3], T[:3, 3] = joint.rotation, joint.translation
        if joint.kind == "prismatic":
            motion[:3, 3] = x * joint.axis
        else:
            # The exponential by its eigenvectors, unlike the package's formula.
            e = joint.axis
            K = np.array([[0, -e[2], e[1]], [e[2], 0, -e[0]], [-e[1], e[0], 0]])
            values, vectors = np.linalg.eig(K)
            turned = vectors @ np.diag(np.exp(x * values)) @ np.linalg.inv(vectors)
            motion[:3, :3] = turned.real
        pose = pose @ T @ motion
        poses.append(pose)
    return poses


def _random_table(rng, count):
    kinds = rng.choice(["revolute", "prismatic", "continuous"], count)
    return [DHRow(*rng.normal(size=4), kind=str(kind)) for kind in kinds]


def _moved(row, x):
    slides = row.kind == "prismatic"
    return (row.theta, row.d + x) if slides else (row.theta + x, row.d)


@pytest.mark.parametrize("seed", range(10))
def test_classical_frames_are_the_product_of_their_four_motions(seed):
    rng = np.random.default_rng(seed)
    rows, q = _random_table(rng, 5), rng.normal(size=5)
    robot = from_classical_dh("r", rows)
    expected = np.eye(4)
    poses = _link_poses(robot, q)
    for row, x, pose, link in zip(rows, q, poses, robot.links, strict=True):
        theta, d = _moved(row, x)
        expected = expected @ _turn("z", theta) @ _shift("z", d)
        expected = expected @ _shift("x", row.a) @ _turn("x", row.alpha)
        (frame,) = link.merged
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = frame.rotation, frame.translation
        assert np.allclose(pose @ T, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_modified_frames_are_the_product_of_their_four_motions(seed):
    rng = np.random.default_rng(seed)
    rows, q = _random_table(rng, 5), rng.normal(size=5)
    expected = np.eye(4)
    poses = _link_poses(from_modified_dh("r", rows), q)
    for row, x, pose in zip(rows, q, poses, strict=True):
        theta, d = _moved(row, x)
        expected = expected @ _turn("x", row.alpha) @ _shift("x", row.a)
        expected = expected @ _turn("z", theta) @ _shift("z", d)
        assert np.allclose(pose, expected, rtol=0, atol=1e-12)


def _puma():
    """The Puma 560 by both conventions: twist and length belong to the next row."""
    columns = (PUMA_TWISTS, PUMA_LENGTHS, PUMA_OFFSETS)
    classical = [DHRow(*row) for row in zip(*columns, strict=True)]
    shifted = ((0.0, *PUMA_TWISTS[:-1]), (0.0, *PUMA_LENGTHS[:-1]), PUMA_OFFSETS)
    modified = [DHRow(*row) for row in zip(*shifted, strict=True)]
    return from_classical_dh("puma", classical), from_modified_dh("puma", modified)


def test_the_puma_is_the_same_robot_in_both_conventions():
    classical, modified = _puma()
    rng = np.random.default_rng(0)
    states = rng.uniform(-2, 2, (3, 60, 6))
    regressors = (
        TorqueModel(robot).regressor(*states) for robot in (classical, modified)
    )
    Y, Z = (R.transpose(0, 2, 1).reshape(-1, 60) for R in regressors)
    ranks = [np.linalg.matrix_rank(M, 1e-10 * np.linalg.norm(M)) for M in (Y, Z)]
    together = np.linalg.matrix_rank(np.hstack([Y, Z]), 1e-10 * np.linalg.norm(Y))
    assert ranks == [36, 36]  # base parameters of the Puma 560 [Gautier1991]
    assert together == 36


def test_the_pumas_links_differ_by_their_twists_alone():
    rng = np.random.default_rng(1)
    for q in rng.uniform(-2, 2, (5, 6)):
        pairs = zip(*(_link_poses(robot, q) for robot in _puma()), strict=True)
        for twist, (classical, modified) in zip(PUMA_TWISTS, pairs, strict=True):
            assert np.allclose(classical, modified @ _turn("x", twist), atol=1e-12)


@pytest.mark.parametrize("build", [from_classical_dh, from_modified_dh])
def test_bad_numbers_in_a_table_are_named_by_row(build):
    with pytest.raises(ModelError, match="DH row 2"):
        build("r", [DHRow(0, 0), DHRow(np.nan, 0)])
    for degrees in (DHRow(90, 0), DHRow(0, 0, theta=-90)):
        with pytest.raises(ModelError, match=r"DH row 2: .*90 rad.*degrees"):
            build("r", [DHRow(0, 0), degrees])
