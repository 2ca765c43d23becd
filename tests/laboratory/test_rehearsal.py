"""Rehearsals: planted truths are recovered, and predictions are compared with them."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from estimates import estimate_of
from excited import arm, arm_limits
from schemas import parsed

from consistent_id import DriveTerms, ModelError, ProblemError, TorqueModel
from consistent_id.cli import main
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.search_problem import search_problem
from consistent_id.excitation.sources import problem_to_excite
from consistent_id.laboratory.rehearsal.planted import (
    as_rehearsed,
    mujoco_robot,
    planted_robot,
)
from consistent_id.laboratory.rehearsal.rehearsal import (
    HELD,
    _averaged,
    held_poses,
    identified,
    play,
    rehearse,
)
from consistent_id.regression import base_parameters
from consistent_id.robot.inertia import pseudo_inertia

mujoco = pytest.importorskip("mujoco")

URDF = """
<robot name="two">
  <link name="base"/>
  <link name="one"><inertial><mass value="3"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.02" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <link name="two"><inertial><mass value="2"/><origin xyz="0.1 0 0.05"/>
    <inertia ixx="0.02" iyy="0.04" izz="0.05" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="first" type="revolute"><parent link="base"/><child link="one"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="40"/></joint>
  <joint name="second" type="revolute"><parent link="one"/><child link="two"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" velocity="2" effort="20"/></joint>
</robot>
"""
EFFORT = np.array([40.0, 30.0, 20.0])
FORM = PathForm(8.0, 5)


def limits():
    return arm_limits(arm(3), effort=EFFORT)


def planted(seed=0):
    return planted_robot(arm(3), limits(), np.random.default_rng(seed))


def path(number=0):
    model = TorqueModel(arm(3))
    problem = search_problem(model, base_parameters(model), FORM, Aim(), limits())
    return problem.basis.trajectory(problem.random(number))


def test_planted_bodies_are_consistent_and_near_the_nominal_ones():
    robot = planted()
    bodies = robot.parameters[:30].reshape(3, 10)
    assert np.linalg.eigvalsh(pseudo_inertia(bodies)).min() > 0.0
    nominal = arm(3).nominal.reshape(3, 10)
    assert 0.0 < abs(bodies[:, 0] / nominal[:, 0] - 1.0).max() < 0.5
    assert not np.array_equal(planted(1).parameters, robot.parameters)
    assert np.array_equal(planted(0).parameters, robot.parameters)


def test_mujocos_robot_has_the_planted_dynamics():
    # Truth: Pinocchio's mass matrix and bias with the same bodies, and the rotors.
    robot = planted()
    simulated = mujoco_robot(robot, 1e-3)
    rng = np.random.default_rng(0)
    q, dq = rng.uniform(-1.0, 1.0, (2, 3))
    torque = np.array([3.0, -2.0, 1.0])
    data = simulated.at(q, dq)
    simulated.model.dof_frictionloss[:] = 0.0
    simulated.model.dof_damping[:] = 0.0
    data.qfrc_applied[:] = torque
    mujoco.mj_forward(simulated.model, data)
    model = pin.Model()
    for joint, body in zip(
        arm(3).joints, robot.parameters[:30].reshape(3, 10), strict=True
    ):
        placement = pin.SE3(joint.rotation, joint.translation)
        axis = pin.JointModelRevoluteUnaligned(joint.axis)
        number = model.addJoint(joint.parent + 1, axis, placement, joint.name)
        inertia = pin.Inertia.FromDynamicParameters(body)
        model.appendBodyToJoint(number, inertia, pin.SE3.Identity())
    layout = robot.model.layout
    rotors = [
        robot.parameters[layout.index(f"joint{j}.rotor_inertia")] for j in (1, 2, 3)
    ]
    model.armature[:] = rotors
    model.gravity.linear[:] = arm(3).gravity
    expected = pin.aba(model, model.createData(), q, dq, torque)
    assert np.allclose(data.qacc[simulated.velocities], expected, rtol=1e-6)


def _estimated(drive):
    """A problem's torque model, and parameters that tell its terms apart."""
    model = TorqueModel(arm(3), drive)
    x = np.arange(1.0, len(model.layout) + 1.0)
    x[:30] = 1.1 * np.ravel(arm(3).nominal)
    return model, x


