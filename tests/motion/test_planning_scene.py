"""Planning scenes of MoveIt: both of its text forms, and its messages."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from consistent_id import DHRow, ProblemError, from_modified_dh
from consistent_id.motion import Box, Cylinder, Sphere, planning_scene_bodies
from consistent_id.robot import load_urdf

ARM = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
TABLE = """(noname)
* table
0.5 0.25 0.1
0 0 0.6 0.8
2
box
1 2 0.05
0.1 0 0
0 0 0 1
0.2 0.2 0.2 1
cylinder
0.03 0.6
0 0 -0.3
0 0 0 1
0 0 0 0
1
corner
0.5 0.5 0
0 0 0 1
* ball
1 0 0
0 0 0 1
1
sphere
0.2
0 0 0
0 0 0 1
0 0 0 0
0
.
"""
OLDER = """room
* the table
1
box
1 2 0.05
0.5 0.25 0.1
0 0 0.6 0.8
0 0 0 0
* wedge
1
mesh
4 4
0 0 0
1 0 0
0 1 0
0 0 1
0 1 2
0 1 3
0 2 3
1 2 3
0 0 2
0 0 0 1
0 0 0 0
.
"""


def _read(folder, text, name="cell.scene", robot=ARM):
    file = folder / name
    file.write_text(text)
    return planning_scene_bodies(file, robot)


def test_objects_of_a_scene_file_stand_where_their_pose_says(tmp_path):
    top, leg, ball = _read(tmp_path, TABLE)
    assert [b.name for b in (top, leg, ball)] == ["table:1", "table:2", "ball"]
    assert top.shape == Box((1.0, 2.0, 0.05)) and leg.shape == Cylinder(0.03, 0.6)
    assert ball.shape == Sphere(0.2) and ball.frame is None
    turned = Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix()
    np.testing.assert_allclose(top.rotation, turned, atol=1e-12)
    place = [0.5, 0.25, 0.1]
    np.testing.assert_allclose(top.translation, place + turned @ [0.1, 0, 0])
    np.testing.assert_allclose(leg.translation, place + turned @ [0, 0, -0.3])


def test_older_files_have_no_pose_of_the_object(tmp_path):
    top, wedge = _read(tmp_path, OLDER)
    assert top.name == "the table"
    np.testing.assert_allclose(top.translation, [0.5, 0.25, 0.1])
    far = wedge.shape.farthest(np.eye(3))
    np.testing.assert_allclose(far, np.eye(3))
    np.testing.assert_allclose(wedge.translation, [0, 0, 2])


def _pose(*place, w=1.0, z=0.0):
    return {
        "position": dict(zip("xyz", place, strict=True)),
        "orientation": {"x": 0.0, "y": 0.0, "z": z, "w": w},
    }


def _message():
    box = {"type": 1, "dimensions": [0.2, 0.4, 0.6]}
    rod = {"type": 3, "dimensions": [1.5, 0.1]}  # height, radius
    cone = {"type": 4, "dimensions": [0.4, 0.2]}
    corners = [{"x": 0.0}, {"x": 1.0}, {"y": 1.0}, {"z": 1.0}]
    return {
        "name": "cell",
        "fixed_frame_transforms": [],
        "world": {
            "collision_objects": [
                {
                    "id": "shelf",
                    "header": {"frame_id": "world", "stamp": {"sec": 0}},
                    "pose": _pose(1.0, 0.0, 0.0, w=0.8, z=0.6),
                    "primitives": [box, rod],
                    "primitive_poses": [_pose(0.5, 0.0, 0.0), _pose(0.0, 0.0, 1.0)],
                },
                {"id": "gone", "operation": 1, "primitives": [box]},
                {"id": "tip", "header": {"frame_id": "link2"}, "primitives": [cone]},
                {"id": "mesh", "meshes": [{"vertices": corners, "triangles": []}]},
            ]
        },
        "robot_state": {
            "attached_collision_objects": [
                {"link_name": "link2", "object": {"id": "held", "primitives": [rod]}}
            ]
        },
    }


def test_messages_have_objects_in_the_world_and_on_links(tmp_path):
    found = {b.name: b for b in _read(tmp_path, json.dumps(_message()), "cell.json")}
    assert set(found) == {"shelf:1", "shelf:2", "tip", "mesh", "held"}
    turned = Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix()
    place = np.array([1.0, 0, 0]) + turned @ [0.5, 0, 0]
    np.testing.assert_allclose(found["shelf:1"].translation, place, atol=1e-12)
    assert found["shelf:2"].shape == Cylinder(0.1, 1.5)
    assert found["tip"].frame == found["held"].frame == "link2"
    cone = found["tip"].shape
    # Around the true cone: its tip, and no point of its rim is outside.
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(721)])
    reach = (cone.farthest(rim) * rim).sum(axis=1)
    assert reach.min() >= 0.2 - 1e-12 and reach.max() <= 0.2 * 1.01
    np.testing.assert_allclose(cone.farthest(np.array([[0, 0, 1.0]])), [[0, 0, 0.2]])


def test_yaml_says_the_same(tmp_path):
    pytest.importorskip("ruamel.yaml")
    one = _read(tmp_path, json.dumps(_message()), "cell.json")
    other = _read(tmp_path, json.dumps(_message()), "cell.yaml")
    for mine, theirs in zip(one, other, strict=True):
        assert mine.name == theirs.name
        np.testing.assert_array_equal(mine.translation, theirs.translation)


def test_a_frame_that_stands_still_is_in_the_base_frame(tmp_path):
    urdf = tmp_path / "robot.urdf"
    urdf.write_text("""
<robot name="r"><link name="base"/><link name="stand"/><link name="arm"/>
  <joint name="f" type="fixed"><parent link="base"/><child link="stand"/>
    <origin xyz="0 0 0.7"/></joint>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
</robot>""")
    message = {"world": {"collision_objects": [
        {"id": "box", "header": {"frame_id": "stand"},
         "primitives": [{"type": 2, "dimensions": [0.1]}]}]}}  # fmt: skip
    (box,) = _read(tmp_path, json.dumps(message), "cell.json", load_urdf(urdf))
    assert box.frame is None
    np.testing.assert_allclose(box.translation, [0, 0, 0.7])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.scene", TABLE.replace("cylinder", "tube"), r"line 11: shape 'tube'"),
        ("a.scene", TABLE.replace("1 2 0.05", "1 two 0.05"), "line 7: .*'two'"),
        ("a.scene", TABLE.rpartition(".")[0], "it ends here"),
        ("a.scene", TABLE.replace("0 0 0.6 0.8", "0 0 0 0"), "line 4: .*quaternion 0"),
        ("a.json", '{"world": {"collision_objects": 3}}', "collision_objects"),
        ("a.json", "{", "not JSON"),
        (
            "a.json",
            json.dumps({"collision_objects": [
                {"id": "x", "header": {"frame_id": "moon"},
                 "primitives": [{"type": 2, "dimensions": [0.1]}]}]}),
            "object 'x': .*no link named 'moon'",
        ),
        (
            "a.json",
            json.dumps({"collision_objects": [
                {"id": "x", "primitives": [{"type": 9, "dimensions": [0.1]}]}]}),
            "object 'x': primitive of type 9",
        ),
    ],
)  # fmt: skip
def test_faults_are_named(tmp_path, name, text, said):
    with pytest.raises(ProblemError, match=said):
        _read(tmp_path, text, name)
