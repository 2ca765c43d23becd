"""MJCF: MuJoCo's inverse dynamics as the truth, and what is refused."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from consistent_id import ModelError, TorqueModel, load_problem
from consistent_id.robot import load_mjcf

mujoco = pytest.importorskip("mujoco")

TREE = """
<mujoco model="tree">
  <compiler angle="degree" autolimits="true"/>
  <option gravity="0.5 -0.3 -9.7"/>
  <include file="defaults.xml"/>
  <worldbody>
    <body name="stand" pos="0 0 0.4" euler="10 20 30">
      <geom size="0.1" mass="5"/>
      <body name="upper" pos="0.1 0.2 0.3" quat="0.9 0.1 -0.3 0.2">
        <joint name="turn" axis="0.6 0 0.8" pos="0.05 0 0.1" range="-120 90" ref="25"/>
        <inertial pos="0.1 0.02 0.3" mass="2"
          fullinertia="0.02 0.03 0.025 0.001 0.002 0.003"/>
        <body name="plate" pos="0 0.1 0" euler="0 45 0">
          <geom type="box" size="0.1 0.2 0.02" density="800" pos="0.02 0 0"/>
        </body>
        <body name="slider" pos="0.2 0 0" euler="0 90 0">
          <joint name="slide" type="slide" axis="0 -1 0" ref="0.1" range="0 0.4"
            actuatorfrcrange="-30 20"/>
          <geom type="capsule" size="0.04" fromto="0 0 0 0.1 0.2 0.3" density="900"/>
          <body name="tool" pos="0 0.1 0.2">
            <geom type="ellipsoid" size="0.03 0.05 0.08"/>
          </body>
        </body>
        <body name="wrist" pos="-0.2 0 0.1">
          <joint name="roll" axis="1 0 0" pos="0 0.03 0"/>
          <joint name="lift" type="slide" axis="0 0 1"/>
          <joint name="pitch" axis="0 1 0" pos="0.02 0 0.01" ref="-40"/>
          <geom type="cylinder" size="0.05 0.1" pos="0.1 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="turn" gear="50" forcerange="-2 3"/></actuator>
</mujoco>
"""
DEFAULTS = '<mujocoinclude><default><geom density="1200"/></default></mujocoinclude>'


@pytest.fixture
def written(tmp_path):
    """Write an MJCF text, changed, and return its path."""

    def write(*changes, text=TREE):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "defaults.xml").write_text(DEFAULTS)
        path = tmp_path / "robot.xml"
        path.write_text(text)
        return path

    return write


def _inverse(path, names, states, locked=()):
    """Joint torque by MuJoCo, without armature; other joints stand at their place."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    places = [int(model.joint(name).dofadr[0]) for name in names]
    torques = []
    for q, dq, ddq in zip(*states, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = 0.0, 0.0, 0.0
        for name, position in dict(locked).items():
            data.qpos[model.joint(name).qposadr[0]] = position
        data.qpos[[int(model.joint(name).qposadr[0]) for name in names]] = q
        data.qvel[places], data.qacc[places] = dq, ddq
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse[places] - model.dof_armature[places] * ddq)
    return np.array(torques)


def _assert_same_torque(robot, path, locked=()):
    states = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 20, len(robot)))
    expected = _inverse(path, robot.joint_names, states, locked)
    torque = TorqueModel(robot).predict(robot.nominal, *states)
    assert np.allclose(torque, expected, rtol=0, atol=1e-8)


def test_the_loaded_robots_torque_is_mujocos(written):
    robot = load_mjcf(written())
    assert robot.joint_names == ("turn", "slide", "roll", "lift", "pitch")
    assert robot.name == "robot"
    _assert_same_torque(robot, written())


def test_armature_is_left_to_the_drive_terms(written):
    path = written(('axis="0.6 0 0.8"', 'axis="0.6 0 0.8" armature="0.7"'))
    _assert_same_torque(load_mjcf(path), path)


def test_radians_local_frames_and_inferred_inertia_are_mujocos(written):
    changes = [('angle="degree"', 'angle="radian" inertiafromgeom="true"')]
    changes.append(
        (
            'fullinertia="0.02 0.03 0.025 0.001 0.002 0.003"/>',
            'diaginertia="1 1 1"/>'
            '<geom size="0.1 0.2 0.3" type="box" euler="0.1 0.2 0.3"/>',
        )
    )
    changes += [('range="-120 90" ref="25"', 'range="-2 1" ref="0.3"')]
    path = written(*changes)
    robot = load_mjcf(path)
    assert robot.joints[0].limits.lower == -2.0
    _assert_same_torque(robot, path)


