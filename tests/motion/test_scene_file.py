"""Bodies from URDF files stand where Pinocchio has them."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from consistent_id import ModelError
from consistent_id.motion import (
    Body,
    Box,
    Capsule,
    Cylinder,
    Sphere,
    prove_clearance,
    scene_from_urdf,
)
from consistent_id.motion.collisions.farthest import random_poses
from consistent_id.motion.collisions.scene import body_places
from consistent_id.motion.collisions.separation import nearest
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.robot import load_urdf
from consistent_id.robot.kinematics import link_places

SHARE = Path(pin.__file__).parents[4] / "share"
ROBOTS = SHARE / "example-robot-data" / "robots"
UR10 = ROBOTS / "ur_description" / "urdf" / "ur10_joint_limited_robot.urdf"
PANDA = ROBOTS / "panda_description" / "urdf" / "panda.urdf"
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}

needs_robots = pytest.mark.skipif(
    not UR10.exists(), reason="example-robot-data is missing"
)

_LINK = """
  <link name="{name}">
    <inertial><mass value="1"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    {shapes}
  </link>"""
_JOINT = """
  <joint name="{name}" type="{kind}">
    <parent link="{parent}"/> <child link="{child}"/>
    <origin xyz="0.1 0.2 0.5" rpy="0.1 0.7 -0.4"/> <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/>
  </joint>"""


def _shape(inside, tag="collision", origin='xyz="0.1 0 -0.2" rpy="0.3 -0.2 0.9"'):
    return f"<{tag}><origin {origin}/><geometry>{inside}</geometry></{tag}>"


def _file(folder, tool='<cylinder radius="0.05" length="0.2"/>'):
    shapes = {
        "base": _shape('<box size="0.2 0.3 0.1"/>'),
        "arm": _shape('<cylinder radius="0.1" length="0.4"/>')
        + _shape('<sphere radius="0.12"/>', origin='xyz="0 0 0.3"')
        + _shape('<box size="9 9 9"/>', "visual"),
        "hand": _shape('<sphere radius="0.07"/>', "visual"),
        "tool": _shape(tool),
    }
    joints = [
        ("turn", "revolute", "base", "arm"),
        ("slide", "prismatic", "arm", "hand"),
        ("weld", "fixed", "hand", "tool"),
    ]
    keys = ("name", "kind", "parent", "child")
    text = "".join(_LINK.format(name=n, shapes=s) for n, s in shapes.items())
    text += "".join(_JOINT.format(**dict(zip(keys, j, strict=True))) for j in joints)
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="test">{text}</robot>')
    return path


def _pinocchios_name(name):
    link, _, number = name.partition(":")
    return f"{link}_{int(number or 1) - 1}"


def _agrees(scene, path, q):
    """Bodies are where Pinocchio's geometry objects of the same names are."""
    model = pin.buildModelFromUrdf(str(path))
    kind, folder = pin.GeometryType.COLLISION, [str(SHARE)]
    shapes = pin.buildGeomFromUrdf(model, str(path), kind, package_dirs=folder)
    places = body_places(scene, link_places(scene.robot, q))
    data, put = model.createData(), shapes.createData()
    for i, pose in enumerate(q):
        every = np.concatenate([pose, np.full(model.nq - len(pose), 0.02)])
        pin.updateGeometryPlacements(model, data, shapes, put, every)
        for b, body in enumerate(scene.bodies):
            expected = put.oMg[shapes.getGeometryId(_pinocchios_name(body.name))]
            assert np.allclose(places.rotation[i, b], expected.rotation, atol=1e-9)
            assert np.allclose(
                places.translation[i, b], expected.translation, atol=1e-9
            )


