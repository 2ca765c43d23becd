"""Shapes and drives of a robot's file, as evidence beside an estimate."""

from dataclasses import replace

import numpy as np
import pytest
from logged import DRIVE, moved, write_arm

from consistent_id import (
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    differentiated,
    load_robot,
    low_passed,
)
from consistent_id.constraints import ParameterBounds
from consistent_id.constraints.delivered_bodies import robot_size
from consistent_id.estimation.drive_ratios import (
    DriveRatios,
    drive_ratios,
    drive_reasons,
    errors_off_bounds,
    log_speeds,
)
from consistent_id.problems.stated_model import drawn_parts
from consistent_id.robot.solids import DrawnDrive, DrawnParts

MJCF = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body name="one"><joint name="a" axis="0 1 0" damping="{a}" armature="{r}"/>
  <inertial pos=".2 0 0" mass="4" diaginertia=".02 .08 .08"/>
  <geom type="capsule" fromto="0 0 0 .4 0 0" size=".05"/>
  <body name="two" pos=".4 0 0">
    <joint name="b" axis="0 0 1" damping="2.4" armature=".12"/>
    <inertial pos=".1 0 0" mass="2" diaginertia=".02 .03 .03"/>
    <geom type="sphere" pos=".3 0 0" size=".1"/>
    <body name="three" pos=".3 0 0"><joint name="c" damping="3.1" armature=".053"
        frictionloss=".5" axis="0 1 0" pos=".1 0 0"/>
      <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>
      <geom type="sphere" pos=".2 0 0" size=".1"/></body></body></body>