def test_limits_are_the_files_in_radians(written):
    limits = {joint.name: joint.limits for joint in load_mjcf(written()).joints}
    turn, slide = limits["turn"], limits["slide"]
    assert (turn.lower, turn.upper) == pytest.approx((-2 * np.pi / 3, np.pi / 2))
    assert (turn.velocity, turn.effort) == (np.inf, 100.0)  # both ways, of -2 to 3
    assert (slide.lower, slide.upper, slide.effort) == (0.0, 0.4, 20.0)
    assert (limits["roll"].lower, limits["roll"].effort) == (-np.inf, np.inf)
    kinds = {joint.name: joint.kind for joint in load_mjcf(written()).joints}
    assert kinds["turn"] == "revolute"
    assert kinds["slide"] == "prismatic"
    assert kinds["roll"] == "continuous"


def test_fixed_bodies_are_merged_and_found(written):
    robot = load_mjcf(written())
    assert robot.link_names == ("upper", "slider", "wrist/roll", "wrist/lift", "wrist")
    assert robot.carrier("plate") == 0
    assert robot.carrier("tool") == 1
    assert robot.carrier("stand") == robot.carrier("world") == -1
    masses = [link.nominal.mass for link in robot.links]
    assert masses[2:4] == [0.0, 0.0]
    model = mujoco.MjModel.from_xml_path(str(written()))
    moving = model.body("upper").subtreemass[0]
    assert sum(masses) == pytest.approx(moving)


def test_gravity_is_the_files_unless_it_is_given(written):
    assert np.allclose(load_mjcf(written()).gravity, [0.5, -0.3, -9.7])
    assert np.allclose(load_mjcf(written(), gravity=[0, 0, -1]).gravity, [0, 0, -1])


def test_joints_are_locked_at_mujocos_positions(written):
    locked = {"slide": 0.3, "lift": -0.2, "roll": 0.7}
    robot = load_mjcf(written(), locked=locked)
    assert robot.joint_names == ("turn", "pitch")
    _assert_same_torque(robot, written(), locked)


def test_the_chain_from_a_base_to_a_tip_can_be_loaded_alone(written):
    assert load_mjcf(written(), tip="tool").joint_names == ("turn", "slide")
    part = load_mjcf(written(), base="plate", tip="wrist")
    assert part.joint_names == ("roll", "lift", "pitch")
    _assert_same_torque(part, written())
    with pytest.raises(ModelError, match=r"no body named 'tol'; known: .*tool"):
        load_mjcf(written(), tip="tol")


def test_a_free_body_beside_the_robot_is_no_part_of_it(written):
    ball = '<body name="ball" pos="1 1 1"><freejoint/><geom size="0.1"/></body>'
    path = written(('<body name="stand"', ball + '<body name="stand"'))
    with pytest.raises(ModelError, match="body 'ball' hangs on a free joint"):
        load_mjcf(path)
    kept = ["turn", "slide", "roll", "lift", "pitch"]
    assert load_mjcf(path, joints=kept).joint_names == tuple(kept)
    assert len(load_mjcf(path, tip="wrist")) == 4


def test_a_floating_robot_stands_still_from_its_base(written):
    change = ('<geom size="0.1" mass="5"/>', '<freejoint/><geom size="0.1" mass="5"/>')
    path = written(change)
    with pytest.raises(ModelError, match=r"--base stand .*--base floating if it moves"):
        load_mjcf(path)
    rigid, robot = load_mjcf(written()), load_mjcf(path, base="stand")
    assert np.allclose(robot.nominal, rigid.nominal)
    states = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 5, 5))
    torques = [TorqueModel(r).predict(r.nominal, *states) for r in (rigid, robot)]
    assert np.allclose(*torques, rtol=0, atol=1e-12)


FIXED_TENDON = """<tendon><fixed name="rope" {0}>
  <joint joint="roll" coef="1"/><joint joint="pitch" coef="2"/></fixed></tendon>"""
SPATIAL = """<tendon><spatial name="cord" {0}>
  <site site="a"/><site site="b"/></spatial></tendon>"""


def _with(section):
    return ("</mujoco>", section + "</mujoco>")


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            '<equality><joint name="bend" joint1="roll" joint2="pitch" '
            'polycoef="0 1 2"/></equality>',
            "'bend': joint 'roll' follows a polynomial",
        ),
        (
            '<equality><joint joint1="roll" joint2="pitch"/>'
            '<joint joint1="pitch" joint2="roll"/></equality>',
            "'roll' follows one that follows it",
        ),
        (
            '<equality><joint joint1="roll"/><joint joint1="roll"/></equality>',
            "two equality constraints bind joint 'roll'",
        ),
        (
            '<equality><connect body1="tool" body2="wrist" anchor="0 0 0"/></equality>',
            "ties bodies 'tool' and 'wrist'; closed loops",
        ),
        ('<equality><weld body1="tool"/></equality>', "'tool' and 'world'"),
        (FIXED_TENDON.format('stiffness="3"'), "'rope' pulls at joint 'roll'"),
        (
            FIXED_TENDON.format("") + '<equality><tendon tendon1="rope"/></equality>',
            "binds joint 'roll' by a tendon",
        ),
    ],
)
def test_joints_that_do_not_move_by_themselves_are_refused(written, section, message):
    with pytest.raises(ModelError, match=message):
        load_mjcf(written(_with(section)))


