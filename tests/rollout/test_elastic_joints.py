"""Springs between motors and links: closed forms, and a stiffness found again."""

from dataclasses import replace

import numpy as np
import pytest
from commanded_leg import PROBLEM, ROBOT
from estimates import estimate_of

from consistent_id import DriveTerms, Recording, TorqueModel, load_problem
from consistent_id.errors import ModelError
from consistent_id.estimation.transmission_springs import joint_springs
from consistent_id.export.export_formats import exported
from consistent_id.problems.kept_text import toml_text
from consistent_id.regression.elastic_joints import DAMPING, as_rigid
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow, from_modified_dh
from consistent_id.signals import PDGains

mujoco = pytest.importorskip("mujoco")

from consistent_id.rollout import replay, replay_model  # noqa: E402
from consistent_id.rollout.candidates import Candidates  # noqa: E402
from consistent_id.rollout.chosen_settings import with_springs  # noqa: E402
from consistent_id.rollout.settings import (  # noqa: E402
    Settings,
    rollout_error,
    torque_fit,
    with_settings,
)

LINK, ROTOR = 0.03, 0.05  # kg m^2
SPRING = 60.0  # N m/rad: 7 Hz with the motor clamped


def one_joint():
    robot = from_modified_dh("arm", [DHRow(0.0, 0.0)], gravity=(0.0, 0.0, 0.0))
    body = InertialParameters([1.0, 0, 0, 0, 0.002, 0, 0.002, 0, 0, LINK])
    link = replace(robot.links[0], nominal=body)
    return TorqueModel(replace(robot, links=(link,)), DriveTerms(rotor_inertia=True))


def test_torque_of_a_rigid_joint_is_the_torque_without_what_its_spring_asks_for():
    time = np.arange(2000) / 200.0
    w, own = 2.0 * np.pi * 2.0, np.sqrt(SPRING / LINK)
    motor = 0.3 * np.exp(1j * w * time)[:, None]
    # Two masses in steady motion: the link's amplitude, and the motor's torque.
    coupling = own**2 + 2j * DAMPING * own * w
    link = motor * coupling / (coupling - w**2)
    torque = -(w**2) * (ROTOR * motor + LINK * link)
    model = one_joint()
    state = motor.imag, (1j * w * motor).imag, (-(w**2) * motor).imag
    names = model.robot.joint_names
    log = Recording(names, time, *state, torque=torque.imag)
    rigid = as_rigid(model.robot, log, np.array([1.0 / SPRING])).torque
    late = slice(1200, None)  # what the start excites has faded: 6 s of 7 Hz and 3 %
    expected = (-(w**2) * (ROTOR + LINK) * motor).imag
    error = abs(rigid - expected)[late].max()
    assert error < 1e-3 * abs(expected).max() < 0.02 * abs(torque - expected).max()
    assert as_rigid(model.robot, log, np.zeros(1)) is log


def test_a_joint_on_a_spring_moves_as_two_masses_do():
    model, gains = one_joint(), PDGains(40.0, 2.0, stiffness=SPRING)
    own = estimate_of(model, [model.robot.links[0].nominal], np.array([ROTOR]))
    time = np.arange(300) / 200.0
    told = np.full((300, 1), 0.2)
    still = np.zeros_like(told)
    names = model.robot.joint_names
    log = Recording(names, time, still, still, position_command=told)
    made = replay_model(own, names, gains, period=1 / 200)
    found = replay(made, log).position[:, 0]
    damping = 2.0 * DAMPING * np.sqrt(SPRING * LINK)
    # x = motor and link and their speeds.
    A = np.array(
        [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [
                -(40 + SPRING) / ROTOR,
                SPRING / ROTOR,
                -(2 + damping) / ROTOR,
                damping / ROTOR,
            ],
            [SPRING / LINK, -SPRING / LINK, damping / LINK, -damping / LINK],
        ]
    )
    from scipy.linalg import expm

    rest = np.array([0.2, 0.2, 0.0, 0.0])
    truth = [(rest - expm(A * t) @ rest)[0] for t in time]
    rigid = replay(replay_model(own, names, PDGains(40.0, 2.0), period=1 / 200), log)
    np.testing.assert_allclose(found, truth, atol=2.5e-3)
    assert abs(rigid.position[:, 0] - truth).max() > 0.01


def test_a_spring_without_a_rotor_is_refused():
    model = one_joint()
    own = estimate_of(model, [model.robot.links[0].nominal], np.array([0.0]))
    gains = PDGains(40.0, 2.0, stiffness=SPRING)
    with pytest.raises(ModelError, match="a rotor inertia of 0 "):
        replay_model(own, model.robot.joint_names, gains)