</worldbody></mujoco>"""


class Stated:
    """A problem, as far as its robot is asked for."""

    def __init__(self, folder, robot, **model):
        self.folder, self.model = folder, TorqueModel(robot, DRIVE)
        named = {"urdf": None, "mjcf": None} | model
        self.table = type(
            "T",
            (),
            {
                "model": type("M", (), named),
                "excitation": type("E", (), {"scene": None}),
            },
        )

    def file(self, name):
        return self.folder / name


def urdf_arm(folder):
    """Write an arm with shapes of its links, and of a tool fixed to the last."""
    urdf, _ = write_arm(folder)
    box = '<collision><origin xyz="0.2 0 0"/><geometry><box size="{}"/></geometry>'
    text = urdf.read_text()
    for link, size in (("upper", ".2 .4 .4"), ("fore", ".2 .1 .1")):
        shaped = f'<link name="{link}">{box.format(size)}</collision>'
        text = text.replace(f'<link name="{link}">', shaped)
    text = text.replace(
        "</robot>",
        '<link name="tool"><collision><origin xyz="0 0.2 0"/><geometry>'
        '<sphere radius="0.1"/></geometry></collision></link>'
        '<joint name="fixed" type="fixed"><parent link="fore"/>'
        '<child link="tool"/><origin xyz="0.3 0 0.4" rpy="1 0 0"/></joint></robot>',
    )
    urdf.write_text(text)
    return urdf, load_robot(urdf)


def test_the_reach_of_links_is_that_of_their_shapes_with_those_of_merged_links(
    tmp_path,
):
    urdf, robot = urdf_arm(tmp_path)
    reach = drawn_parts(Stated(tmp_path, robot, urdf=urdf.name)).reach
    # Of a box .2 x .4 x .4 about (.2, 0, 0), and of a ball of .1 that is .2 from the
    # tool's origin at (.3, 0, .4), along an axis turned by one radian about x.
    ball = np.linalg.norm([0.3, 0.2 * np.cos(1.0), 0.4 + 0.2 * np.sin(1.0)])
    assert reach == pytest.approx({"upper": 0.2 + 0.3, "fore": ball + 0.1})


def test_a_tool_with_a_mass_and_no_shape_makes_the_shapes_of_its_link_unknown(tmp_path):
    urdf, _ = urdf_arm(tmp_path)
    inertial = (
        '<inertial><mass value="{}"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" '
        'ixz="0" iyz="0"/></inertial>'
    )
    text = urdf.read_text()
    for mass, known in (("3", {"upper"}), ("0.01", {"upper", "fore"})):
        bare = (
            f'<link name="bare">{inertial.format(mass)}</link><joint name="fixed2" '
            'type="fixed"><parent link="fore"/><child link="bare"/>'
            '<origin xyz="1.2 0 0"/></joint></robot>'
        )
        urdf.write_text(text.replace("</robot>", bare))
        drawn = drawn_parts(Stated(tmp_path, load_robot(urdf), urdf=urdf.name))
        assert set(drawn.reach) == known


def test_a_file_that_is_gone_draws_nothing_and_a_note_says_so(tmp_path):
    _, robot = urdf_arm(tmp_path)
    gone = drawn_parts(Stated(tmp_path, robot, urdf="none.urdf"))
    assert (dict(gone.reach), dict(gone.drives)) == ({}, {})
    model = TorqueModel(robot, DRIVE)
    ratios = drive_ratios(model, np.zeros(len(model.layout)), None, gone, {})
    (note,) = drive_reasons(ratios)
    assert note.word == "use"
    assert "none.urdf" in note.statement
    assert drawn_parts(Stated(tmp_path, robot)) == DrawnParts()


def test_mjcf_draws_shapes_and_drives(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(MJCF.format(a=1, r=0.2))
    robot = load_robot(tmp_path / "arm.xml")
    drawn = drawn_parts(Stated(tmp_path, robot, mjcf="arm.xml"))
    # MuJoCo bounds a capsule by a ball about its middle; joint c is at (.1, 0, 0).
    assert drawn.reach == pytest.approx({"one": 0.45, "two": 0.4, "three": 0.2})
    assert drawn.drives["c"] == DrawnDrive(3.1, 0.5, 0.053)
    assert drawn.friction_known
    assert drawn.rotors_known


@pytest.mark.parametrize(
    ("mass", "inertia"),
    [('pos=".9 0 0" mass="1"', ".01"), ('pos=".1 0 0" mass="1"', ".2")],
)
def test_mjcf_shapes_without_their_body_s_mass_are_not_the_whole_body(
    tmp_path, mass, inertia
):
    pytest.importorskip("mujoco")
    text = MJCF.format(a=1, r=0.2)
    own = 'pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"'
    assert own in text
    other = f'{mass} diaginertia="{inertia} {inertia} {inertia}"'
    (tmp_path / "arm.xml").write_text(text.replace(own, other))
    robot = load_robot(tmp_path / "arm.xml")
    drawn = drawn_parts(Stated(tmp_path, robot, mjcf="arm.xml"))
    assert set(drawn.reach) == {"one", "two"}


@pytest.mark.parametrize(
    ("drives", "known"),
    [
        ([(1.0, 1.0)] * 6, False),  # of one Z1
        ([(0.0, 0.0)] * 6, False),  # of one UR10
        ([(10.0, 1.0), (5.0, 1.0), (10.0, 1.0)], False),
        ([(10.0, 1.0), (5.0, 1.0), (2.0, 1.0)], False),  # of an xArm 7
        ([(3.0, 10.0), (8.0, 10.0), (10.0, 12.0)], False),  # of an Allegro hand
        ([(2.3799, 2.1069), (3.493, 2.1582), (7.0, 5.9808)], True),  # of a measured Z1
    ],
)
def test_values_that_are_alike_or_round_are_placeholders(drives, known):
    named = {f"j{k}": DrawnDrive(*pair) for k, pair in enumerate(drives)}
    assert DrawnParts(drives=named).friction_known == known


def test_shapes_bound_a_body_of_which_the_file_says_nothing_else(tmp_path):
    _, robot = urdf_arm(tmp_path)
    links = tuple(replace(link, nominal=None) for link in robot.links)
    unknown = TorqueModel(replace(robot, links=links), DRIVE)
    x = np.zeros(len(unknown.layout))
    x[[0, 10]] = 4.0, 2.0
    assert np.isinf(robot_size(unknown, x).size[1])
    seen = robot_size(unknown, x, {"fore": 0.6})
    assert seen.size[1] == pytest.approx(0.6)


def ratios(clock=1.0, gain=1.0, scatter=1.3, joints=6):
    """Return doubts of drives of which each is off by a factor, and all by others."""
    rng = np.random.default_rng(0)
    off = scatter ** rng.choice([-1.0, 1.0], (2, joints))
    friction, rotors = off * np.array([[gain], [gain * clock**2]])
    return doubts(friction, rotors)


def doubts(friction, rotors):
    names = tuple(f"j{k}" for k in range(len(friction)))
    return list(drive_reasons(DriveRatios(names, friction, rotors)))


@pytest.mark.parametrize(
    ("clock", "gain", "said"),
    [
        (1.0, 1.0, []),
        (1.3, 1.0, []),  # a file's rotor inertia is not worth so much
        (2.0, 1.0, ["rotor inertia"]),
        (0.5, 1.0, ["rotor inertia"]),
        (1.0, 1.5, []),
        (1.0, 10.0, ["friction", "rotor inertia"]),
    ],
)
def test_drives_that_are_all_off_alike_are_doubted(clock, gain, said):
    found = ratios(clock, gain)
    assert [r.statement.partition(" of ")[0] for r in found] == said
    assert {r.word for r in found} <= {"use with care"}
    if said == ["rotor inertia"]:
        factor = float(found[0].statement.split(" is ")[1].split()[0])
        assert factor == pytest.approx(clock**2, rel=0.3)


def test_drives_that_scatter_as_much_say_nothing():
    assert ratios(clock=2.0, scatter=8.0) == []
    assert ratios(clock=3.0, joints=2) == []


def test_a_joint_without_friction_says_that_joints_are_not_alike():
    alike = np.full(6, 3.0)
    assert [r.kind for r in doubts(alike, np.full(6, np.nan))] == ["nominal drives"]
    for none in (-1.0, 0.0, 1e-7):
        mixed = np.array([3.0, 3.0, 3.0, 3.0, none, 3.0])
        assert doubts(mixed, np.full(6, np.nan)) == []
    assert doubts(np.full(6, np.nan), np.full(6, 1e-7)) == []


SPEEDS = {"a": 0.5, "b": 0.5, "c": 0.2}


@pytest.fixture(name="drives")
def _drives(tmp_path):
    """Return a model, what its file draws, parameters and small errors."""
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(MJCF.format(a=1, r=0.2))
    robot = load_robot(tmp_path / "arm.xml")
    drawn = drawn_parts(Stated(tmp_path, robot, mjcf="arm.xml"))
    model = TorqueModel(robot, replace(DRIVE, rotor_inertia=True))
    x = np.zeros(len(model.layout))
    for joint, viscous, coulomb, rotor in (("a", 2, 0, 0.1), ("c", 6, 0.5, 0.2)):
        for name, value in (
            ("viscous", viscous),
            ("coulomb", coulomb),
            ("rotor_inertia", rotor),
        ):
            x[model.layout.index(f"{joint}.{name}")] = value
    return model, drawn, x, np.full(len(x), 1e-3)


def test_ratios_are_those_of_an_estimate_s_drives_at_the_speed_of_the_log(drives):
    model, drawn, x, errors = drives
    found = drive_ratios(model, x, errors, drawn, SPEEDS)
    assert found.joints == ("a", "b", "c")
    # Of joint c, 6 * 0.2 + 0.5 over 3.1 * 0.2 + 0.5.
    np.testing.assert_allclose(found.friction, [2.0, 0.0, 1.7 / 1.12])
    np.testing.assert_allclose(found.rotors, [0.5, 0.0, 0.2 / 0.053])
    for unknown in (
        drive_ratios(model, x, errors, DrawnParts(), SPEEDS),
        drive_ratios(model, x, None, drawn, SPEEDS),
    ):
        assert np.isnan([unknown.friction, unknown.rotors]).all()
    assert np.isnan(drive_ratios(model, x, errors, drawn, {}).friction).all()


@pytest.mark.parametrize("error", [np.nan, 0.1])
def test_drives_that_the_data_do_not_determine_are_not_compared(drives, error):
    model, drawn, x, errors = drives
    errors[model.layout.index("c.rotor_inertia")] = error  # of a value of 0.2
    errors[model.layout.index("a.viscous")] = 10.0 * error  # of a value of 2
    found = drive_ratios(model, x, errors, drawn, SPEEDS)
    np.testing.assert_array_equal(np.isnan(found.rotors), [False, False, True])
    np.testing.assert_array_equal(np.isnan(found.friction), [True, False, False])


def test_drives_on_a_bound_are_not_compared(drives):
    model, drawn, x, errors = drives
    bounds = ParameterBounds(
        {
            "c.rotor_inertia": (0.0, 0.2),
            "a.rotor_inertia": (0.01, np.inf),
            "b.rotor_inertia": (0.0, 1.0),
            "a.viscous": (2.0 + 1e-6, 5.0),
        }
    )
    inside = errors_off_bounds(model.layout, x, errors, (bounds,))
    found = drive_ratios(model, x, inside, drawn, SPEEDS)
    np.testing.assert_allclose(found.rotors, [0.5, 0.0, np.nan])
    np.testing.assert_allclose(found.friction, [np.nan, 0.0, 1.7 / 1.12])


def test_the_speed_of_a_log_is_the_rms_of_all_recordings():
    time = np.arange(5) / 10.0
    logs = [
        Recording(("a", "b"), time, np.zeros((5, 2)), np.full((5, 2), [3.0, 1.0])),
        Recording(("a",), time, np.zeros((5, 1)), np.full((5, 1), 4.0)),
    ]
    assert log_speeds(logs) == pytest.approx({"a": np.sqrt(12.5), "b": 1.0})


@pytest.mark.slow
def test_rotor_and_link_of_a_first_joint_are_one_sum_and_not_compared(tmp_path):
    """Its rotor is the prior's."""
    urdf, _ = write_arm(tmp_path)
    model = TorqueModel(load_robot(urdf), replace(DRIVE, rotor_inertia=True))
    plain = TorqueModel(model.robot, DRIVE)
    log = differentiated(low_passed(moved(plain), motion_cutoff=10, torque_cutoff=10))
    estimate = constrained_least_squares(
        model, build_regression(model, log), constraints=[PhysicalConsistency()]
    )
    drawn = DrawnParts(
        drives={
            "shoulder": DrawnDrive(1.0, 1.5, 0.12),
            "elbow": DrawnDrive(1.0, 2.5, 0.25),
            "other": DrawnDrive(1.0, 3.0, 0.3),
        }
    )
    (report,) = compare([estimate], [log], training=[log], drawn=drawn).reports
    found = report.evidence.drives
    assert estimate["shoulder.rotor_inertia"] != 0.0
    assert np.isnan(found.rotors[0])
    assert np.isfinite(found.friction).all()
    assert report.speeds == log_speeds([log])
