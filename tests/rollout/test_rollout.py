"""Rollouts: commands replayed by models, against closed forms and known robots."""

from dataclasses import replace

import numpy as np
import pytest
from estimates import estimate_of

from consistent_id import (
    DriveTerms,
    ModelError,
    NonNegativeDrive,
    Recording,
    RecordingError,
    TorqueModel,
    build_regression,
    differentiated,
    low_passed,
    to_mjcf,
)
from consistent_id.constraints import FixedBodies
from consistent_id.robot import JointLimits
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow, from_modified_dh
from consistent_id.signals import PDGains, commanded

mujoco = pytest.importorskip("mujoco")

from consistent_id.rollout import (  # noqa: E402
    replay,
    replay_model,
    rollout,
)
from consistent_id.rollout.commanded_motion import drive_commands  # noqa: E402
from consistent_id.rollout.compared_models import (  # noqa: E402
    free_gains,
    open_loop,
)
from consistent_id.rollout.refine import refined  # noqa: E402
from consistent_id.rollout.replay_model import time_step  # noqa: E402
from consistent_id.rollout.rollout_page import (  # noqa: E402
    frequency_response,
)

GAINS = PDGains(40.0, 2.0)
DRIVE = DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True, rotor_inertia=True
)
LIMITS = JointLimits(-3.0, 3.0, 20.0, 100.0)


def arm(drive=DRIVE, gravity=(0.0, 0.0, 0.0), joints=2):
    """A planar arm of known bodies."""
    rows = [DHRow(0.0, 0.0 if k == 0 else 0.3, limits=LIMITS) for k in range(joints)]
    robot = from_modified_dh("arm", rows, gravity=gravity)
    body = np.array([1.0, 0.15, 0, 0, 0.002, 0, 0.03, 0, 0, 0.03])
    links = tuple(replace(k, nominal=InertialParameters(body)) for k in robot.links)
    return TorqueModel(replace(robot, links=links), drive)


def estimate(model, drives):
    bodies = [link.nominal for link in model.robot.links]
    return estimate_of(model, bodies, np.array(drives))


def chirps(joints=2, seconds=6.0, rate=200.0):
    time = np.arange(round(seconds * rate)) / rate
    shift = np.arange(joints)
    phase = time[:, None] * (2.0 + shift) + 1.2 * time[:, None] ** 2
    return time, 0.4 * np.sin(phase)


def blank(names, time, told):
    still = np.zeros_like(told)
    return Recording(names, time, still, still, position_command=told)


@pytest.mark.parametrize("step", [5e-4, 2.5e-3])
def test_a_step_is_answered_as_the_closed_form_says(step):
    model = arm(DriveTerms(viscous=True, rotor_inertia=True), joints=1)
    time = np.arange(200) / 200.0
    log = blank(model.robot.joint_names, time, np.full((200, 1), 0.2))
    one = estimate(model, [0.5, 0.05])
    made = replay_model(one, log.joints, GAINS, period=1 / 200, step=step)
    inertia, d, k = 0.03 + 0.05, 2.0 + 0.5, 40.0
    w, z = np.sqrt(k / inertia), d / (2.0 * np.sqrt(k * inertia))
    wd = w * np.sqrt(1.0 - z**2)
    fades = np.exp(-z * w * time)
    x = fades * (np.cos(wd * time) + z * w / wd * np.sin(wd * time))
    dx = -fades * w**2 / wd * np.sin(wd * time)
    found, error = replay(made, log), 0.2 * (w * step) ** 2  # of second order
    np.testing.assert_allclose(found.position[:, 0], 0.2 * (1.0 - x), atol=error)
    # The last velocity is half a step old.
    np.testing.assert_allclose(found.velocity[:-1, 0], -0.2 * dx[:-1], atol=w * error)


def test_long_steps_follow_moving_commands_as_short_ones_do():
    model = arm(DriveTerms(viscous=True, rotor_inertia=True))
    one = estimate(model, [0.5, 0.05, 0.3, 0.04])
    log = blank(model.robot.joint_names, *chirps(seconds=2.0))
    short, long = (
        replay(replay_model(one, log.joints, GAINS, period=1 / 200, step=step), log)
        for step in (1e-4, 2.5e-3)
    )
    # A command that is half a step early moves the joints by 1.25 ms of their speed.
    speed = np.sqrt((short.velocity**2).mean())
    off = np.sqrt(((long.position - short.position) ** 2).mean())
    assert off < 0.1 * 1.25e-3 * speed