def test_plain_shapes_stand_where_pinocchio_has_them(tmp_path):
    path = _file(tmp_path)
    scene = scene_from_urdf(path, load_urdf(path))
    found = {body.name: body.shape for body in scene.bodies}
    assert found == {
        "base": Box((0.2, 0.3, 0.1)),
        "arm:1": Cylinder(0.1, 0.4),
        "arm:2": Sphere(0.12),
        "hand": Sphere(0.07),  # which has visual shapes only
        "tool": Cylinder(0.05, 0.2),
    }
    hand, every = scene.bodies[3], (0, 1, 2, 4)
    assert hand.frame == "hand"
    solid = type(scene)(scene.robot, tuple(scene.bodies[i] for i in every), ())
    _agrees(
        solid,
        path,
        np.array([[0.4, 0.1], [-0.9, 0.3]]),
    )


def test_capsules_are_read(tmp_path):
    path = _file(tmp_path, '<capsule radius="0.05" length="0.2"/>')
    scene = scene_from_urdf(path, load_urdf(path))
    assert scene.bodies[-1].shape == Capsule(0.05, 0.2)


def test_a_locked_joint_holds_its_bodies_where_it_is_locked(tmp_path):
    path = _file(tmp_path)
    whole = scene_from_urdf(path, load_urdf(path))
    part = scene_from_urdf(path, load_urdf(path, locked={"slide": 0.3}))
    q = np.array([[0.4, 0.3]])
    free = body_places(whole, link_places(whole.robot, q))
    held = body_places(part, link_places(part.robot, q[:, :1]))
    assert np.allclose(held.translation, free.translation)
    apart = {frozenset(part.names(pair)) for pair in part.pairs}
    assert frozenset({"arm:1", "base"}) not in apart  # one joint connects them
    assert frozenset({"tool", "base"}) in apart  # the arm is between them


def test_links_behind_the_tip_hang_on_it_and_are_named(tmp_path):
    path = _file(tmp_path)
    scene = scene_from_urdf(path, load_urdf(path, tip="arm"))
    assert scene.swept == ("hand", "tool") and not scene.unchecked
    assert sum("hangs on a joint" in remark for remark in scene.remarks) == 2


def test_what_cannot_be_read_is_named_with_its_line(tmp_path):
    for tool, message in (
        ('<mesh filename="package://nowhere/x.stl"/>', "package://nowhere/x.stl"),
        ('<sphere radius="big"/>', "radius 'big', expected a number"),
        ('<sphere radius="-1"/>', "sphere: radius is -1"),
        ("<cone/>", "shape <cone>, expected one of mesh, box"),
        ("", "<collision> has no shape"),
    ):
        path = _file(tmp_path, tool)
        with pytest.raises(ModelError, match=rf"line \d+: link 'tool'.*{message}"):
            scene_from_urdf(path, load_urdf(path))


@pytest.mark.parametrize("where", ["above", "given"])
def test_packages_are_found_above_the_file_or_where_they_are_given(tmp_path, where):
    folder = tmp_path / "my_robot" if where == "above" else tmp_path / "elsewhere"
    (tmp_path / "my_robot" / "meshes").mkdir(parents=True)
    folder.mkdir(exist_ok=True)
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    faces = ["1 3 2", "1 2 4", "1 4 3", "2 3 4"]
    lines = [f"v {c}" for c in corners] + [f"f {f}" for f in faces]
    mesh = tmp_path / "my_robot" / "meshes" / "tool.obj"
    mesh.write_text("\n".join(lines))
    name = "package://my_robot/meshes/tool.obj"
    path = _file(folder, f'<mesh filename="{name}" scale="0.1 0.2 -0.3"/>')
    dirs = [] if where == "above" else [tmp_path / "my_robot"]
    scene = scene_from_urdf(path, load_urdf(path), package_dirs=dirs)
    points = {b.name: b.shape for b in scene.bodies}["tool"].points
    assert np.allclose(points.min(axis=0), [0.0, 0.0, -0.3])
    assert np.allclose(points.max(axis=0), [0.1, 0.2, 0.0])


@pytest.mark.slow
@needs_robots
@pytest.mark.parametrize("path", [UR10, PANDA], ids=["ur10", "panda"])
def test_meshes_stand_where_pinocchio_has_them(path):
    robot = load_urdf(path, locked=FINGERS if path == PANDA else None)
    scene = scene_from_urdf(path, robot, pieces=1)

    _agrees(scene, path, random_poses(robot, 3, seed=0))


