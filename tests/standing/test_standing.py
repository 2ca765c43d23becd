"""Motion of a robot on its feet: kinematics, forces of the ground, errors, limits."""

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from quadrupeds import CORNERS, FEET, FOOT, quadruped_text
from shown import assert_reached

import consistent_id as ci
from consistent_id.robot.kinematics import frame_places
from consistent_id.standing.forces_and_limits import (
    StandingLimits,
    ground_forces,
    standing_motion,
)
from consistent_id.standing.stance import Stance, StandingFoot, joint_motion
from consistent_id.standing.standing_design import (
    REST,
    design_standing,
    relative_size,
    trunk_errors,
)
from consistent_id.standing.trunk_path import TrunkPath

POSE = np.tile([0.1, 0.2, -0.9], 4)  # centres of bodies, 0.1 m ahead, above feet
LIMITS = StandingLimits(velocity=6.0, effort=40.0)
GRAVITY = np.array([0.0, 0.0, -9.81])


def path_of(size=0.5, seed=0, duration=6.0):
    rng = np.random.default_rng(seed)
    scale = size * np.array([0.02] * 3 + [0.08] * 3)
    coefficients = scale * rng.normal(size=(2, 3, 6)) / np.array([1, 2, 3])[:, None]
    return TrunkPath([0.4, 0.9, 1.7], coefficients, duration)


@pytest.fixture(scope="module")
def stance(tmp_path_factory):
    file = tmp_path_factory.mktemp("standing") / "robot.xml"
    file.write_text(quadruped_text(hips=CORNERS))
    robot = ci.robot.load_mjcf(file, base="floating")
    point = np.array([FOOT])
    return Stance(robot, tuple(StandingFoot(f, point, False) for f in FEET), POSE)


def model_of(stance):
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)
    return ci.TorqueModel(stance.robot, drive)


def test_a_trunks_motion_is_the_derivative_of_its_way():
    path, step = path_of(), 1e-5
    t = np.linspace(0.3, 5.7, 40)
    before, at, after = (path.motion(t + d, GRAVITY) for d in (-step, 0.0, step))
    slope = (after.place - before.place) / (2 * step)
    assert np.allclose(slope, at.velocity, atol=1e-8)
    turn = np.swapaxes(before.base.rotation, 1, 2) @ after.base.rotation
    rate = np.array([pin.log3(R) for R in turn]) / (2 * step)
    assert np.allclose(rate, at.base.angular_velocity, atol=1e-7)
    spin = (after.base.angular_velocity - before.base.angular_velocity) / (2 * step)
    assert np.allclose(spin, at.base.angular_acceleration, atol=1e-7)
    pull = (after.velocity - before.velocity) / (2 * step)
    felt = np.einsum("nij,ni->nj", at.base.rotation, pull - GRAVITY)
    assert np.allclose(felt, at.base.specific_force, atol=1e-7)


def test_a_trunk_begins_and_ends_at_rest_where_it_stands():
    ends = path_of().evaluate(np.array([0.0, 6.0]))
    assert not ends.any()


def test_feet_stay_where_they_are(stance):
    path, t = path_of(), np.linspace(0, 6, 61)
    trunk = path.motion(t, GRAVITY)
    moved = joint_motion(stance, trunk)
    for foot in FEET:
        seen = frame_places(stance.robot, foot, moved.q)
        local = seen.translation + seen.rotation @ np.array(FOOT)
        world = np.einsum("nij,nj->ni", trunk.base.rotation, local) + trunk.place
        assert np.ptp(world, axis=0).max() < 1e-8
    assert not moved.singular


def test_rates_of_joints_are_derivatives(stance):
    path, step = path_of(), 1e-5
    t = np.linspace(0.5, 5.5, 20)
    moved = [
        joint_motion(stance, path.motion(t + d, GRAVITY)) for d in (-step, 0, step)
    ]
    before, at, after = moved
    assert np.allclose((after.q - before.q) / (2 * step), at.dq, atol=1e-6)
    assert np.allclose((after.dq - before.dq) / (2 * step), at.ddq, atol=1e-6)


def test_forces_of_the_ground_carry_the_robot_as_pinocchio_says(stance, tmp_path):
    """Inverse dynamics with a free flyer: base rows vanish, joints' are the torques."""
    robot, t = stance.robot, np.linspace(0, 6, 11)
    trunk = path_of().motion(t, GRAVITY)
    moved = joint_motion(stance, trunk)
    found = ground_forces(
        stance, ci.TorqueModel(robot), robot.nominal, moved, trunk.base, 0.6
    )
    (tmp_path / "r.xml").write_text(quadruped_text(hips=CORNERS))
    model = pin.buildModelFromMJCF(str(tmp_path / "r.xml"))
    data = model.createData()
    order = [model.idx_vs[model.getJointId(name)] - 6 for name in robot.joint_names]
    for k in range(len(t)):
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        R = trunk.base.rotation[k]
        q[:3], q[3:7] = trunk.place[k], pin.Quaternion(R).coeffs()
        v[:3], v[3:6] = R.T @ trunk.velocity[k], trunk.base.angular_velocity[k]
        a[3:6] = trunk.base.angular_acceleration[k]
        a[:3] = R.T @ trunk.acceleration[k] - np.cross(v[3:6], v[:3])
        q[7:][order], v[6:][order] = moved.q[k], moved.dq[k]
        a[6:][order] = moved.ddq[k]
        pin.forwardKinematics(model, data, q)
        pushes = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        for foot, force in zip(FEET, found.forces[k], strict=True):
            joint = model.getJointId(foot.replace("calf", "knee"))
            turned = data.oMi[joint].rotation.T @ force
            pushes[joint] = pin.Force(turned, np.cross(FOOT, turned))
        needed = pin.rnea(model, data, q, v, a, pushes)
        assert np.allclose(needed[:6], 0.0, atol=1e-8)
        assert np.allclose(needed[6:][order], found.torque[k], atol=1e-8)