def test_estimates_are_rehearsed_by_what_rehearsed_robots_have():
    model, x = _estimated(DriveTerms(viscous=True, offset=True))
    words = ("link2", "joint1.offset", "joint3.rotor_inertia")
    found = as_rehearsed(model, words, x[None])
    assert found.interest == ("link2", "joint3.rotor_inertia")
    layout = found.model.layout
    for j in (1, 2, 3):
        name = f"joint{j}.viscous"
        assert found.parameters[0][layout.index(name)] == x[model.layout.index(name)]
        assert found.parameters[0][layout.index(f"joint{j}.coulomb")] == 0.0
    np.testing.assert_array_equal(np.ravel(found.model.robot.nominal), x[:30])
    assert [note.split(":")[0] for note in found.notes] == ["interest", "torque"]
    assert "joint2.offset" in found.notes[1]
    # What was found is planted to some percent; what was not, as without an estimate.
    rng = np.random.default_rng(0)
    robot = planted_robot(found.model.robot, limits(), rng, None, found.parameters[0])
    plain = planted_robot(found.model.robot, limits(), np.random.default_rng(0))
    for j, name in enumerate(layout.names[30:], start=30):
        known = found.parameters[0][j]
        if known > 0.0:
            assert 0.6 < robot.parameters[j] / known < 1.6
        else:
            assert robot.parameters[j] == plain.parameters[j], name


def test_what_cannot_be_rehearsed_is_refused():
    model, x = _estimated(DriveTerms(viscous=True, offset=True))
    with pytest.raises(ProblemError, match="name some of theirs"):
        as_rehearsed(model, ("*.offset",))
    with pytest.raises(ProblemError, match="no parameter, link or joint 'link9'"):
        as_rehearsed(model, ("link2", "link9"))
    x[4] = -1.0
    with pytest.raises(ProblemError, match="body of 'link1' is not physically"):
        as_rehearsed(model, (), x[None])


@pytest.mark.slow
def test_what_an_estimate_left_open_is_rehearsed(tmp_path, capsys):
    file = tmp_path / "two.urdf"
    file.write_text(URDF)
    problem = problem_to_excite(file, {})
    links = [link.nominal for link in problem.model.robot.links]
    made = estimate_of(problem.model, links, 0.1)
    left = tuple(
        "loose" if name.startswith("two.") else "data"
        for name in problem.model.layout.names
    )
    delivered = replace(made, origins=left).save(tmp_path / "delivered.json")
    call = ["rehearse", str(file), "--acceleration", "5", "--duration", "6"]
    call += ["--harmonics", "4", "--starts", "1", "--workers", "1", "--robots", "1"]
    call += ["--for", "open", "--parameters", str(delivered), "--json"]
    code = main(call)
    record = parsed(capsys.readouterr().out)
    assert code == (0 if record["came_true"] else 1)
    assert record["motions"]["design"]["robots"][0]["covered"] > 0.5


@pytest.mark.slow
def test_the_motion_is_followed_and_the_truth_is_found():
    robot, wanted = planted(), path()
    played = play(robot, wanted, np.zeros(3), np.random.default_rng(0))
    # 10 Hz of bandwidth; what friction does not explain moves joints by hundredths.
    assert played.tracking_error.max() < 0.03
    base = base_parameters(robot.model)
    found = identified(robot, base, played.log, 0.005 * EFFORT, 0.625)
    x = base.projection @ robot.parameters
    # Dry friction is no tanh: a few percent of the largest parameters remain.
    assert abs(found.errors(robot, base)).max() < 0.05 * abs(x).max()
    wrong = np.zeros(len(robot.model.layout))
    wrong[:30] = arm(3).nominal
    away = base.projection @ wrong - x
    assert np.linalg.norm(found.errors(robot, base)) < 0.3 * np.linalg.norm(away)


@pytest.mark.slow
def test_poses_are_held_by_the_truth_and_not_by_a_wrong_mass():
    robot = planted()
    played = play(robot, path(), np.zeros(3), np.random.default_rng(0))
    base = base_parameters(robot.model)
    found = identified(robot, base, played.log, 0.005 * EFFORT, 0.625).constrained
    held = held_poses(robot, found, limits(), np.random.default_rng(0))
    assert held.held == held.poses == 50 and held.largest <= HELD
    heavy = replace(found, parameters=1.5 * found.parameters)
    wrong = held_poses(robot, heavy, limits(), np.random.default_rng(0))
    assert wrong.held < 40 and wrong.largest > HELD