@pytest.mark.parametrize(("damping", "steps"), [(2.0, 1), (60.0, 2), (1e5, 20)])
def test_strong_damping_has_shorter_steps_and_leaves_half_of_the_inertia(
    damping, steps
):
    model = arm(DriveTerms(viscous=True, rotor_inertia=True), joints=1)
    time = np.arange(200) / 200.0
    log = blank(model.robot.joint_names, time, np.full((200, 1), 0.2))
    one, gains = estimate(model, [0.0, 0.05]), PDGains(40.0, damping)
    made = replay_model(one, log.joints, gains, period=1 / 200, step=2.5e-3)
    assert made.compiled.opt.timestep == pytest.approx(2.5e-3 / steps)
    least = 0.05 - 0.5 * 0.08
    expected = max(0.05 - 0.5 * 2.5e-3 / steps * damping, least)
    assert made.compiled.dof_armature[0] == pytest.approx(expected, rel=1e-3)
    settled = 0.2 * -np.expm1(-40.0 / damping * time[-1])
    assert replay(made, log).position[-1, 0] == pytest.approx(settled, rel=0.03)


def test_a_clock_that_is_a_little_slow_takes_no_step_more():
    assert time_step(1.0 / 199.96, 5e-4) == pytest.approx(1.0 / 1999.6)
    assert time_step(1.0 / 190.0, 5e-4) == pytest.approx(1.0 / 2090.0)


def test_commands_hold_and_are_averaged_over_steps():
    time = np.arange(5) / 100.0
    told = np.array([0.0, 1.0, -1.0, 3.0, 2.0])[:, None]
    log = blank(("hip",), time, told)
    gains = PDGains(10.0, 0.0).of(1)
    fine = drive_commands(log, gains, 1e-3, 40)
    np.testing.assert_allclose(fine[:, 0], np.repeat(10.0 * told[:4, 0], 10), atol=1e-9)
    late = drive_commands(log, gains, 1e-3, 40, delay=2.5e-4)
    np.testing.assert_allclose(late[10, 0], 0.25 * 0.0 + 0.75 * 10.0, atol=1e-9)
    np.testing.assert_allclose(late.sum(), fine.sum() - 0.25 * 30.0, atol=1e-6)


def stepped(model, x, time, told):
    """The motion by MuJoCo's own steps, with the drive's torque as a force."""
    text = to_mjcf(estimate(model, x), allow_refused=True).content.decode()
    compiled = mujoco.MjModel.from_xml_string(text)
    compiled.opt.timestep = 1e-4
    data, found = mujoco.MjData(compiled), []
    for row in told:
        found.append([data.qpos.copy(), data.qvel.copy()])
        for _ in range(round((time[1] - time[0]) / 1e-4)):
            data.qfrc_applied = GAINS.kp * (row - data.qpos) - GAINS.kd * data.qvel
            mujoco.mj_step(compiled, data)
    q, dq = np.array(found).transpose(1, 0, 2)
    return Recording(model.robot.joint_names, time, q, dq, position_command=told)


TRUTH = [0.4, 0.3, 0.05, 0.04, 0.2, 0.5, -0.1, 0.02]  # viscous to rotor, by joint


@pytest.mark.slow
def test_the_robot_itself_moves_like_the_robot():
    model = arm(gravity=(0.0, -9.81, 0.0))
    log = stepped(model, TRUTH, *chirps())
    off = [1.5 * value for value in TRUTH]
    own, other = (rollout(estimate(model, x), log, GAINS) for x in (TRUTH, off))
    (name,) = own.replays
    assert own.rmse(name) < 1e-3 < 0.3 * other.rmse(name)
    assert own.to_dict()["models"][name]["position_rmse"] == own.rmse(name)


BODY = """<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="{o}" ixz="{o}" iyz="{o}"/></inertial></link>
"""


