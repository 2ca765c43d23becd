"""The lint names what is wrong with a robot description, and only that."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from schemas import parsed

from consistent_id.cli import main
from consistent_id.repair import lint_robot

LINK = """
<link name="{name}"><inertial>
  <origin xyz="0 0 {half}"/><mass value="{mass}"/>
  <inertia ixx="{wide}" ixy="0" ixz="0" iyy="{wide}" iyz="0" izz="{thin}"/>
</inertial>
<visual><origin xyz="0 0 {half}"/><geometry>
  <box size="0.1 0.1 {length}"/></geometry></visual></link>"""
JOINT = """
<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="0 0 {at}"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" velocity="1" effort="{effort}"/></joint>"""


def _beam(name, mass=3.0, length=0.4, factor=1.0):
    """A homogeneous beam along z."""
    wide = factor * mass * (0.1**2 + length**2) / 12
    thin = factor * mass * 2 * 0.1**2 / 12
    return LINK.format(
        name=name, mass=mass, length=length, half=length / 2, wide=wide, thin=thin
    )


@pytest.fixture
def linted(tmp_path):
    """Lint a two-link arm whose parts are given, and return rules and findings."""

    def lint(upper=None, lower=None, effort=100.0, more=""):
        path = tmp_path / "arm.urdf"
        path.write_text(
            '<robot name="arm"><link name="base"/>'
            + (upper or _beam("upper"))
            + (lower or _beam("lower", mass=2.0))
            + JOINT.format(
                name="a", parent="base", child="upper", at=0.3, effort=effort
            )
            + JOINT.format(name="b", parent="upper", child="lower", at=0.4, effort=50)
            + more
            + "</robot>"
        )
        return lint_robot(path)

    return lint


def _rules(findings):
    return {finding.rule for finding in findings}


def test_a_good_robot_has_no_findings(linted):
    assert linted() == ()


def test_mass_outside_the_shapes_is_found(linted):
    (found,) = [f for f in linted(_beam("upper", factor=20)) if "radius" in f.rule]
    # sqrt(20 (wide + wide + thin) / 2 m), by hand; the corner is 0.212 m away.
    assert "radius of gyration is 0.548 m, but its shapes reach 0.212 m" in str(found)
    assert "line 2" in str(found)


@pytest.mark.parametrize(("centre", "found"), [("200", True), ("0.7", False)])
def test_a_centre_of_mass_in_millimetres_is_far_outside_of_the_shapes(
    linted, centre, found
):
    """A beam from z = 0 to 0.4 m; some bodies have parts without shapes."""
    moved = _beam("upper").replace(
        '<origin xyz="0 0 0.2"/>', f'<origin xyz="0 0 {centre}"/>', 1
    )
    rules = _rules(linted(moved, effort=1e9))
    assert ("centre-of-mass" in rules) == found