def test_a_sample_has_the_mean_torque_of_the_ticks_around_it():
    ramp = np.arange(21.0)[:, None]
    # The mean over five ticks about each fifth, half a tick late as torques hold.
    assert np.allclose(_averaged(ramp, 5)[1:-1, 0], [4.5, 9.5, 14.5])


@pytest.mark.slow
def test_errors_come_true_in_several_robots():
    wanted, other, noise = path(), path(1), 0.005 * EFFORT
    found = []
    for seed in range(4):
        robot = planted(seed)
        base = base_parameters(robot.model)
        accuracy = predicted_accuracy(robot.model, base, wanted, Aim(noise=noise))
        rng = np.random.default_rng(seed)
        found.append(
            rehearse(
                robot, accuracy, wanted, other, limits(), noise, rng, highest=0.625
            )
        )
    # Predictions are for errors correlated over 0.2 s: they may not be ten times off.
    assert 0.1 < np.sqrt(np.mean([one.ratio**2 for one in found])) < 2.0
    assert np.mean([one.covered for one in found]) > 0.8
    assert max(one.reached["velocity"].max() for one in found) < 1.2


def test_a_robot_without_inertias_cannot_be_planted():
    links = [replace(link, nominal=None) for link in arm(3).links]
    bare = replace(arm(3), links=tuple(links))
    with pytest.raises(ModelError, match="no nominal inertia"):
        planted_robot(bare, limits(), np.random.default_rng(0))


@pytest.mark.slow
def test_the_command_says_what_came_true(tmp_path, capsys):
    file = tmp_path / "two.urdf"
    file.write_text(URDF)
    call = ["rehearse", str(file), "--acceleration", "5", "--duration", "6"]
    call += ["--harmonics", "4", "--starts", "4", "--workers", "1", "--robots", "2"]
    code = main([*call, "--rivals", "--json"])
    record = parsed(capsys.readouterr().out)
    assert code == (0 if record["came_true"] else 1)
    # Friction and control come on top of the proven torque, of each joint.
    true, proven = record["peak_torque_shares"], record["proven_torque_shares"]
    assert len(true) == len(proven) == 4
    assert (np.array(true) > np.array(proven)).sum() >= 3
    most = max(record["largest_shares"].values())
    assert record["share_to_use"] == pytest.approx(min(1.0, 1.0 / most))
    motions = record["motions"]
    assert set(motions) >= {"design", "condition alone", "random paths", "sinusoids"}
    assert len(motions["design"]["robots"]) == 2
    # Condition numbers of the rehearsed regressions: the rival's criterion is that of
    # the planned motion, so that either may be smaller (20 to 24 and 24 to 25 here).
    assert all(1.0 < motion["condition"] < 1e3 for motion in motions.values())


@pytest.mark.slow
def test_currents_are_torque_by_constants_that_are_not_quite_known():
    robot = planted_robot(arm(3), limits(), np.random.default_rng(0), currents=0.05)
    same = planted()
    # The robot is the same one; only what its log shows differs.
    assert np.array_equal(robot.parameters, same.parameters)
    gains, steps = robot.sensors.gains, robot.sensors.steps
    assert (abs(np.log(gains)) < 0.25).all() and np.ptp(gains) > 0.01
    np.testing.assert_allclose(steps, EFFORT / 2048.0)
    torque = np.random.default_rng(1).normal(size=(50, 3))
    read = robot.sensors.read(torque)
    assert (abs(read - torque / gains) <= steps / 2.0 + 1e-12).all()
    np.testing.assert_allclose(np.round(read / steps), read / steps, atol=1e-9)
    assert np.array_equal(same.sensors.read(torque), torque)
    noise = np.zeros(3)
    plain, scaled = (
        play(one, path(), noise, np.random.default_rng(2)) for one in (same, robot)
    )
    assert np.array_equal(plain.truth.torque, scaled.truth.torque)
    off = scaled.log.torque * gains - plain.log.torque
    assert (abs(off) <= gains * steps / 2.0 + 1e-9).all()
