"""MJCF files of one's own: what the export leaves as it was."""

import re
from dataclasses import replace

import numpy as np
import pytest
from estimates import random_estimate
from mujoco_torques import SPRUNG, inverse_dynamics
from robots import URDF, random_states

from consistent_id import DriveTerms, ProblemError, to_mjcf
from consistent_id.regression import GearCoupling
from consistent_id.robot import load_mjcf, load_urdf

mujoco = pytest.importorskip("mujoco")

DRESSED = """<?xml version="1.0"?>
<!-- our arm -->
<mujoco model="arm">
  <compiler angle='degree' meshdir="shapes"/>
  <!-- as measured -->
  <asset><mesh file="arm.obj"/></asset>
  <worldbody>
    <body name="arm"><joint name="lift" axis="0 1 0"/>  <!-- motor A -->
      <inertial pos="0.2 0 0" euler="0 0 30" mass="3" diaginertia="0.01 0.1 0.1"/>
      <geom type="mesh" mesh="arm"/>
      <body name="hand" pos="0.4 0 0"><joint axis="0 1 0"/><geom size="0.05"/></body>
    </body>
  </worldbody>
</mujoco>
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def dressed(tmp_path):
    """A file with comments and a mesh, and an estimate for it."""
    (tmp_path / "robot" / "shapes").mkdir(parents=True)
    (tmp_path / "robot" / "shapes" / "arm.obj").write_text(OBJ)
    path = tmp_path / "robot" / "arm.xml"
    path.write_text(DRESSED)
    robot = load_mjcf(path)
    return path, random_estimate(np.random.default_rng(6), robot, SPRUNG)


def _without_numbers(text):
    tags = r"<(inertial|joint|geom size)[^>]*>|<!-- consistent-id[^>]*-->|\s+"
    return re.sub(tags, "", text)


def test_all_but_numbers_keeps_its_bytes(dressed):
    path, estimate = dressed
    text = to_mjcf(estimate, path).content.decode()
    assert text.startswith(
        '<?xml version="1.0"?>\n<!-- our arm -->\n<mujoco model="arm">'
    )
    assert _without_numbers(text) == _without_numbers(DRESSED)
    assert "euler" not in text
    path.write_text(text)  # once more: the same bytes
    assert to_mjcf(estimate, path).content.decode() == text


def test_the_identified_file_loads_from_where_it_is_written(dressed, tmp_path):
    path, estimate = dressed
    moved = tmp_path / "results" / "deep" / "arm.xml"
    export = to_mjcf(estimate, path, folder=moved.parent)
    export.save(moved)
    assert 'meshdir="../../robot/shapes"' in export.content.decode()
    assert mujoco.MjModel.from_xml_path(str(moved)).nmesh == 1
    alone = tmp_path / "alone" / "arm.xml"
    to_mjcf(estimate, path, folder=alone.parent, copy_files=True).save(alone)
    (path.parent / "shapes" / "arm.obj").unlink()
    assert mujoco.MjModel.from_xml_path(str(alone)).nmesh == 1


def test_a_copy_does_not_overwrite_another_file(dressed, tmp_path):
    path, estimate = dressed
    other = tmp_path / "alone" / "shapes" / "arm.obj"
    other.parent.mkdir(parents=True)
    other.write_text("another")
    export = to_mjcf(estimate, path, folder=tmp_path / "alone", copy_files=True)
    with pytest.raises(ProblemError, match="another file is there already"):
        export.save(tmp_path / "alone" / "arm.xml")
    assert other.read_text() == "another"


def test_a_missing_mesh_does_not_stop_the_export(dressed):
    path, estimate = dressed
    (path.parent / "shapes" / "arm.obj").unlink()
    text = to_mjcf(estimate, path).content.decode()
    assert '<mesh file="arm.obj"/>' in text
    path.write_text(text)
    links = load_mjcf(path).links
    for link, vector in zip(links, estimate.links, strict=True):
        assert np.allclose(link.nominal.vector, vector, rtol=1e-12, atol=1e-12)


def test_a_file_with_includes_is_written_anew(dressed):
    path, estimate = dressed
    section = '<asset><mesh file="arm.obj"/></asset>'
    (path.parent / "assets.xml").write_text(f"<mujocoinclude>{section}</mujocoinclude>")
    path.write_text(DRESSED.replace(section, '<include file="assets.xml"/>'))
    export = to_mjcf(estimate, path)
    assert "comments are lost" in export.notes[-1]
    path.write_bytes(export.content)
    assert mujoco.MjModel.from_xml_path(str(path)).nmesh == 1


@pytest.mark.slow
def test_shapes_that_weighed_give_way_to_inertials(dressed):
    path, _ = dressed
    text = DRESSED.replace("meshdir", 'inertiafromgeom="true" meshdir')
    path.write_text(text)
    estimate = random_estimate(np.random.default_rng(8), load_mjcf(path), SPRUNG)
    export = to_mjcf(estimate, path)
    path.write_bytes(export.content)
    for link, vector in zip(load_mjcf(path).links, estimate.links, strict=True):
        assert np.allclose(link.nominal.vector, vector, rtol=1e-12, atol=1e-12)


DAMPED = DriveTerms(viscous=True, rotor_inertia=True, spring=True)
COMPILED = {
    "the total mass": ('settotalmass="2" meshdir', "meshdir"),
    "least masses and inertias": (
        'boundmass="50" boundinertia="50" meshdir',
        "meshdir",
    ),
    "fused bodies": ('fusestatic="true" meshdir', "meshdir"),
    "a damping ratio": ('name="lift" springdamper="0.5 1"', 'name="lift"'),
}


@pytest.mark.filterwarnings("ignore:.*settotalmass")
@pytest.mark.parametrize("what", COMPILED)
def test_settings_that_change_a_body_or_a_drive_give_way(dressed, what):
    path, _ = dressed
    plate = '<body name="plate"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    text = DRESSED.replace('<geom size="0.05"/>', f'<geom size="0.05"/>{plate}</body>')
    new, old = COMPILED[what]
    path.write_text(text.replace(old, new))
    robot = load_mjcf(path)
    assert [frame.name for frame in robot.links[1].merged] == ["plate"]
    estimate = random_estimate(np.random.default_rng(8), robot, DAMPED)
    path.write_bytes(to_mjcf(estimate, path).content)
    states = random_states(np.random.default_rng(0), 2, 5)
    expected = estimate.model.predict(estimate.parameters, *states)
    model = mujoco.MjModel.from_xml_path(str(path))
    found = inverse_dynamics(model, robot.joint_names, states)
    assert np.allclose(found, expected, rtol=0, atol=1e-9 * abs(expected).max())


KEPT = {
    "gravcomp": ('body name="arm" gravcomp="1"', 'body name="arm"'),
    "medium": ('<option density="1.2"/><asset>', "<asset>"),
    "disables damper": (
        '<option><flag damper="disable"/></option><asset>',
        "<asset>",
    ),
}


@pytest.mark.parametrize("what", KEPT)
def test_what_else_acts_on_the_joints_is_noted(dressed, what):
    path, _ = dressed
    new, old = KEPT[what]
    path.write_text(DRESSED.replace(old, new))
    estimate = random_estimate(np.random.default_rng(8), load_mjcf(path), SPRUNG)
    assert any(what in note for note in to_mjcf(estimate, path).notes)


def test_a_file_of_another_ending_gets_the_robot_too(dressed):
    path, estimate = dressed
    other = path.with_suffix(".mjcf")
    other.write_text(DRESSED)
    assert to_mjcf(estimate, other).content == to_mjcf(estimate, path).content


def test_a_torque_offset_is_a_weak_spring(dressed):
    path, _ = dressed
    offset = DriveTerms(offset=True)
    estimate = random_estimate(np.random.default_rng(9), load_mjcf(path), offset)
    for export in (to_mjcf(estimate), to_mjcf(estimate, path)):
        assert "weak springs with preload" in "\n".join(export.notes)
        path.write_bytes(export.content)
        model = mujoco.MjModel.from_xml_path(str(path))
        states = random_states(np.random.default_rng(0), 2, 5)
        expected = estimate.model.predict(estimate.parameters, *states)
        found = inverse_dynamics(model, estimate.model.robot.joint_names, states)
        share = abs(states[0]).max() * 1e-4 * max(estimate.parameters[-2:])
        assert abs(found - expected).max() <= 1.001 * share
        path.write_text(DRESSED)


def test_coupled_gears_of_a_file_are_a_tendon_in_it(dressed):
    path, _ = dressed
    robot = load_mjcf(path)
    drive = DriveTerms(viscous=True, rotor_inertia=True)
    gears = GearCoupling("lift", "joint1", viscous=True)
    estimate = random_estimate(np.random.default_rng(1), robot, drive, (gears,))
    x = estimate.parameters.copy()
    x[20:24] += 3.0  # a joint's own is more than what it shares
    content = to_mjcf(replace(estimate, parameters=x), path).content
    path.write_bytes(content)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.ntendon == 1
    assert np.ravel(model.tendon_damping)[0] == x[-1]


def test_a_urdf_becomes_the_mjcf_of_the_identified_robot(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    robot = load_urdf(path)
    estimate = random_estimate(np.random.default_rng(8), robot, DAMPED)
    export = to_mjcf(estimate, path)
    assert "robot.urdf is a URDF, so MuJoCo wrote it anew" in "\n".join(export.notes)
    states = random_states(np.random.default_rng(0), len(robot), 5)
    expected = estimate.model.predict(estimate.parameters, *states)
    model = mujoco.MjModel.from_xml_string(str(export))
    found = inverse_dynamics(model, robot.joint_names, states)
    assert np.allclose(found, expected, rtol=0, atol=1e-9 * abs(expected).max())