@pytest.mark.slow
@needs_robots
def test_what_touches_as_meshes_touches_as_pieces_and_hardly_more():
    robot = load_urdf(UR10)
    q = random_poses(robot, 150, seed=0)
    pieces, hulls = (_touching(robot, q, pieces) for pieces in (4, 1))
    links = sorted(pieces)
    meshes = _meshes_touching(q, links)
    for pair in links:
        assert not (meshes[pair] & ~pieces[pair]).any()
        assert not (pieces[pair] & ~hulls[pair]).any()
    counts = [sum(found[p].sum() for p in links) for found in (meshes, pieces, hulls)]
    print("touching as meshes, pieces, hulls:", *counts)
    assert counts[1] < 1.1 * counts[0] < 1.6 * counts[0] < counts[2]


def _touching(robot, q, pieces):
    """At which poses the bodies of each pair of links touch."""
    scene = scene_from_urdf(UR10, robot, pieces=pieces)
    near, found = nearest(scene, q, within=0.0), {}
    for k, pair in enumerate(near.pairs):
        links = tuple(scene.bodies[b].frame for b in (pair.first, pair.second))
        touch = near.distance[:, k] < 1e-6  # coal's own tolerance
        found[links] = found.get(links, False) | touch
    return found


def _meshes_touching(q, links):
    import coal

    model = pin.buildModelFromUrdf(str(UR10))
    kind, folder = pin.GeometryType.COLLISION, [str(SHARE)]
    shapes = pin.buildGeomFromUrdf(model, str(UR10), kind, package_dirs=folder)
    data, put = model.createData(), shapes.createData()
    found = {pair: np.zeros(len(q), dtype=bool) for pair in links}
    for i, pose in enumerate(q):
        pin.updateGeometryPlacements(model, data, shapes, put, pose)
        for pair in links:
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            solids = [_solid(shapes, put, f"{name}_0") for name in pair]
            found[pair][i] = coal.collide(*solids[0], *solids[1], request, result) > 0
    return found


def _solid(shapes, put, name):
    import coal

    k = shapes.getGeometryId(name)
    place = coal.Transform3s(put.oMg[k].rotation, put.oMg[k].translation)
    return shapes.geometryObjects[k].geometry, place


@pytest.mark.slow
@needs_robots
def test_a_ur10_stretched_out_is_free_and_folded_it_is_not():
    robot = load_urdf(UR10)
    scene = scene_from_urdf(UR10, robot, ground=-0.02)
    stretched, folded = [0, -1.2, 1.0, -1.0, -1.57, 0], [0, -1.2, 3.0, 0, 0, 0]
    buried = [0, 0.5, 0, 0, 0, 0]
    near = nearest(scene, [stretched, folded, buried])
    assert near.distance[0].min() > 0.01
    worst = [scene.names(near.pairs[k]) for k in near.distance.argmin(axis=1)]
    assert near.distance[1:].min() < -0.05
    assert worst[1][0].startswith("shoulder") or worst[1][1].startswith("wrist")
    assert worst[2][0] == "ground"


@pytest.mark.slow
@needs_robots
def test_a_panda_keeps_clear_of_a_box_until_it_is_put_in_its_way():
    robot = load_urdf(PANDA, locked=FINGERS)
    ready = np.array([0, -0.785, 0, -2.356, 0, 1.571, 0.785])
    sine = np.array([[0.3, 0, 0, 0, 0, 0, 0]])
    path = FourierTrajectory(robot.joint_names, [0.5], ready, sine, 0 * sine, 2.0)
    for x, holds in ((0.9, True), (0.4, False)):
        box = Body("crate", Box((0.2, 0.2, 0.6)), translation=[x, 0.0, 0.3])
        scene = scene_from_urdf(PANDA, robot, added=[box], ground=-0.01)
        report = prove_clearance(scene, path)
        assert report.holds is holds
        assert holds or report.first == "crate"
