"""Every fault of a URDF is named with its line; an odd nominal body stops nobody."""

import logging
import re

import numpy as np
import pinocchio as pin
import pytest
from robots import URDF, random_states

from consistent_id import ModelError, TorqueModel
from consistent_id.robot import lint_urdf, load_urdf
from consistent_id.robot.inertia import pseudo_inertia
from consistent_id.robot.scaling import reference_bodies


def _written(tmp_path, *changes):
    text = URDF
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return path


def test_a_clean_file_has_no_findings(tmp_path):
    assert lint_urdf(_written(tmp_path)) == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '<robot name="test">',
            '<!DOCTYPE r [<!ENTITY a "b">]><robot name="t">',
            "document type",
        ),
        ('value="2.0"', 'value="nan"', "line 13: link 'one': .*finite"),
        ('value="2.0"', 'value="-1"', "line 13: link 'one': mass is -1 kg"),
        ('value="2.0"', 'value="heavy"', "line 13: .*'heavy'"),
        ('xyz="0.2 0 0"', 'xyz="0.2 0"', "joint 'slide': .*3 finite numbers"),
        ('ixx="0.02" ', "", "link 'one': <inertia> lacks ixx"),
        ('<link name="two">', '<link name="one">', "already stands on line 10"),
        (
            '<axis xyz="0.6 0 0.8"/>',
            '<axis xyz="0 0 0"/>',
            "line 7: joint 'turn': axis",
        ),
        ('type="continuous"', 'type="floating"', "type is 'floating', expected one of"),
        ('<axis xyz="0 1 0"/>', '<mimic joint="trun"/>', "'trun', but there is none"),
        ('<axis xyz="0 1 0"/>', '<mimic joint="spin"/>', "spin follows spin"),
        (
            '<axis xyz="0 1 0"/>',
            '<mimic joint="turn" multiplier="x"/>',
            "multiplier='x'",
        ),
        ('<parent link="base"/>', "", "<parent link=...> is missing"),
        ("</robot>", "", "not well-formed"),
        ('<link name="base"/>', "<link/>", "line 3: <link> has no name"),
        (
            '<child link="one"/>',
            '<child link="ghost"/>',
            "line 4: .*no child link named 'ghost'",
        ),
        ('value="2.0"', 'value="2,0"', "'2,0'.*such as 0.5"),
        ('value="2.0"', 'value="1_000"', "'1_000'"),
        ('value="2.0"', 'value="${mass}"', "line 13: <mass .*run xacro"),
        ('value="2.0"', 'value="1e999"', "'1e999'"),
        ('ixy="0.001" ', "", "lacks ixy; .* read as massless"),
        ('lower="-2" upper="1.5"', 'lower="2" upper="1.5"', "line 8: .*reversed"),
        ('velocity="3"', 'velocity="-3"', "line 8: .* limit velocity is -3 < 0"),
        ('effort="50"', 'effort="-5"', "line 8: .* limit effort is -5 < 0"),
        ('<child link="two"/>', '<child link="one"/>', "already hangs on joint 'turn'"),
        ('<parent link="base"/>', '<parent link="two"/>', "carry one another: one < "),
        ('<link name="base"/>', '<link name="base"/><link name="x"/>', "has one root"),
        ('type="fixed"', 'type="weld"', "type is 'weld', expected one of revolute"),
        ('type="revolute"', 'type="planar"', "choose a base beyond it"),
        ('<joint name="slide"', '<joint name="turn"', "line 16: .* on line 4"),
        ('<link name="base"/>', "<xacro:arm/>", "<xacro:arm> has not been expanded"),
    ],
)
def test_every_fault_is_named_with_its_line(tmp_path, old, new, message):
    path = _written(tmp_path, (old, new))
    errors = [str(f) for f in lint_urdf(path) if f.severity == "error"]
    assert any(re.search(message, error) for error in errors), errors
    with pytest.raises(ModelError, match=re.escape(errors[0])) as caught:
        load_urdf(path)
    assert "robot.urdf, line" in str(caught.value)


ODD = [
    ('ixx="0.02"', 'ixx="0.09"', "line 14: link 'one': .* more than the sum"),
    ('ixx="0.02"', 'ixx="-0.02"', "line 14: link 'one': .* one of them negative"),
    ('value="2.0"', 'value="0"', "line 14: link 'one': mass is zero, but"),
    ('xyz="0.6 0 0.8"', 'xyz="3 0 4"', "line 7: .* length 5; .* normalised"),
    ('upper="0.4"', 'upper="0"', "line 20: .*'slide': .* both 0"),
]