SPRUNG = """
<mujoco model="leg">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="0.0002" integrator="implicitfast"/>
  <worldbody>
    <body name="trunk">
      <inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>
      <body name="hip motor">
        <joint name="hip" axis="0 1 0"
               damping="0.3" frictionloss="0.4" armature="0.02"/>
        <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>
        <body name="thigh">
          <joint axis="0 1 0" stiffness="{hip}" damping="0.02"/>
          <inertial pos="0 0 -0.1" mass="1" diaginertia="0.005 0.005 0.001"/>
          <body name="knee motor" pos="0 0 -0.2">
            <joint name="knee" axis="0 1 0"
                   damping="0.2" frictionloss="0.25" armature="0.015"/>
            <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>
            <body name="shank">
              <joint axis="0 1 0" stiffness="{knee}" damping="0.02"/>
              <inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.0002"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
HIP = 80.0  # N m/rad: some 7 Hz on a motor that stands still


@pytest.fixture(scope="module", params=[(HIP, 1e4), (1e4, 1e4)], ids=["soft", "stiff"])
def problem(request, tmp_path_factory):
    """A problem whose log is MuJoCo's own, of a hip on a spring or of stiff joints."""
    place = tmp_path_factory.mktemp("leg")
    hip, knee = request.param
    (place / "leg.xml").write_text(ROBOT.format(hip="", knee=""))
    (place / "problem.toml").write_text(PROBLEM)
    model = mujoco.MjModel.from_xml_string(SPRUNG.format(hip=hip, knee=knee))
    data, rows = mujoco.MjData(model), []
    motors = [0, 2]
    for k in range(1900):
        t = k / 200.0
        phase = np.array([1.0, 1.4]) * t * 2.0 + 1.0 * t**2
        told = 0.4 * np.sin(phase)
        rows.append([t, *data.qpos[motors], *told])
        for _ in range(25):
            torque = 25.0 * (told - data.qpos[motors]) - 1.0 * data.qvel[motors]
            data.qfrc_applied[motors] = torque
            mujoco.mj_step(model, data)
    head = "time,q1,q2,qdes1,qdes2"
    np.savetxt(place / "log.csv", rows, delimiter=",", header=head, comments="")
    return load_problem(place), hip


@pytest.mark.slow
def test_springs_are_found_where_there_are_some_and_nowhere_else(problem):
    problem, hip = problem
    names = problem.model.robot.joint_names
    made = with_settings(problem, Settings(cutoff=20.0))
    found = joint_springs(made.model, made.training, constraints=made.constraints)
    chosen = with_springs(Settings(cutoff=20.0), problem, Candidates(problem).error)
    if hip > HIP:
        assert not found.compliance.any() and chosen.stiffness is None
        return
    stiffness = dict(zip(names, found.stiffness.tolist(), strict=True))
    # Friction that the model has only nearly is worth a twentieth of a spring.
    assert stiffness == {"hip": pytest.approx(HIP, rel=0.05), "knee": np.inf}
    assert found.misfit < 0.5
    assert chosen.stiffness == tuple(stiffness.values())


@pytest.mark.slow
def test_a_robot_with_a_spring_is_followed_as_well_as_one_without(problem):
    problem, hip = problem
    errors, rotors = [], []
    for stiffness in (None, (hip, np.inf)):
        made = with_settings(problem, Settings(cutoff=20.0, stiffness=stiffness))
        estimate, _ = torque_fit(made)
        errors.append(rollout_error(made, estimate, made.logs("validation")))
        rotors.append(estimate["hip.rotor_inertia"])
    assert errors[1] < 3.5e-3  # MuJoCo's dry friction is not the model's tanh
    assert rotors[1] == pytest.approx(0.0206, abs=5e-4)  # with and without a spring
    if hip == HIP:
        assert errors[1] < 0.25 * errors[0]


@pytest.mark.slow
def test_a_file_asks_for_springs_and_an_export_says_that_it_has_none(problem):
    problem, hip = problem
    asked = PROBLEM.replace("kd = 1.0", 'kd = 1.0\nstiffness = "estimated"')
    file = problem.folder / "asked.toml"
    file.write_text(asked)
    made = load_problem(file)
    (table,) = made.drives.tables()
    if hip > HIP:
        assert "rigid" in table.text() and not np.isfinite(made.gains.stiffness).any()
        return
    assert made.gains.stiffness[0] == pytest.approx(HIP, rel=0.05)
    error = made.drives.springs.standard_errors[0] * made.gains.stiffness[0]
    assert 0.0 < error < 0.05  # of the stiffness
    stated = with_settings(made, Settings(cutoff=20.0))
    again = problem.folder / "again.toml"
    again.write_text(toml_text(stated.table, {}))
    assert load_problem(again).gains.stiffness.tolist() == pytest.approx(
        [made.gains.stiffness[0], np.inf]
    )
    estimate, _ = torque_fit(stated)
    for form in ("mjcf", "isaaclab"):
        export = exported(estimate, form, gains=stated.gains, allow_refused=True)
        assert "hip (8" in export.notes[-1] or "hip (7" in export.notes[-1]
    assert not any(
        "springs between" in note
        for note in exported(estimate, "mjcf", allow_refused=True).notes
    )
