"""URDF: Pinocchio reads what was written, and nothing else has changed."""

import json
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from estimates import FRICTION, estimate_of, random_estimate, rigid
from robots import URDF, random_body, random_robot
from urdf_torques import DECORATED, assert_same_torque, pinocchio_torques, states_of

from consistent_id import (
    DriveTerms,
    InertialParameters,
    ModelError,
    ProblemError,
    TorqueModel,
    to_urdf,
)
from consistent_id.export.urdf_export import rpy_of
from consistent_id.regression.mass_matrix import random_poses
from consistent_id.robot import FixedFrame, JointLimits, load_urdf

_CHANGING = re.compile(
    rb"\b(xyz|rpy|value|i[xyz]{2}|damping|friction)(\s*=\s*)([\"'])[^\"']*[\"']"
)


@pytest.fixture
def written(tmp_path):
    """Write bytes, and return the path."""

    def write(text, encoding="utf-8"):
        path = tmp_path / "robot.urdf"
        path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        return path

    return write


def test_pinocchio_finds_the_identified_torque_in_the_file(written):
    path = written(URDF)
    robot = load_urdf(path)
    estimate = random_estimate(np.random.default_rng(1), robot, FRICTION)
    export = to_urdf(estimate, path)
    assert_same_torque(export.content, estimate)
    model = pin.buildModelFromXML(str(export))
    for i, name in enumerate(robot.joint_names):
        assert model.damping[i] == estimate[f"{name}.viscous"]
        assert model.upperDryFrictionLimit[i] == estimate[f"{name}.coulomb"]


def test_a_fixed_link_keeps_its_body_if_the_rest_is_one(written):
    path = written(URDF)
    robot = load_urdf(path)
    more = random_body(np.random.default_rng(2))
    bodies = [link.nominal + more for link in robot.links]
    estimate = estimate_of(TorqueModel(robot), bodies)
    export = to_urdf(estimate, path)
    assert_same_torque(export.content, estimate)
    tool = re.search(rb'<link name="tool">.*?</link>', URDF.encode(), re.DOTALL)
    assert tool[0] in export.content
    assert "two is the remainder without tool" in export.notes[0]


def test_otherwise_all_get_shares_of_the_whole_and_are_bodies(written):
    path = written(URDF)
    robot = load_urdf(path)
    ball = InertialParameters.from_central(0.1, [0, 0, 0], 1e-4 * np.eye(3))
    estimate = estimate_of(TorqueModel(robot), [ball] * 3)
    export = to_urdf(estimate, path)
    assert_same_torque(export.content, estimate)
    assert "in proportion to the masses" in export.notes[0]
    written(export.content)
    model = pin.buildModelFromXML(str(export))
    # The file has 1 kg on the link and 0.5 kg on the tool.
    assert model.inertias[model.getJointId("slide")].mass == pytest.approx(0.1)
    masses = re.findall(rb'mass value="([^"]*)"', export.content)
    assert [float(m) for m in masses] == pytest.approx([0.1, 0.2 / 3, 0.1 / 3, 0.1])


def test_locked_joints_count_where_they_are_locked(written):
    path = written(URDF)
    locked = {"slide": 0.3}
    robot = load_urdf(path, locked=locked)
    estimate = random_estimate(np.random.default_rng(3), robot)
    assert_same_torque(to_urdf(estimate, path).content, estimate, locked)