def one_joint(path, base, arm):
    """Write a robot of two bodies, each of mass and entries of the inertia matrix."""
    bodies = "".join(
        BODY.format(name=name, mass=mass, i=diagonal, o=product)
        for name, (mass, diagonal, product) in {"base": base, "arm": arm}.items()
    )
    path.write_text(
        f'<robot name="one">{bodies}<joint name="a" type="revolute"><parent link="base"'
        '/><child link="arm"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" '
        'effort="9" velocity="9"/></joint></robot>'
    )
    return path


def test_a_base_that_stands_still_may_have_an_inertia_that_no_body_has(tmp_path):
    time, told = chirps(1, 1.0)
    log, real = blank(("a",), time, told), (1.0, 0.02, 0.0)
    made = [
        replay_model(one_joint(tmp_path / "one.urdf", base, real), log.joints, GAINS)
        for base in (real, (1e-6, 1e-6, 1e-6))
    ]
    one, other = (replay(each, log).position for each in made)
    assert abs(one).max() > 0.1 and np.array_equal(one, other)
    one_joint(tmp_path / "one.urdf", real, (1e-6, 1e-6, 1e-6))
    with pytest.raises(ModelError, match="MuJoCo refuses it"):
        replay_model(tmp_path / "one.urdf", log.joints, GAINS)


