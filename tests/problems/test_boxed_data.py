"""The KUKA's recordings and robot file that the repository holds."""

import numpy as np
import pytest

from consistent_id import DriveTerms, TorqueModel, load_problem, load_robot
from consistent_id.diagnosis.torque_parts import torque_parts
from consistent_id.errors import ProblemError

FOLDER = "problems/kuka_kr300"
DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)

# As the authors print them: classical Denavit-Hartenberg rows (d, a, alpha, offset) in
# m and degrees, on a base turned by 180 degrees about x; masses in kg, centres of mass
# in mm, inertias (xx, yy, zz, xy, yz, xz) in 1e-6 kg m^2, in the frames of the rows.
ROWS = [
    (-0.675, 0.350, 90, 0),
    (-0.189, 1.15, 0, -90),
    (0.189, 0.041, -90, 180),
    (-1, 0, 90, 0),
    (0, 0, -90, 0),
    (-0.24, 0, 180, 0),
]
MASSES = [395.40, 339.12, 105.21, 35.80, 31.46, 217.78]
CENTRES = [
    (-353, 174, -4),
    (-709, -1, 23),
    (-18, -18, -76),
    (0, 236, 1),
    (0, -80, -9),
    (0, 0, (200 * 100 - 17.78 * 50) / 217.78),
]
INERTIAS = [
    (16733765, 29799119, 32814954, -1703664, 129384, 4404062),
    (7507819, 88886691, 88673761, 430046, 173157, -4396607),
    (10783798, 10186135, 1943179, 118474, -606384, -101950),
    (425035, 217993, 428465, -4, -11353, -27),
    (283826, 229562, 258266, -4, -19521, -120),
    (0, 0, 0, 0, 0, 0),
]


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "z": (0, 1)}[axis]
    T = np.eye(4)
    T[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return T


def shift(x=0.0, z=0.0):
    T = np.eye(4)
    T[[0, 2], 3] = x, z
    return T


def frames_of_the_table(q):
    """World poses of the joint axes' frames, and of the rows' frames."""
    T, axes, frames = turn("x", np.pi), [], []
    for (d, a, alpha, offset), angle in zip(ROWS, q, strict=True):
        axes.append(T)
        T = T @ turn("z", angle + np.radians(offset)) @ shift(a, d)
        T = T @ turn("x", np.radians(alpha))
        frames.append(T)
    return axes, frames


def frames_of_the_robot(robot, q):
    R, p, found = np.eye(3), np.zeros(3), []
    for joint, angle in zip(robot.joints, q, strict=True):
        p = p + R @ joint.translation
        R = R @ joint.rotation
        axis = R @ joint.axis
        x, y, z = joint.axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turned = np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        R = R @ (np.eye(3) + turned)
        found.append((R, p, axis))
    return found


def test_axes_and_bodies_are_where_the_published_table_has_them():
    robot = load_robot(f"{FOLDER}/robot.urdf")
    q = np.random.default_rng(0).uniform(-2.0, 2.0, 6)
    axes, frames = frames_of_the_table(q)
    for k, (R, p, axis) in enumerate(frames_of_the_robot(robot, q)):
        np.testing.assert_allclose(axis, axes[k][:3, 2], atol=1e-12)
        # On the line of the axis: the way to it has no part across.
        across = np.cross(p - axes[k][:3, 3], axis)
        np.testing.assert_allclose(across, 0.0, atol=1e-12)
        body = robot.links[k].nominal
        assert body.mass == MASSES[k]
        centre = frames[k] @ [*(np.array(CENTRES[k]) / 1e3), 1.0]
        np.testing.assert_allclose(p + R @ body.com, centre[:3], atol=1e-9)
        xx, yy, zz, xy, yz, xz = np.array(INERTIAS[k]) * 1e-6
        printed = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        turned = frames[k][:3, :3] @ printed @ frames[k][:3, :3].T
        rounding = 1e-12 + 1e-9 * abs(turned).max()
        mine = R @ body.central_inertia @ R.T
        np.testing.assert_allclose(mine, turned, atol=rounding)


def test_the_recordings_are_there_with_their_licence():
    problem = load_problem(FOLDER)
    assert not problem.missing
    assert [len(log) for log in (*problem.training, *problem.validation)] == [1601] * 2
    assert np.ptp(problem.training[0].position, axis=0).min() > 0.4
    with open(f"{FOLDER}/LICENSE") as file:
        notice = file.read()
    assert "MIT License" in notice and "Copyright (c) 2021 Jonas Weigand" in notice


@pytest.mark.parametrize("folder", [None, "/nowhere"])
def test_where_recordings_are_absent_the_message_says_where_they_come_from(
    folder, monkeypatch
):
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    if folder is not None:
        monkeypatch.setenv("CONSISTENT_ID_DATASETS", folder)
    with pytest.raises(ProblemError) as refusal:
        load_problem("problems/tiago")
    said = str(refusal.value)
    assert "github.com/thanhndv212/figaroh-examples" in said
    assert "problems/README.md" in said
    assert ("not set" if folder is None else "no file /nowhere/tiago") in said


@pytest.mark.slow
def test_the_counterbalance_is_no_gain_of_the_torque():
    problem = load_problem(FOLDER)
    (log,) = problem.training
    plain = torque_parts(TorqueModel(problem.model.robot, DRIVE), log)
    sprung = torque_parts(problem.model, log)
    assert plain.whole_shown[1]
    assert plain.whole[1] < 0.7
    assert 0.8 < sprung.whole[1] < 1.25