def test_a_centre_of_mass_in_millimetres_is_found_in_mjcf(tmp_path):
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><worldbody>
        <body name="arm"><joint axis="0 0 1"/>
        <inertial pos="40 0 0" mass="3" diaginertia="0.0045 0.0109 0.0136"/>
        <geom type="box" size="0.1 0.06 0.03"/></body></worldbody></mujoco>"""
    )
    found = [f for f in lint_robot(path) if f.rule == "centre-of-mass"]
    assert [f.line for f in found] == [2]


def test_a_limit_that_other_readers_demand_is_an_error_here(tmp_path, linted):
    linted()
    path = tmp_path / "arm.urdf"
    path.write_text(path.read_text().replace(' effort="50"', "", 1))
    (finding,) = lint_robot(path)
    assert (finding.rule, finding.severity) == ("structure", "error")
    assert "joint 'b': <limit> lacks effort" in finding.sentence


def test_gravity_beyond_the_effort_limit_is_found(linted):
    """Both beams stretched out: (3 * 0.2 + 2 * 0.6) 9.81 = 17.658 N m."""
    assert linted(effort=17.7) == ()
    (found,) = linted(effort=15.0)
    assert (found.rule, found.severity) == ("gravity-torque", "warning")
    assert "the effort limit is 15 N m" in found.sentence
    worst = float(found.sentence.split("needs ")[1].split()[0])
    assert 16.0 < worst <= 17.7


def test_an_inertia_with_the_mass_of_another_is_a_placeholder(linted):
    factor = 3.0 * (0.1**2 + 0.4**2) / (2.0 * (0.1**2 + 0.4**2))
    found = linted(lower=_beam("lower", mass=2.0, factor=factor))
    assert "placeholder-inertia" in _rules(found)


def test_a_link_without_mass_at_the_end_is_an_error(linted):
    (found,) = linted(lower='<link name="lower"/>')
    assert (found.rule, found.severity) == ("vanishing-mass", "error")
    point = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
    lower = f'<link name="lower"><inertial><mass value="1"/>{point}</inertial></link>'
    assert "point-mass" in _rules(linted(lower=lower))


@pytest.mark.parametrize(
    ("left", "right"), [("left_arm", "right_arm"), ("FL_hip", "FR_hip"), ("l_a", "r_a")]
)
def test_left_and_right_that_differ_are_found(linted, left, right):
    fixed = '<joint name="{0}_fix" type="fixed"><parent link="base"/>{1}</joint>'
    ends = "".join(fixed.format(n, f'<child link="{n}"/>') for n in (left, right))
    same = _beam(left) + _beam(right) + ends
    assert "twins-differ" not in _rules(linted(more=same))
    other = _beam(left) + _beam(right, mass=4.0) + ends
    (found,) = [f for f in linted(more=other) if f.rule == "twins-differ"]
    assert "mass is 4 kg" in found.sentence


def test_rounding_is_no_fault(linted):
    """An eigenvalue of -2e-22 beside 3e-6 has no sign."""
    flat = (
        '<link name="lower"><inertial><mass value="0.01"/><inertia ixx="3e-6" '
        'ixy="0" ixz="0" iyy="3e-6" iyz="0" izz="-2e-22"/></inertial></link>'
    )
    assert "inconsistent-inertia" not in _rules(linted(lower=flat))


def test_an_inconsistent_inertia_comes_with_its_mistake(linted):
    wrong = _beam("lower", mass=2.0).replace("ixx=", 'ixx="28.3" was=')
    found = {f.rule: f for f in linted(lower=wrong)}
    assert found["inconsistent-inertia"].severity == "error"
    assert "probably ixx is 1000 times too large" in str(found["probable-mistake"])


MJCF = """<mujoco>
  <worldbody>
    <body name="arm" pos="0 0 0.5">
      <joint name="lift" axis="0 1 0" actuatorfrcrange="-5 5"/>
      <inertial pos="0.2 0 0" mass="3" diaginertia="0.01 0.1 0.1"/>
      <geom type="box" size="{size} 0.05 0.05" pos="0.2 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_mjcf_is_linted_with_lines(tmp_path):
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.format(size=0.3))
    (found,) = lint_robot(path)
    assert (found.line, found.rule) == (4, "gravity-torque")  # 3 * 9.81 * 0.2 = 5.9
    path.write_text(MJCF.format(size=0.06))
    assert {f.line: f.rule for f in lint_robot(path)} == {
        3: "radius-of-gyration",
        4: "gravity-torque",
    }
    path.write_text(MJCF.format(size=0.3).replace("0.1 0.1", "0.1 0.3"))
    (found,) = lint_robot(path)
    assert found.severity == "error"
    assert "MuJoCo refuses it" in found.sentence


def test_gravity_on_a_follower_is_held_by_its_leader(linted):
    """Beams of 3 and 2 kg: the follower's torque is felt by the leader, twice."""
    follower = JOINT.format(
        name="c", parent="lower", child="tip", at=0.4, effort=1e-3
    ).replace("</joint>", '<mimic joint="b" multiplier="2"/></joint>')
    more = _beam("tip", mass=1.0) + follower
    assert _rules(linted(effort=1e3, more=more)) == set()
    (found,) = [f for f in linted(effort=1.0, more=more) if f.rule == "gravity-torque"]
    assert "joint 'a'" in found.sentence


def test_text_that_is_no_robot_is_a_finding(tmp_path):
    path = tmp_path / "robot.urdf"
    for text, words in (("<robot>", "not well-formed"), ("<sdf/>", "expected <robot>")):
        path.write_text(text)
        (found,) = lint_robot(path)
        assert words in found.sentence


