"""Mass matrices: Pinocchio's, the torque of unit accelerations, least eigenvalues."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot

from consistent_id import DHRow, DriveTerms, TorqueModel, from_modified_dh
from consistent_id.regression import GearCoupling
from consistent_id.regression.elastic_joints import link_inertias
from consistent_id.regression.mass_matrix import (
    _limbs,
    _links_and_drives,
    _positive_definite,
    least_mass_eigenvalue,
    mass_matrices,
    random_poses,
)
from consistent_id.regression.regressor import CHUNK


@pytest.mark.parametrize("seed", range(6))
def test_mass_matrices_are_those_of_pinocchio_with_rotor_inertia_added(seed):
    rng = np.random.default_rng(seed)
    joints = int(rng.integers(1, 9))
    reference, robot = random_robot(rng, joints)
    model = TorqueModel(robot, DriveTerms(rotor_inertia=True))
    rotors = rng.uniform(0.0, 1.0, joints)
    q = random_poses(model, 5, seed)
    data, x = reference.createData(), np.concatenate([robot.nominal, rotors])
    for M, pose in zip(mass_matrices(model, x, q), q, strict=True):
        upper = np.triu(pin.crba(reference, data, pose))
        expected = upper + np.triu(upper, 1).T + np.diag(rotors)
        assert np.allclose(M, expected, rtol=0, atol=1e-12 * abs(expected).max())


def test_a_spring_alone_moves_the_bodies_behind_its_joint_and_no_rotor():
    reference, robot = random_robot(np.random.default_rng(4), 4)
    q = np.array([0.3, -0.2, 0.5, 1.0])
    expected = np.diag(pin.crba(reference, reference.createData(), q))
    np.testing.assert_allclose(link_inertias(robot, q), expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_mass_matrices_of_trees_are_what_pinocchio_says_of_unit_accelerations(seed):
    rng = np.random.default_rng(seed)
    # Pinocchio's own matrices are of trees whose branches are numbered one by one.
    reference, robot = random_robot(rng, 6, tree=True)
    reference.gravity = pin.Motion.Zero()
    model, data = TorqueModel(robot), reference.createData()
    q = random_poses(model, 5, seed)
    for M, pose in zip(mass_matrices(model, robot.nominal, q), q, strict=True):
        columns = [pin.rnea(reference, data, pose, np.zeros(6), e) for e in np.eye(6)]
        expected = np.transpose(columns)
        assert np.allclose(M, expected, rtol=0, atol=1e-12 * abs(expected).max())


@pytest.mark.parametrize("seed", range(6))
def test_a_column_is_the_torque_of_a_unit_acceleration_at_rest(seed):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 5, tree=bool(seed % 2))
    drive = DriveTerms(
        viscous=True, coulomb="sign", offset=True, rotor_inertia=True, spring=True
    )
    model = TorqueModel(robot, drive, torque_joints=robot.joint_names[2:])
    x = rng.normal(size=len(model.layout))  # no body's: all is linear in them
    q = random_poses(model, 4, seed)
    every_joint, still = replace(model, torque_joints=()), np.zeros_like(q)
    at_rest = every_joint.predict(x, q, still, still)
    for j, M_j in enumerate(np.moveaxis(mass_matrices(model, x, q), 2, 0)):
        unit = still + np.eye(5)[j]
        expected = every_joint.predict(x, q, still, unit) - at_rest
        assert np.allclose(M_j, expected, rtol=0, atol=1e-12 * abs(expected).max())


def test_mass_matrices_have_coupled_rotors_and_no_spring():
    robot = from_modified_dh("arm", [DHRow(0.0, 0.1), DHRow(1.0, 0.1)])
    drive = DriveTerms(offset=True, spring=True, rotor_inertia=True)
    coupling = GearCoupling("joint1", "joint2", rotor_inertia=True)
    model = TorqueModel(robot, drive, (coupling,))
    x = np.zeros(len(model.layout))
    x[20:] = [5.0, 0.4, 9.0, 7.0, 0.3, 8.0, 0.2]
    q = random_poses(model, 3, seed=0)
    expected = np.tile([[0.4, 0.2], [0.2, 0.3]], (3, 1, 1))
    assert np.allclose(mass_matrices(model, x, q), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("seed", range(4))
def test_the_least_eigenvalue_is_that_of_all_matrices(seed):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 4, tree=True)
    model = TorqueModel(robot)
    x = robot.nominal if seed % 2 else rng.normal(size=len(model.layout))
    q = random_poses(model, 5000, seed)
    expected = np.linalg.eigvalsh(mass_matrices(model, x, q)).min()
    assert least_mass_eigenvalue(model, x, q) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("coupled", [False, True])
def test_limbs_have_eigenvalues_of_their_own_unless_rotors_couple_them(coupled):
    rng = np.random.default_rng(1)
    _, arm = random_robot(rng, 3)
    limbs = tuple(
        replace(joint, name=f"{side}{joint.name}", parent=parent)
        for side, first in (("left ", 0), ("right ", 3))
        for joint in arm.joints
        for parent in (-1 if joint.parent < 0 else first + joint.parent,)
    )
    links = tuple(
        replace(link, name=f"{side}{link.name}")
        for side in ("left ", "right ")
        for link in arm.links
    )
    robot = replace(arm, joints=limbs, links=links)
    across = GearCoupling(limbs[2].name, limbs[5].name, rotor_inertia=True)
    model = TorqueModel(robot, couplings=(across,) if coupled else ())
    x = rng.normal(size=len(model.layout))
    q = random_poses(model, 200, seed=0)
    groups = _limbs(robot, _links_and_drives(model, x)[1])
    assert [g.tolist() for g in groups] == (
        [[0, 1, 2, 3, 4, 5]] if coupled else [[0, 1, 2], [3, 4, 5]]
    )
    expected = np.linalg.eigvalsh(mass_matrices(model, x, q)).min()
    assert least_mass_eigenvalue(model, x, q) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("lower", [-np.inf, -6.0])
@pytest.mark.parametrize("upper", [-3.5, 1.0, 5.0, np.inf])
def test_random_poses_fill_a_turn_within_the_limits(lower, upper):
    arm = from_modified_dh("arm", [DHRow(0, 0)])
    (joint,) = arm.joints
    limits = replace(joint.limits, lower=lower, upper=upper)
    robot = replace(arm, joints=(replace(joint, limits=limits),))
    q = random_poses(TorqueModel(robot), 2000, seed=0)
    first = lower if np.isfinite(lower) else min(-np.pi, upper - np.pi)
    last = upper if np.isfinite(upper) else max(np.pi, first + np.pi)
    assert first <= q.min() < first + 0.01 * (last - first)
    assert last - 0.01 * (last - first) < q.max() <= last


def test_mass_matrices_of_more_poses_than_a_chunk_are_those_of_pinocchio():
    reference, robot = random_robot(np.random.default_rng(0), 7)
    q = random_poses(TorqueModel(robot), CHUNK + 3, seed=0)
    found = mass_matrices(TorqueModel(robot), robot.nominal, q)
    data = reference.createData()
    for n in (0, CHUNK - 1, CHUNK, CHUNK + 2):
        upper = np.triu(pin.crba(reference, data, q[n]))
        expected = upper + np.triu(upper, 1).T
        np.testing.assert_allclose(found[n], expected, rtol=0, atol=1e-12)


def test_a_single_pose_has_a_least_eigenvalue():
    _, robot = random_robot(np.random.default_rng(0), 3)
    model = TorqueModel(robot)
    q = random_poses(model, 1, seed=0)
    expected = np.linalg.eigvalsh(mass_matrices(model, robot.nominal, q)[0]).min()
    assert least_mass_eigenvalue(model, robot.nominal, q) == pytest.approx(expected)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_pivots_tell_where_all_eigenvalues_are_above_a_shift(size):
    rng = np.random.default_rng(6)
    A = rng.normal(size=(200, 4, 4))
    M = np.moveaxis(A @ np.swapaxes(A, 1, 2) * size, 0, 2)
    least = np.linalg.eigvalsh(np.moveaxis(M, 2, 0))[:, 0]
    for shift in (0.0, float(np.median(least)), 2.0 * float(least.max())):
        np.testing.assert_array_equal(_positive_definite(M, shift), least > shift)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_of_a_joint_with_one_limit_poses_are_on_the_allowed_side(kind):
    reach = 1.0 if kind == "prismatic" else np.pi
    arm = from_modified_dh("arm", [DHRow(0, 0, kind=kind)])
    (joint,) = arm.joints
    for lower, upper in ((4.0, np.inf), (-np.inf, -4.0)):
        limits = replace(joint.limits, lower=lower, upper=upper)
        robot = replace(arm, joints=(replace(joint, limits=limits),))
        q = abs(random_poses(TorqueModel(robot), 500, seed=0))
        assert 4.0 <= q.min() < 4.1 and 3.9 + reach < q.max() <= 4.0 + reach