@pytest.mark.parametrize(
    ("encoding", "declared", "mark"),
    [
        ("utf-8", "utf-8", b""),
        ("utf-8", "utf-8", b"\xef\xbb\xbf"),
        ("latin-1", "ISO-8859-1", b""),
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_numbers_change(written, encoding, declared, mark, newline):
    text = DECORATED.replace("{0}", declared).replace("\n", newline)
    # What is inserted is tested on its own.
    for joint in ("slide", "spin"):
        start = f'<joint name="{joint}"'
        place = text.index("<axis", text.index(start))
        text = text[:place] + '<dynamics friction="0" damping="0"/>' + text[place:]
    before = mark + text.encode(encoding)
    path = written(before)
    estimate = random_estimate(np.random.default_rng(4), load_urdf(path), FRICTION)
    after = to_urdf(estimate, path, comment=False).content
    assert after != before
    assert _CHANGING.sub(rb"\1\2\3", after) == _CHANGING.sub(rb"\1\2\3", before)
    assert b"<![CDATA[<mass value='9'/>]]>" in after
    assert_same_torque(after, estimate)


def test_numbers_that_stay_keep_their_digits(written):
    path = written(URDF)
    robot = load_urdf(path)
    nominal = [link.nominal for link in robot.links]
    estimate = estimate_of(TorqueModel(robot), nominal)
    assert to_urdf(estimate, path, comment=False).content == URDF.encode()


def test_what_is_missing_is_inserted_as_the_file_is_indented(written):
    text = """<robot name="r">
    <link name="base"/>
    <link name="arm"/>
    <link name="bare">
    </link>
    <joint name="a" type="continuous"><parent link="base"/><child link="arm"/></joint>
    <joint name="b" type="continuous">
        <parent link="arm"/>
        <child link="bare"/>
    </joint>
</robot>
"""
    path = written(text)
    ball = InertialParameters.from_central(2.0, [0, 0, 0.5], np.eye(3))
    model = TorqueModel(load_urdf(path), FRICTION)
    estimate = estimate_of(model, [ball, ball], 3.0)
    with pytest.raises(ProblemError, match="must have velocity and effort"):
        to_urdf(estimate, path, limits={"b": JointLimits(effort=7.0)})
    limits = {"b": JointLimits(effort=7.0, velocity=2.5)}
    after = str(to_urdf(estimate, path, limits=limits))
    inertial = """<inertial>
{0}  <origin xyz="0 0 0.5" rpy="0 0 0"/>
{0}  <mass value="2"/>
{0}  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
{0}</inertial>""".format(" " * 6)
    limit = '<limit velocity="2.5" effort="7"/>'
    dynamics = '<dynamics damping="3" friction="3"/>'
    expected = (
        text.replace('"r">', '"r">\n    <!-- COMMENT -->')
        .replace(
            '<link name="arm"/>', f'<link name="arm">\n      {inertial}\n    </link>'
        )
        .replace('<link name="bare">', f'<link name="bare">\n      {inertial}')
        .replace('type="continuous"><parent', f'type="continuous">{dynamics}<parent')
        .replace(
            'type="continuous">\n',
            f'type="continuous">\n        {dynamics}\n        {limit}\n',
        )
    )
    assert (
        re.sub("consistent-id: .*verdict: use with care", "COMMENT", after) == expected
    )
    assert_same_torque(after.encode(), estimate)


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_without_a_file_gets_one(seed, written):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 5, tree=True)
    frame = FixedFrame("tool & co", pin.SE3.Random().rotation, rng.normal(size=3))
    links = (*robot.links[:-1], replace(robot.links[-1], merged=(frame,)))
    directions = ([0, 0, -9.81], [0, 0, 9.8], [1, -2, 3], [0, 0, 0])
    robot = replace(robot, links=links, gravity=np.array(directions[seed]))
    estimate = random_estimate(rng, robot, FRICTION)
    export = to_urdf(estimate)
    path = written(export.content)
    gravity = float(np.linalg.norm(robot.gravity))
    again = load_urdf(path, gravity=[0, 0, -gravity])
    assert again.link_names[again.carrier("tool & co")] == robot.link_names[-1]
    order = [robot.joint_names.index(name) for name in again.joint_names]
    states = states_of(robot)
    found = pinocchio_torques(
        export.content, again, states[:, :, order], gravity=gravity
    )
    expected = rigid(estimate, states)[:, order]
    assert np.allclose(found, expected, rtol=0, atol=1e-10 * abs(expected).max())
    assert ("URDF has no gravity" in "".join(export.notes)) == (seed > 0)


@pytest.mark.parametrize("pitch", [0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9])
def test_roll_pitch_and_yaw_are_found_upright_too(pitch):
    rotation = pin.rpy.rpyToMatrix(0.4, pitch, -1.2)
    again = pin.rpy.rpyToMatrix(*rpy_of(rotation))
    assert np.allclose(again, rotation, rtol=0, atol=1e-15)


@pytest.mark.slow
def test_exporting_again_changes_nothing(written):
    path = written(DECORATED.replace("{0}", "utf-8"))
    estimate = random_estimate(np.random.default_rng(5), load_urdf(path), FRICTION)
    once = to_urdf(estimate, path).content
    assert b"verdict: use with care -->" in once
    assert to_urdf(estimate, written(once)).content == once


def test_what_urdf_cannot_say_is_said(written):
    from consistent_id import DriveTerms

    path = written(URDF)
    terms = DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.1, rotor_inertia=True
    )
    estimate = random_estimate(np.random.default_rng(6), load_urdf(path), terms)
    notes = "\n".join(to_urdf(estimate, path).notes)
    assert "URDF has no rotor_inertia: turn" in notes
    assert "the identified form is tanh(velocity / scale), scale: turn 0.1" in notes