@pytest.mark.slow
def test_what_is_exported_moves_like_the_estimate(tmp_path):
    drive = DriveTerms(
        viscous=True,
        coulomb="tanh",
        velocity_scale=0.02,
        friction_slope=True,
        offset=True,
        rotor_inertia=True,
    )
    model = arm(drive)
    x = [0.4, 0.9, 0.5, 0.05, 0.04, 0.2, 1.3, -0.4, 0.1, 0.02]
    limits = JointLimits(-1.5, 1.5, 20.0, 100.0)
    joints = tuple(replace(j, limits=limits) for j in model.robot.joints)
    model = TorqueModel(replace(model.robot, joints=joints), drive)
    own = estimate(model, x)  # MuJoCo's solver of friction stops at some 1e-8
    log = blank(model.robot.joint_names, *chirps())
    file = tmp_path / "arm.xml"
    to_mjcf(own, allow_refused=True).save(file)
    found = rollout(own, log, GAINS, against=[file])
    one, other = (found.replays[name][0].position for name in found.replays)
    np.testing.assert_allclose(other, one, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("q", [-0.7, 0.1, 0.7])
def test_a_joint_breaks_loose_at_the_friction_of_its_position(q):
    drive = DriveTerms(coulomb="tanh", velocity_scale=0.02, friction_slope=True)
    model = arm(drive, joints=1)
    limits = JointLimits(-0.8, 0.8, 20.0, 100.0)
    joints = tuple(replace(j, limits=limits) for j in model.robot.joints)
    model = TorqueModel(replace(model.robot, joints=joints), drive)
    level = 1.0 + 0.6 * q
    text = to_mjcf(estimate(model, [1.0, 0.6]), allow_refused=True).content.decode()
    compiled = mujoco.MjModel.from_xml_string(text)
    moved = []
    for share in (0.9, 1.3):
        data = mujoco.MjData(compiled)
        data.qpos[0] = q
        for _ in range(100):
            data.qfrc_applied = share * level
            mujoco.mj_step(compiled, data)
        moved.append(abs(data.qpos[0] - q))
    # Friction of MuJoCo creeps before it breaks; then 0.3 of it accelerates the link.
    assert moved[0] < 0.01 < 0.2 * moved[1]
    assert moved[1] == pytest.approx(0.3 * level / 0.03 * 0.2**2 / 2.0, rel=0.7)


@pytest.mark.slow
def test_rollouts_find_the_drives_again():
    model = arm(gravity=(0.0, -9.81, 0.0))
    log = stepped(model, TRUTH, *chirps(seconds=8.0))
    known = (FixedBodies(), NonNegativeDrive())
    raw = replace(commanded(log, GAINS), velocity=None)
    smooth = low_passed(raw, motion_cutoff=20.0, torque_cutoff=20.0)
    regression = build_regression(model, differentiated(smooth))
    start = estimate(model, [1.4 * value for value in TRUTH])
    found = refined(
        start, regression, [log], GAINS, constraints=known, ridge=1e-6, steps=8
    )
    drives = found.estimate.parameters[model.layout.inertial_size :]
    assert found.after < 0.1 * found.before
    # The log's time step is 0.1 ms, that of rollouts 1 ms: friction differs by up to
    # 0.3 % of the torque, which is 14 N m, and the truth has an error of its own.
    np.testing.assert_allclose(drives, TRUTH, atol=0.05)
    true = rollout(estimate(model, TRUTH), log, GAINS)
    assert found.after <= true.rmse(next(iter(true.replays)))
    assert found.estimate.certificate.verdict == "uncertified"


def test_the_response_to_a_delay_is_its_phase():
    time, told = chirps(1, 20.0)
    late = np.interp(time - 0.02, time, told[:, 0])[:, None]
    log = blank(("hip",), time, told)
    found = frequency_response(log, late)
    known = np.isfinite(found.response[:, 0])
    assert known.sum() > 10
    np.testing.assert_allclose(abs(found.response[known, 0]), 1.0, atol=0.05)
    phase = np.unwrap(np.angle(found.response[known, 0]))
    expected = -2 * np.pi * found.frequency[known] * 0.02
    np.testing.assert_allclose(phase, expected, atol=0.05)


def test_a_log_without_commands_is_refused():
    model = arm()
    time, told = chirps()
    log = replace(blank(model.robot.joint_names, time, told), position_command=None)
    with pytest.raises(RecordingError, match="no position_command"):
        rollout(estimate(model, TRUTH), log, GAINS)


def test_in_open_loop_a_heavier_rotor_falls_behind_as_the_closed_form_says():
    model = arm(DriveTerms(rotor_inertia=True), joints=1)
    time = np.arange(600) / 200.0
    q = 0.5 * np.sin(3.0 * time)[:, None]
    dq, ddq = np.gradient(q, time, axis=0), -9.0 * q
    inertia, heavier = 0.03 + 0.05, 0.03 + 0.11
    # Commands that make the torque at half a sample later, as they are held.
    later = time + 0.5 / 200.0
    torque = inertia * -9.0 * 0.5 * np.sin(3.0 * later)[:, None]
    ahead = 0.5 * np.sin(3.0 * later)[:, None]
    slope = 1.5 * np.cos(3.0 * later)[:, None]
    told = ahead + (torque + GAINS.kd * slope) / GAINS.kp
    log = Recording(model.robot.joint_names, time, q, dq, ddq, position_command=told)
    window = 40
    for total in (inertia, heavier):
        made = replay_model(
            estimate(model, [total - 0.03]), log.joints, free_gains(GAINS), period=0.005
        )
        driven = commanded(log, GAINS)
        found = open_loop(made, driven, window=window / 200.0).errors[:, 0]
        begin = np.arange(len(found)) // window * window
        since = time[1 : len(found) + 1] - time[begin]
        # Both begin alike, and accelerate by what the inertias share of the torque.
        moved = q[1 : len(found) + 1, 0] - q[begin, 0]
        coasted = 1.5 * np.cos(3.0 * time[begin]) * since
        truth = (inertia / total - 1.0) * (moved - coasted)
        # First-order steps of 1 ms: a half of one at the speed gained, 1 mrad.
        np.testing.assert_allclose(found, truth, atol=1.5e-3)
    assert abs(truth).max() > 0.02


@pytest.mark.slow
def test_limits_of_a_file_do_not_stop_a_robot_that_was_beyond_them():
    model = arm()
    log = blank(model.robot.joint_names, *chirps())
    moved = []
    for limits in (LIMITS, JointLimits(-0.1, 0.05, 20.0, 0.5)):
        joints = tuple(replace(j, limits=limits) for j in model.robot.joints)
        narrow = TorqueModel(replace(model.robot, joints=joints), DRIVE)
        made = replay_model(estimate(narrow, TRUTH), log.joints, GAINS, period=0.005)
        moved.append(replay(made, log).position)
    assert np.ptp(moved[0]) > 0.5
    np.testing.assert_array_equal(moved[1], moved[0])