@pytest.mark.parametrize(
    "section",
    [
        FIXED_TENDON.format(""),
        '<equality><connect body1="tool" body2="slider" anchor="0 0 0"/></equality>',
        '<equality><joint joint1="roll" active="false"/></equality>',
    ],
)
def test_what_has_no_force_is_let_through(written, section):
    path = written(_with(section))
    _assert_same_torque(load_mjcf(path), path)


def test_an_equality_makes_a_joint_follow_another(written):
    rule = '<joint joint1="lift" joint2="pitch" polycoef="0.1 -0.3"/>'
    path = written(_with(f"<equality>{rule}</equality>"))
    robot = load_mjcf(path)
    assert robot.joint_names == ("turn", "slide", "roll", "pitch")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    names = [model.joint(j).name for j in range(model.njnt)]
    place = [names.index(name) for name in robot.joint_names]
    lift, pitch = names.index("lift"), names.index("pitch")
    G = np.zeros((5, 4))
    G[place, range(4)] = 1.0
    G[lift] = -0.3 * G[pitch]
    states = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 4, 4))
    torques = TorqueModel(robot).predict(robot.nominal, *states)
    for torque, q, dq, ddq in zip(torques, *states, strict=True):
        data.qpos, data.qvel, data.qacc = G @ q, G @ dq, G @ ddq
        # MuJoCo counts from ``ref``, which is -40 degrees for pitch.
        data.qpos[lift] = 0.1 - 0.3 * (data.qpos[pitch] + np.radians(40.0))
        mujoco.mj_inverse(model, data)
        assert np.allclose(torque, G.T @ data.qfrc_inverse, rtol=0, atol=1e-9)


def test_an_equality_of_one_joint_locks_it(written):
    section = '<equality><joint joint1="slide" polycoef="0.2"/></equality>'
    bound = load_mjcf(written(_with(section)))
    locked = load_mjcf(written(), locked={"slide": 0.1 + 0.2})
    assert bound.joint_names == locked.joint_names
    assert np.allclose(bound.nominal, locked.nominal, rtol=0, atol=1e-12)


def test_coupled_joints_may_be_locked(written):
    section = '<equality><joint joint1="roll" joint2="pitch"/></equality>'
    path = written(_with(section))
    robot = load_mjcf(path, joints=["turn", "slide"])
    assert robot.joint_names == ("turn", "slide")
    whole = load_mjcf(path, locked={"roll": 0.0})
    assert whole.joint_names == ("turn", "slide", "lift", "pitch")
    with pytest.raises(ModelError, match="'turn' is both kept and locked"):
        load_mjcf(written(), joints=["turn"], locked={"turn": 0.0})


def test_a_spatial_tendon_binds_what_moves_between_its_ends(written):
    sites = [('<body name="plate"', '<site name="a"/><body name="plate"')]
    sites += [('<body name="tool"', '<site name="b"/><body name="tool"')]
    sites.append(_with(SPATIAL.format('damping="1"')))
    with pytest.raises(ModelError, match="'cord' pulls at joint 'slide'"):
        load_mjcf(written(*sites))
    assert len(load_mjcf(written(*sites), locked={"slide": 0.0})) == 4


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('mass="2"', 'mass="heavy"', "MuJoCo refuses it"),
        ('mass="2"', 'mass="-2"', "body 'upper' has mass -2 kg"),
        ("defaults.xml", "nowhere.xml", "MuJoCo refuses it: .*nowhere"),
        (
            'name="turn" axis="0.6 0 0.8" pos="0.05 0 0.1" range="-120 90" ref="25"',
            'name="turn" type="ball"',
            "a ball joint",
        ),
        ("</worldbody>", "", "MuJoCo refuses it"),
    ],
)
def test_faults_are_refused_with_the_files_name(written, old, new, message):
    with pytest.raises(ModelError, match=r"robot\.xml: (.|\n)*" + message):
        load_mjcf(written((old, new)))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.xml: cannot be read"):
        load_mjcf(tmp_path / "nowhere.xml")


def test_without_mujoco_the_message_says_how_to_install_it(written, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModelError, match=r"pip install 'consistent-id\[mjcf\]'"):
        load_mjcf(written())