@pytest.mark.parametrize(("old", "new", "message"), ODD)
def test_an_oddity_is_said_and_the_robot_loads_as_pinocchios(
    tmp_path, caplog, old, new, message
):
    path = _written(tmp_path, (old, new))
    (finding,) = lint_urdf(path)
    assert finding.severity == "warning"
    assert re.search(message, str(finding))
    with caplog.at_level(logging.WARNING):
        robot = load_urdf(path)
    assert str(finding) in caplog.text
    model = pin.buildModelFromUrdf(str(path))
    q, dq, ddq = random_states(np.random.default_rng(0), 3, 1)
    configuration = [*q[0, :2], np.cos(q[0, 2]), np.sin(q[0, 2])]
    data = model.createData()
    torque = pin.rnea(model, data, np.array(configuration), dq[0], ddq[0])
    # 1.57079632679 is taken for a right angle: off by 5e-12.
    mine = TorqueModel(robot).predict(robot.nominal, q, dq, ddq)[0]
    assert np.allclose(mine, torque, rtol=0, atol=1e-10 * abs(torque).max())


@pytest.mark.parametrize(("old", "new", "message"), ODD[:3])
def test_priors_take_a_body_where_the_nominal_one_is_none(tmp_path, old, new, message):
    robot = load_urdf(_written(tmp_path, (old, new)))
    bodies = reference_bodies(robot)
    assert np.linalg.eigvalsh(pseudo_inertia(bodies)).min() > 0.0


def test_what_other_programmes_read_is_left_to_them(tmp_path):
    foreign = """
      <gazebo reference="one"><mass value="nan"/><x a="${b}"/></gazebo>
      <ros2_control name="c" type="system"><joint name="turn"/></ros2_control>
      <transmission name="t"><joint name="turn"/><limit effort="none"/></transmission>
      <link name="one"><visual><origin xyz="a b c"/></visual>"""
    path = _written(tmp_path, ('<link name="one">', foreign))
    assert lint_urdf(path) == ()
    assert len(load_urdf(path)) == 3


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<axis xyz="0 1 0"/>', '<mimic joint="trun"/>'),
        ('name="spin" type="continuous"', 'name="spin" type="floating"'),
        ('name="spin" type="continuous"', 'name="spin" type="planar"'),
    ],
)
def test_joints_beside_the_chain_may_be_of_any_kind(tmp_path, old, new):
    path = _written(tmp_path, (old, new))
    with pytest.raises(ModelError, match="'spin'"):
        load_urdf(path)
    assert load_urdf(path, tip="tool").joint_names == ("turn", "slide")
    whole = load_urdf(path, joints=["turn", "slide"])
    assert whole.links[1].datasheet.mass == pytest.approx(1.0 + 0.5 + 0.7)


def test_all_findings_are_listed_in_the_order_of_lines(tmp_path):
    changes = [('value="2.0"', 'value="nan"'), ('xyz="0 1 0"', 'xyz="0 0 0"')]
    lines = [finding.line for finding in lint_urdf(_written(tmp_path, *changes))]
    assert len(lines) == 2
    assert lines == sorted(lines)


def test_text_that_is_no_xml_is_one_finding(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text("<robot>\n<link>\n</robot>")
    (finding,) = lint_urdf(path)
    assert (finding.line, finding.severity) == (3, "error")
    with pytest.raises(ModelError, match=r"robot\.urdf, line 3: not well-formed"):
        load_urdf(path)


def test_a_declared_encoding_is_read(tmp_path):
    text = URDF.replace('version="1.0"', 'version="1.0" encoding="ISO-8859-1"')
    path = tmp_path / "robot.urdf"
    path.write_bytes(text.replace('"one"', '"\xe9"').encode("latin-1"))
    assert lint_urdf(path) == ()
    assert load_urdf(path).link_names[0] == "\xe9"


def test_text_of_two_bytes_per_letter_is_refused(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_bytes(URDF.encode("utf-16"))
    assert lint_urdf(path) == ()
    with pytest.raises(ModelError, match="save the file as UTF-8"):
        load_urdf(path)