def test_forces_are_the_nearest_to_shares_that_friction_weighs(stance):
    """Of all forces that carry the robot, by feet where Pinocchio's model has them."""
    robot, friction = stance.robot, 0.6
    trunk = path_of(0.7).motion(np.linspace(0.5, 5.5, 5), GRAVITY)
    moved = joint_motion(stance, trunk)
    found = ground_forces(
        stance, ci.TorqueModel(robot), robot.nominal, moved, trunk.base, friction
    )
    share = 9.81 * sum(link.nominal.mass for link in robot.links) / 4
    assert found.share == pytest.approx(share)
    usual, root = np.tile([0.0, 0.0, share], 4), np.tile([friction, friction, 1.0], 4)
    for k, forces in enumerate(found.forces):
        G = np.zeros((6, 12))
        for i, foot in enumerate(FEET):
            seen = frame_places(robot, foot, moved.q[k : k + 1])
            at = trunk.base.rotation[k] @ (
                seen.translation[0] + seen.rotation[0] @ np.array(FOOT)
            )
            G[:3, 3 * i : 3 * i + 3] = np.eye(3)
            G[3:, 3 * i : 3 * i + 3] = pin.skew(at)
        more = np.linalg.pinv(G * root) @ (G @ (np.ravel(forces) - usual))
        assert np.ravel(forces) == pytest.approx(usual + root * more, abs=1e-8)


def test_standing_still_each_foot_bears_its_share(stance):
    """Of a robot that is symmetric, but for bodies 0.1 m ahead of their joints."""
    path = TrunkPath([1.0], np.zeros((2, 1, 6)), 6.0)
    motion = standing_motion(stance, LIMITS, path, np.array([3.0]))
    weight = 9.81 * sum(link.nominal.mass for link in stance.robot.links)
    assert motion.ground.forces[0, :, 2].sum() == pytest.approx(weight)
    assert abs(motion.ground.forces[0, :, :2].sum(axis=0)).max() < 1e-9


@pytest.mark.slow
def test_errors_are_those_of_repeated_fits(stance):
    """Trunks fitted to torque with noise scatter as much as was said."""
    path = path_of(0.7)
    rate = 12.5
    time = np.linspace(0, 6, 76)
    model = model_of(stance)
    motion = standing_motion(stance, LIMITS, path, time)
    said = trunk_errors(stance, model, motion, rate)
    robot, n = stance.robot, len(time)
    free = ci.regression.contact_free_model(model)
    rng = np.random.default_rng(0)
    moved, layout = motion.joints, model.layout
    state = moved.q, moved.dq, moved.ddq
    truth = np.zeros(len(layout))
    truth[: len(robot.nominal)] = robot.nominal
    rows = model.predict(truth, *state, base=motion.trunk.base)
    keep = np.r_[np.arange(10), np.arange(len(robot.nominal), len(layout))]
    found = []
    for _ in range(100):
        noisy = rows + rng.normal(size=rows.shape)
        # All eighteen rows have this noise; that of the base's comes as a wrench.
        wrench = ci.recordings.Wrench(
            robot.link_names[0], noisy[:, :6] - rows[:, :6], axes="base"
        )
        log = ci.Recording(
            robot.joint_names,
            time,
            *state,
            noisy[:, 6:],
            base=motion.trunk.base,
            contacts=stance.contacts(n),
            wrenches=(wrench,),
        )
        log = ci.signals.without_rests(log, REST)
        (factor,) = ci.regression.contact_free_regression(free, log).factors
        R, z = factor[:, :-1], factor[:, -1]
        legs = np.setdiff1d(np.arange(len(layout)), keep)
        fit = np.linalg.lstsq(R[:, keep], z - R[:, legs] @ truth[legs], rcond=None)[0]
        found.append(fit[:10] - truth[:10])
    scatter = np.std(found, axis=0)
    # 100 repetitions: a standard deviation is known to 7 %.
    assert said == pytest.approx(scatter, rel=0.25)


@pytest.mark.slow
def test_a_longer_log_tells_more(stance):
    model, motions = model_of(stance), []
    for duration in (6.0, 24.0):
        path = TrunkPath([0.5, 1.0, 1.5], path_of(0.7).coefficients, duration)
        time = np.linspace(0, duration, round(12.5 * duration) + 1)
        motions.append(standing_motion(stance, LIMITS, path, time))
    short, long = (trunk_errors(stance, model, m, 12.5) for m in motions)
    assert np.all(long < short)