def test_a_problem_file_may_name_an_mjcf_file(written):
    file = written().parent / "problem.toml"
    content = '[model]\nmjcf = "robot.xml"\nbase = "plate"\ntip = "wrist"\n'
    file.write_text('name = "x"\n' + content + '[constraints]\nmasses = "free"\n')
    robot = load_problem(file).model.robot
    assert robot.joint_names == ("roll", "lift", "pitch")
    assert np.allclose(robot.gravity, [0.5, -0.3, -9.7])


MESHED = """
<mujoco>
  <compiler meshdir="shapes"/>
  <asset>
    <mesh file="arm.stl"/>
    <texture name="skin" type="2d" file="skin.png"/>
    <material name="paint" texture="skin"/>
  </asset>
  <worldbody><geom type="mesh" mesh="arm"/><body name="arm">
    <joint name="lift" axis="0 1 0"/>
    <inertial pos="0.2 0 0" mass="3" diaginertia="0.01 0.1 0.1"/>
    <geom type="mesh" mesh="arm" material="paint"/>
  </body></worldbody>
</mujoco>
"""


def test_meshes_that_are_only_looked_at_may_be_missing(written):
    (link,) = load_mjcf(written(text=MESHED)).links
    assert np.allclose(link.nominal.com, [0.2, 0, 0])
    assert np.allclose(link.nominal.central_inertia, np.diag([0.01, 0.1, 0.1]))


@pytest.mark.parametrize(
    "change",
    [
        ('<inertial pos="0.2 0 0" mass="3" diaginertia="0.01 0.1 0.1"/>', ""),
        ('meshdir="shapes"', 'meshdir="shapes" inertiafromgeom="true"'),
    ],
)
def test_a_missing_mesh_that_weighs_is_named(written, change):
    message = r"mesh file 'arm\.stl' is missing, and the inertia of body 'arm'"
    with pytest.raises(ModelError, match=message):
        load_mjcf(written(change, text=MESHED))


@pytest.mark.parametrize(
    ("file", "masses"),
    [
        ("unitree_go2/go2.xml", {"FL_calf": 0.241352}),
        ("unitree_z1/z1.xml", {"link02": 1.19132}),
    ],
)
def test_published_files_load_without_their_meshes(file, masses):
    folder = os.environ.get("CONSISTENT_ID_DATASETS")
    if folder is None:
        pytest.skip("CONSISTENT_ID_DATASETS is not set")
    base = {"base": "base"} if "go2" in file else {}
    robot = load_mjcf(Path(folder) / file, **base)
    found = {link.name: link.nominal.mass for link in robot.links}
    assert len(robot) >= 6
    for name, mass in masses.items():
        assert found[name] >= mass


@pytest.mark.parametrize(("flag", "down"), [("enable", -3.7), ("disable", 0.0)])
def test_gravity_that_is_disabled_is_none(tmp_path, flag, down):
    """The torque of MuJoCo's own inverse dynamics at rest is that of the model."""
    file = tmp_path / "arm.xml"
    file.write_text(f"""<mujoco><option gravity="0 0 -3.7"><flag gravity="{flag}"/>
      </option><worldbody><body name="arm"><joint name="j" axis="0 1 0"/>
      <geom type="sphere" size="0.05" pos="0.4 0 0" mass="2"/></body></worldbody>
      </mujoco>""")
    robot = load_mjcf(file)
    assert robot.gravity.tolist() == [0.0, 0.0, down]
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_inverse(model, data)
    assert data.qfrc_inverse[0] == pytest.approx(2 * 0.4 * down, abs=1e-9)


@pytest.mark.parametrize("name", ["robot.mjcf", "robot.txt", "robot"])
def test_a_file_of_any_ending_is_read_with_the_meshes_beside_it(name, tmp_path):
    """MuJoCo itself has no decoder for endings other than ``.xml``."""
    corners = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
    (tmp_path / "tip.obj").write_text(
        "".join(f"v {corner}\n" for corner in corners.split("  "))
        + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    text = (
        '<mujoco><asset><mesh name="tip" file="tip.obj"/></asset><worldbody>'
        '<body name="boom"><joint name="lift"/><geom type="mesh" mesh="tip" '
        'mass="2"/></body></worldbody></mujoco>'
    )
    (tmp_path / "robot.xml").write_text(text)
    (tmp_path / name).write_text(text)
    found, same = (load_mjcf(tmp_path / one) for one in (name, "robot.xml"))
    assert found.joint_names == ("lift",)
    assert np.allclose(found.nominal, same.nominal, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("name", ["robot.mjcf", "robot.txt"])
def test_a_file_of_any_ending_has_what_it_includes(written, name):
    same = load_mjcf(written())
    path = written().rename(written().parent / name)
    path.write_text("\ufeff" + path.read_text(), encoding="utf-8")  # as Windows does
    found = load_mjcf(path)
    assert np.allclose(found.nominal, same.nominal, rtol=1e-12, atol=0.0)
