"""What a robot's file says of its torque: rotors, friction, weight, actuators."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.design_record import kept_limits
from consistent_id.excitation.request import design_request
from consistent_id.excitation.sources import problem_to_excite
from consistent_id.excitation.verification import FileParts, demands
from consistent_id.motion.limits import motion_limits
from consistent_id.problems.statement import Statement
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.loaders.mjcf import load_mjcf
from consistent_id.robot.solids import DrawnDrive

BODY = (
    '<inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/><inertia ixx="0.02" '
    'iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>'
)
BESIDE = '<parent link="base"/><child link="l3"/>'
SHAPE = '<visual><geometry><sphere radius="0.05"/></geometry></visual>'


def arm(dynamics="", bodies=("3", "2", "1"), frame=False):
    """A pendulum of three links; a body of no mass is not written."""
    links = ['<link name="base"/>']
    for k, mass in enumerate(bodies, 1):
        inside = BODY.format(mass=mass) if mass else ""
        links.append(f'<link name="l{k}">{"" if frame else SHAPE}{inside}</link>')
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="{before}"/>'
        f'<child link="l{k}"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>{dynamics}'
        '<limit lower="-2" upper="2" velocity="2" effort="60"/></joint>'
        for k, before in ((1, "base"), (2, "l1"), (3, "l2"))
    ]
    return f'<robot name="arm">{"".join(links + joints)}</robot>'


def request(folder, text, **stated):
    file = folder / "arm.urdf"
    file.write_text(text)
    problem = problem_to_excite(file, {}, Statement(**stated))
    return problem, design_request(problem)


def required(problem, asked):
    model = ci.TorqueModel(problem.moving)
    share = asked.friction_share
    return demands(model, asked.limits, None, asked.scene, share, asked.stated)


def test_small_friction_of_the_file_is_within_the_share_that_is_left(tmp_path):
    problem, asked = request(tmp_path, arm('<dynamics damping="2" friction="5"/>'))
    found = required(problem, asked)
    assert asked.stated.drives["j1"] == DrawnDrive(2.0, 5.0)  # 9 N m at 2 rad/s, of 18
    assert found.model.layout.drive == ()
    np.testing.assert_allclose(found.limits.effort, 0.7 * 60.0)
    assert "30 % of the limits is left" in found.torque_of


def test_large_friction_of_the_file_counts_in_place_of_the_share(tmp_path):
    problem, asked = request(tmp_path, arm('<dynamics damping="5" friction="9"/>'))
    found = required(problem, asked)
    np.testing.assert_allclose(found.limits.effort, 60.0)
    assert "friction of j1, j2, j3 as the file states it" in found.torque_of
    values = dict(zip(found.model.layout.names, found.parameters[0], strict=True))
    assert (values["j2.viscous"], values["j2.coulomb"]) == (5.0, 9.0)


def test_rotors_count_beside_the_share(tmp_path):
    problem, asked = request(tmp_path, arm())
    drives = {"j2": DrawnDrive(rotor_inertia=0.8)}
    model = ci.TorqueModel(problem.moving)
    found = demands(model, asked.limits, stated=FileParts(drives))
    assert found.model.layout.drive == (("j2", "rotor_inertia"),)
    assert found.parameters[0, -1] == 0.8
    np.testing.assert_allclose(found.limits.effort, 0.7 * 60.0)
    assert "its rotors included" in found.torque_of


@pytest.mark.slow
def test_the_torque_with_stated_friction_stays_within_the_limits(tmp_path):
    """Pinocchio's torque, and friction of 4 N m s/rad and 13 N m: 21 N m of 40."""
    text = arm('<dynamics damping="4" friction="13"/>').replace('"60"', '"40"')
    problem, asked = request(tmp_path, text)
    model = ci.TorqueModel(problem.moving)
    form = ci.PathForm(6.0, 4)
    design = design_trajectory(
        model, form, limits=asked.limits, stated=asked.stated, starts=1, workers=1,
        time_limit=0.5,
    )  # fmt: skip
    played = design.trajectory.recording(500.0)
    robot = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data = robot.createData()
    motion = zip(played.position, played.velocity, played.acceleration, strict=True)
    rigid = np.array([pin.rnea(robot, data, *state) for state in motion])
    rubbed = 4.0 * played.velocity + 13.0 * np.sign(played.velocity)
    reached = abs(rigid + rubbed).max(axis=0)
    assert (reached <= 40.0).all() and reached.max() > 36.0


def test_links_without_mass_take_the_proof_away(tmp_path):
    problem, asked = request(tmp_path, arm(bodies=("3", "", "1")))
    found = required(problem, asked)
    assert asked.stated.massless == found.unweighed == ("l2",)
    said = kept_limits(found)
    assert said.startswith("limits of torque: NOT CHECKED with the weight of l2; ")
    assert "limits of position, velocity: proven" in said
    assert any("l2 has no mass in the robot's file" in note for note in found.notes)
    # A frame has no mass.
    problem, asked = request(tmp_path, arm(bodies=("3", "", "1"), frame=True))
    assert asked.stated.massless == ()
    assert "torque: proven" in kept_limits(required(problem, asked))