@pytest.mark.slow
def test_a_design_keeps_its_limits_and_tells_more_than_motions_by_hand(stance):
    design = design_standing(
        stance, model_of(stance), LIMITS, duration=4, candidates=64
    )
    checked = design.checked
    assert_reached("tests/standing/test_standing.py", design)
    assert max(use.share for use in checked.uses) <= 1.0
    assert abs(checked.joints.dq).max() <= LIMITS.velocity
    assert abs(checked.ground.torque).max() <= LIMITS.effort_share * LIMITS.effort
    press, along = checked.ground.forces[..., 2], checked.ground.forces[..., :2]
    assert press.min() >= 0.19 * checked.ground.share
    cone = LIMITS.friction_share * LIMITS.friction
    assert np.all(np.linalg.norm(along, axis=2) <= cone * press + 1e-9)
    by_hand = [
        _in_limits(stance, path_of(seed=seed, duration=4.0)) for seed in range(3)
    ]
    trunk = stance.robot.links[0].nominal
    sizes = [relative_size(errors, trunk) for errors in by_hand]
    # Four rounds alone: a search of the usual length goes on.
    assert relative_size(design.errors, trunk) < 0.8 * np.median(sizes)
    assert design.first > 1.5


def _in_limits(stance, path):
    """Errors of a path that is as large as its limits allow."""
    time = np.linspace(0, path.duration, 2001)
    for factor in np.geomspace(4.0, 0.05, 40):
        scaled = path.scaled(factor)
        # What is too much at every tenth of these instants is too much at all of them.
        if standing_motion(stance, LIMITS, scaled, time[::10]).largest > 1.0:
            continue
        motion = standing_motion(stance, LIMITS, scaled, time)
        if motion.largest <= 1.0:
            return trunk_errors(stance, model_of(stance), motion, 500.0)
    raise AssertionError("no size keeps the limits")


def test_a_stretched_leg_is_refused(stance):
    straight = Stance(stance.robot, stance.feet, np.zeros(12))
    with pytest.raises(ci.InfeasibleError, match="stretched in this pose"):
        design_standing(straight, model_of(stance), LIMITS, candidates=16)


def test_two_points_are_no_stance(stance):
    with pytest.raises(
        ci.ProblemError, match="in a line, on which the robot cannot stand"
    ):
        Stance(stance.robot, stance.feet[:2], POSE)


@pytest.mark.slow
def test_the_command_writes_what_can_be_played(tmp_path, capsys):
    from consistent_id.cli import main

    ball = '<geom type="sphere" size="0.02" pos="0 0 -0.2"/>'
    text = quadruped_text(hips=CORNERS).replace(
        'knee" axis="0 1 0"/>', 'knee" axis="0 1 0"/>' + ball
    )
    robot = tmp_path / "robot.xml"
    robot.write_text(text)
    pose = [
        f"{leg}_{joint}={value}"
        for leg in "abcd"
        for joint, value in (("roll", 0.1), ("pitch", 0.2), ("knee", -0.9))
    ]
    words = ["excite", str(robot), "--standing", "--velocity", "6", "--effort", "40"]
    words += [
        "--duration",
        "6",
        "--candidates",
        "16",
        "--output",
        str(tmp_path / "out"),
    ]
    assert main([*words, "--stance", *pose]) == 0
    printed = capsys.readouterr()
    assert "between them nothing is" in " ".join(printed.out.split())
    first, last = [line for line in printed.err.splitlines() if "paths" in line]
    assert first.startswith("0/16 paths [")
    assert last.startswith("16/16 paths done (least relative error: ")
    record = json.loads((tmp_path / "out" / "standing.json").read_text())
    assert record["feet"] == list(FEET)
    played = ci.motion.read_trajectory(tmp_path / "out" / "standing.yaml")
    table = ci.motion.read_trajectory(tmp_path / "out" / "standing.csv")
    assert np.allclose(played.position, table.position, atol=1e-9)
    assert Path(tmp_path / "out" / "standing.png").stat().st_size > 1000
    with pytest.raises(SystemExit):
        main(["excite", str(robot), "--standing", "--sole", "wide"])
    assert main(["excite", str(robot), "--standing", "--harmonics", "5"]) == 2


@pytest.mark.parametrize(
    "words",
    [
        ["--ground", "0"],
        ["--clearance", "0.02"],
        ["--effort-rms", "9"],
        ["--no-collisions"],
        ["--start-pose", "a_knee=0"],
        ["--for", "trunk"],
        ["--others", "known"],
        ["--friction-share", "0"],
        ["--format", "script"],
        ["--starts", "8"],
    ],
)
def test_options_of_arms_are_refused_on_feet_not_ignored(tmp_path, capsys, words):
    robot = tmp_path / "robot.xml"
    robot.write_text(quadruped_text(hips=CORNERS))
    from consistent_id.cli import main

    assert main(["excite", str(robot), "--standing", *words]) == 2
    assert f"{words[0]} is of arms" in capsys.readouterr().err