@pytest.mark.slow
def test_the_command_answers_in_text_json_and_sarif(linted, tmp_path, capsys):
    linted(effort=15.0)
    path = tmp_path / "arm.urdf"
    assert main(["lint", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"{path}:14: warning: joint 'a'" in out
    assert "1 file: 0 errors, 1 warnings" in out
    assert main(["lint", str(path), "--strict"]) == 1
    capsys.readouterr()
    sarif = tmp_path / "found.sarif"
    assert main(["lint", str(path), "--json", "--sarif", str(sarif)]) == 0
    record = parsed(capsys.readouterr().out)
    (found,) = record["files"][str(path)]
    assert (found["rule"], found["line"]) == ("gravity-torque", 14)
    written = json.loads(sarif.read_text())
    (run,) = written["runs"]
    rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
    (result,) = run["results"]
    assert result["ruleId"] in rules
    place = result["locations"][0]["physicalLocation"]
    assert place["region"]["startLine"] == 14
    linted(lower='<link name="lower"/>')
    assert main(["lint", str(path), "--quiet"]) == 1


@pytest.mark.slow
def test_the_command_imports_what_it_needs_and_not_the_estimators(linted, tmp_path):
    linted()
    code = (
        "import sys; from consistent_id.cli import main; "
        f"main(['lint', {str(tmp_path / 'arm.urdf')!r}]); "
        "print(*(m for m in sys.modules if m.startswith('consistent_id')))"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout
    loaded = out.splitlines()[-1].split()
    assert len(loaded) <= 80
    assert "consistent_id.regression.regressor" not in loaded
    assert "consistent_id.estimation.estimate" not in loaded


@pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)
def test_published_robots_have_the_findings_that_are_known():
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"])
    assert lint_robot(folder / "ur10e" / "ur10e.urdf") == ()
    found = lint_robot(folder / "kuka_kr300" / "kr300.urdf")
    assert [(f.line, f.rule) for f in found] == [(16, "point-mass")]


# Solid shapes, and their principal moments over the mass.
SOLIDS = {
    'type="box" size="0.1 0.06 0.03"': (0.0015, 0.0036333, 0.0045333),
    'type="ellipsoid" size="0.1 0.06 0.03"': (0.0009, 0.00218, 0.00272),
    'type="cylinder" size="0.06 0.1"': (0.0042333, 0.0042333, 0.0018),
    'type="capsule" size="0.05 0.1"': (0.0055, 0.0055, 0.00118),
}


@pytest.mark.parametrize("shape", SOLIDS)
@pytest.mark.parametrize("unit", [1.0, 1e4])
def test_a_wrong_unit_in_mjcf_is_seen_by_the_shape(tmp_path, shape, unit):
    """Bodies of three kilograms, whose inertia is in kg m^2, or in kg cm^2."""
    pytest.importorskip("mujoco")
    stated = " ".join(f"{unit * 3.0 * moment:.6g}" for moment in SOLIDS[shape])
    path = tmp_path / "arm.xml"
    path.write_text(
        f"""<mujoco><worldbody>
        <body name="arm"><joint axis="0 0 1"/>
        <inertial pos="0 0 0" mass="3" diaginertia="{stated}"/>
        <geom {shape}/></body></worldbody></mujoco>"""
    )
    found = [f for f in lint_robot(path) if f.rule == "probable-mistake"]
    assert [f.line for f in found] == ([2] if unit > 1.0 else [])
    assert all("10000 times too large" in f.sentence for f in found)


def test_an_mjcf_leg_with_another_sign_than_its_twins_is_a_probable_mistake(tmp_path):
    pytest.importorskip("mujoco")
    legs = [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (-1, -1, -1)]  # the last has a wrong ixy
    bodies = "".join(
        f"""<body name="leg{k}" pos="{k} 0 0"><joint axis="0 0 1"/>
        <inertial pos="{0.02 * x} {0.01 * y} 0.03" mass="0.7" fullinertia="0.001 0.0011
        0.0009 {x * y * z * 1e-4} {x * 2e-4} {y * 3e-4}"/></body>"""
        for k, (x, y, z) in enumerate(legs)
    )
    path = tmp_path / "legs.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    found = [f for f in lint_robot(path) if f.rule == "probable-mistake"]
    assert ["'leg3'" in f.sentence and "sign" in f.sentence for f in found] == [True]