def test_a_robot_without_any_mass_has_no_torque_to_check(tmp_path):
    problem, asked = request(tmp_path, arm(bodies=("", "", "")))
    found = required(problem, asked)
    assert found.parameters is None
    assert "torque is not checked: no link has a mass" in found.notes[-1]
    said = kept_limits(found)
    assert said.startswith("limits of torque: NOT CHECKED; limits of position, veloc")
    assert "torque" not in said.partition("no limit is stated for")[2]


def test_weight_behind_the_tip_takes_the_proof_away(tmp_path):
    problem, asked = request(tmp_path, arm(), tip="l2")
    found = required(problem, asked)
    assert asked.stated.behind == found.unweighed == ("l3",)
    assert "NOT CHECKED with the weight of l3" in kept_limits(found)
    assert request(tmp_path, arm())[1].stated.behind == ()
    _, asked = request(tmp_path, arm(bodies=("3", "2", "")), tip="l2")
    assert asked.stated.behind == ()
    # A second arm on the base does not hang on a link that moves.
    other = arm().replace('<parent link="l2"/><child link="l3"/>', BESIDE)
    assert request(tmp_path, other, tip="l2")[1].stated.behind == ()


MOTORS = """<mujoco><worldbody><body><inertial pos="0 0 .1" mass="1"
 diaginertia=".1 .1 .1"/><joint name="a" axis="0 1 0"/><body><inertial pos="0 0 .1"
 mass="1" diaginertia=".1 .1 .1"/><joint name="b" axis="0 1 0" armature=".3"
 damping=".2" frictionloss=".1"/></body></body></worldbody><actuator>
 {first}<position joint="b" ctrlrange="-2 2" kp="100"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("motor", "effort"),
    [
        ('ctrlrange="-10 10" gear="3"', 30.0),
        ('ctrlrange="-10 4" gear="-3"', 12.0),
        ('ctrlrange="0 10"', 10.0),
        ('ctrlrange="-10 10" forcerange="-5 40"', 5.0),
        ('forcerange="-7 40" gear="2"', 14.0),
        ("", np.inf),
    ],
)
def test_motors_state_their_torque_by_their_controls_and_forces(
    tmp_path, motor, effort
):
    """Both ways: of an uneven range, the smaller side."""
    file = tmp_path / "arm.xml"
    file.write_text(MOTORS.format(first=f'<motor joint="a" {motor}/>'))
    first, second = load_mjcf(file).joints
    assert first.limits.effort == pytest.approx(effort)
    assert second.limits.effort == np.inf  # its controls are positions
    limits = motion_limits(load_robot(file), velocity=1.0)
    assert limits.effort[0] == pytest.approx(effort)


def test_drives_of_an_mjcf_are_read(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(MOTORS.format(first=""))
    changes = {"velocity": 2.0}
    asked = design_request(problem_to_excite(file, changes, Statement()))
    assert asked.stated.drives["b"] == DrawnDrive(0.2, 0.1, 0.3)


def test_options_of_feet_are_refused_without_feet(tmp_path, capsys):
    file = tmp_path / "arm.urdf"
    file.write_text(arm())
    for option in (["--friction", "0.3"], ["--link", "l1"], ["--candidates", "5"]):
        assert main(["excite", str(file), "--dry-run", *option]) == 2
        assert f"{option[0]} is of a robot on its feet" in capsys.readouterr().err
    assert main(["excite", str(file), "--dry-run", "--candidates", "320"]) == 0


def test_the_shell_limits_the_effort_of_arms(tmp_path, capsys):
    file = tmp_path / "arm.urdf"
    file.write_text(arm())
    problem = problem_to_excite(file, {"effort": 5.0}, Statement())
    assert design_request(problem).limits.effort.tolist() == [5.0] * 3
    assert main(["excite", str(file), "--dry-run", "--effort", "40", "--json"]) == 0
    assert '"effort"' in capsys.readouterr().out


def test_weight_that_no_pose_holds_is_refused_before_the_search(tmp_path):
    """Level within 0.1 rad: nearly 9.81 (3 * 0.2 + 2 * 0.5 + 1 * 0.8) = 23.5 N m."""
    text = arm().replace('lower="-2" upper="2"', 'lower="-0.1" upper="0.1"')
    problem, asked = request(tmp_path, text.replace('effort="60"', 'effort="20"'))
    with pytest.raises(InfeasibleError, match=r"j1 needs 23\.\d N m") as no:
        required(problem, asked)
    assert "may use 14: no motion keeps this" in str(no.value)
    with pytest.raises(InfeasibleError, match="j1 needs"):
        design_trajectory(
            ci.TorqueModel(problem.moving), limits=asked.limits, time_limit=60.0
        )
    strong, asked = request(tmp_path, text)
    required(strong, asked)
    weak = replace(asked, limits=replace(asked.limits, effort_rms=np.full(3, 20.0)))
    with pytest.raises(InfeasibleError, match="may use 14 root mean square"):
        required(strong, weak)
    # In a wide range, there is a pose in which the arm hangs.
    wide, asked = request(tmp_path, arm().replace('effort="60"', 'effort="1e-6"'))
    required(wide, asked)
    # Before a search, too: a plan says it.
    assert main(["excite", str(tmp_path / "arm.urdf"), "--dry-run"]) == 0
    (tmp_path / "arm.urdf").write_text(text.replace('effort="60"', 'effort="20"'))
    assert main(["excite", str(tmp_path / "arm.urdf"), "--dry-run"]) == 2


def test_limits_that_are_stated_and_not_used_are_said(tmp_path):
    soft = (
        '<safety_controller k_velocity="1" soft_lower_limit="-1" '
        'soft_upper_limit="{}"/>'
    )
    text = arm().replace('velocity="2" effort="60"', 'velocity="2" effort="0"', 2)
    text = text.replace('"/></joint>', f'"/>{soft.format(2)}</joint>', 1)
    problem, asked = request(tmp_path, text)
    first, second = asked.stated.notes
    assert first == "effort = 0 of j1, j2 in the file is read as no limit"
    assert second.startswith("soft limits (<safety_controller>) of j1 are narrower")
    assert required(problem, asked).notes[:2] == (first, second)
    same = arm().replace('"/></joint>', f'"/>{soft.format(3)}</joint>', 1)
    same = same.replace('soft_lower_limit="-1"', 'soft_lower_limit="-3"')
    assert request(tmp_path, same)[1].stated.notes == ()
    (tmp_path / "arm.urdf").write_text(arm().replace('velocity="2"', 'velocity="0"', 1))
    changes = {"velocity": 1.0}
    still = problem_to_excite(tmp_path / "arm.urdf", changes, Statement())
    (said,) = design_request(still).stated.notes
    assert said == "velocity = 0 of j1 in the file is read as no limit"


@pytest.mark.parametrize(
    ("drive", "velocity", "kept", "counts"),
    [
        (DrawnDrive(1e-4, 0.0), np.inf, 0.7, False),  # as MJCF files state it
        (DrawnDrive(0.0, 55.0), 2.0, 0.7, False),  # a placeholder: 55 of 60 N m
        (DrawnDrive(301.0, 0.0), 2.0, 0.7, False),
        (DrawnDrive(299.0, 0.0), 2.0, 1.0, True),  # drag makes it slower
        (DrawnDrive(0.0, 53.0), 2.0, 1.0, True),
        (DrawnDrive(0.0, 18.1), np.inf, 1.0, True),
        (DrawnDrive(0.0, 17.9), np.inf, 0.7, False),
    ],
)
def test_friction_counts_between_the_share_and_placeholders(
    tmp_path, drive, velocity, kept, counts
):
    problem, asked = request(tmp_path, arm())
    speeds = {"velocity": np.full(3, velocity), "acceleration": np.full(3, 5.0)}
    limits = replace(asked.limits, **speeds)
    model, stated = ci.TorqueModel(problem.moving), FileParts({"j1": drive})
    found = demands(model, limits, stated=stated)
    assert found.limits.effort.tolist() == pytest.approx([kept * 60.0, 42.0, 42.0])
    assert bool(found.model.layout.drive) is counts
    odd = any("friction of j1 in the file is as large" in n for n in found.notes)
    assert odd is (drive.coulomb == 55.0 or drive.viscous == 301.0)


def test_friction_counts_against_limits_over_time(tmp_path):
    problem, asked = request(tmp_path, arm())
    none, few = np.full(3, np.inf), np.full(3, 30.0)
    limits = replace(asked.limits, effort=none, effort_rms=few)
    stated = FileParts({"j1": DrawnDrive(2.0, 6.0)})  # 10 N m of 30, more than 30 %
    found = demands(ci.TorqueModel(problem.moving), limits, stated=stated)
    assert found.limits.effort_rms.tolist() == pytest.approx([30.0, 21.0, 21.0])
    limits = replace(limits, effort_rms=none, effort_rate=few)
    found = demands(ci.TorqueModel(problem.moving), limits, friction_share=0.0)
    assert np.isinf(found.limits.effort).all()


@pytest.mark.parametrize("share", [-0.1, 1.0, np.nan])
def test_a_share_that_cannot_be_is_refused(tmp_path, share):
    problem, asked = request(tmp_path, arm('<dynamics damping="5" friction="9"/>'))
    model = ci.TorqueModel(problem.moving)
    with pytest.raises(ProblemError, match="friction_share is"):
        demands(model, asked.limits, None, None, share, asked.stated)


@pytest.mark.parametrize(
    ("motors", "effort"),
    [
        (('ctrlrange="0 1" gear="30"', 'ctrlrange="0 1" gear="-30"'), 30.0),
        (('ctrlrange="-1 1" gear="30"', 'ctrlrange="0 1" gear="50"'), 30.0),
        (('ctrlrange="-1 1" gear="30"', ""), np.inf),
    ],
)
def test_ranges_of_motors_on_one_joint_add(tmp_path, motors, effort):
    file = tmp_path / "arm.xml"
    lines = "".join(f'<motor joint="a" {one}/>' for one in motors)
    file.write_text(MOTORS.format(first=lines))
    assert load_mjcf(file).joints[0].limits.effort == pytest.approx(effort)