def test_a_joint_without_drive_terms_keeps_its_friction(written):
    path = written(DECORATED.replace("{0}", "utf-8"))
    robot = load_urdf(path)
    rng = np.random.default_rng(7)
    assert (
        b'friction="7" damping="0.1"'
        in to_urdf(random_estimate(rng, robot), path).content
    )
    from consistent_id import DriveTerms

    only = to_urdf(random_estimate(rng, robot, DriveTerms(viscous=True)), path)
    assert b'<dynamics friction="0"' in only.content


def test_links_that_the_model_leaves_out_are_named(written):
    path = written(URDF)
    robot = load_urdf(path, tip="two")
    estimate = random_estimate(np.random.default_rng(8), robot)
    assert "left as they were: three" in to_urdf(estimate, path).notes[-1]


@pytest.mark.slow
def test_estimates_that_no_robot_has_are_refused(written):
    path = written(URDF)
    robot = load_urdf(path)
    nominal = [link.nominal for link in robot.links]
    impossible = InertialParameters(-nominal[1].vector)
    bodies = [nominal[0], impossible, nominal[2]]
    estimate = estimate_of(TorqueModel(robot), bodies)
    with pytest.raises(ProblemError, match="not physically consistent: two"):
        to_urdf(estimate, path)
    export = to_urdf(estimate, path, allow_refused=True)
    assert "verdict: do not use" in str(export)
    assert b'<mass value="-2"/>' in export.content
    kinds = tuple(ground.kind for ground in estimate.verdict.grounds)
    accepted = to_urdf(replace(estimate, accepted=kinds), path)
    assert f"accepted: {', '.join(kinds)}" in str(accepted)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('link name="three"', 'link name="four"', "no child link named 'three'"),
        ('name="turn"', 'name="twist"', "no joint named 'turn'; known: twist"),
        ('<child link="two"/>', '<child link="three"/>', "hangs on no joint"),
        ('value="1.0"', 'value="nan"', "expected 1 finite number"),
        ("</robot>", "", "not well-formed"),
    ],
)
def test_another_robots_file_is_refused(written, old, new, message):
    estimate = random_estimate(np.random.default_rng(9), load_urdf(written(URDF)))
    assert old in URDF
    with pytest.raises(ModelError, match=r"robot\.urdf.*" + message):
        to_urdf(estimate, written(URDF.replace(old, new)))


def test_links_exchanged_between_joints_are_noticed(written):
    estimate = random_estimate(np.random.default_rng(9), load_urdf(written(URDF)))
    text = (
        URDF.replace('"one"', '"x"')
        .replace('"three"', '"one"')
        .replace('"x"', '"three"')
    )
    with pytest.raises(ModelError, match="does not carry link 'one'"):
        to_urdf(estimate, written(text))


def test_mass_matrices_of_the_exported_robot_are_positive(written):
    path = written(URDF)
    robot = load_urdf(path)
    estimate = random_estimate(np.random.default_rng(10), robot)
    model = pin.buildModelFromXML(str(to_urdf(estimate, path)))
    for pose in random_poses(estimate.model, 5, seed=0):
        q = np.concatenate([pose[:2], [np.cos(pose[2]), np.sin(pose[2])]])
        assert np.linalg.eigvalsh(pin.crba(model, model.createData(), q))[0] > 0.0


@pytest.mark.slow
def test_rotor_inertia_and_offsets_are_in_a_file_beside(written, tmp_path):
    path = written(URDF)
    terms = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True, offset=True)
    estimate = random_estimate(np.random.default_rng(1), load_urdf(path), terms)
    target = tmp_path / "new" / "arm.urdf"
    for source in (path, None):
        export = to_urdf(estimate, source)
        export.save(target)
        (note,) = [
            line for line in str(export).splitlines() if "consistent-id:" in line
        ]
        assert ".drives.json" in note
        drives = json.loads((tmp_path / "new" / "arm.drives.json").read_text())[
            "drives"
        ]
        for name in estimate.model.robot.joint_names:
            for term in ("rotor_inertia", "offset"):
                stated = drives[name]["terms"][term]["value"]
                assert stated == estimate[f"{name}.{term}"]


def test_what_urdf_says_whole_has_no_file_beside(written, tmp_path):
    path = written(URDF)
    estimate = random_estimate(np.random.default_rng(1), load_urdf(path), FRICTION)
    export = to_urdf(estimate, path)
    assert ".drives.json" not in str(export)
    export.save(tmp_path / "new" / "arm.urdf")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["arm.urdf"]
