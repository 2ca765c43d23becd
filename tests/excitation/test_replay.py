"""A replay is one page that holds everything, and says so if it cannot be made."""

import importlib.util
import re
import sys

import numpy as np
import pytest

from consistent_id import DHRow, ProblemError, from_modified_dh
from consistent_id.cli import main
from consistent_id.excitation.html_replay import ShapesFile, write_replay
from consistent_id.motion import Body, Capsule, Sphere, build_scene, move_along, plane
from consistent_id.motion.limits import motion_limits
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.robot import load_urdf

needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="viser is missing"
)
ARM = from_modified_dh("arm", [DHRow(0, 0), DHRow(np.pi / 2, 0.0), DHRow(0, 0.5)])

_SHAPE = '<visual><geometry><box size="0.1 0.1 0.4"/></geometry></visual>'
_URDF = f"""<robot name="test">
  <link name="base">{_SHAPE}</link>
  <link name="arm">{_SHAPE}</link>
  <link name="hand">{_SHAPE}</link>
  <joint name="turn" type="continuous">
    <parent link="base"/> <child link="arm"/> <axis xyz="0 1 0"/>
    <limit effort="1" velocity="1"/>
  </joint>
  <joint name="grip" type="revolute">
    <parent link="arm"/> <child link="hand"/> <origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/> <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def _move(robot):
    names = robot.joint_names
    swing = np.full((1, len(names)), 0.3)
    path = FourierTrajectory(names, [0.5], swing[0] * 0, swing * 0, swing, 2.0)
    position = {name: (-2.0, 2.0) for name in names}
    limits = motion_limits(robot, position=position, velocity=2.0, acceleration=9.0)
    return move_along(path, limits, from_pose=swing[0] * 0, to_pose=swing[0] * 0)


@pytest.mark.slow
@needs_viser
def test_a_robot_without_shapes_is_replayed_with_its_scene(tmp_path):
    bodies = [
        plane(-0.9),
        Body("post", Sphere(0.1), translation=[0.0, 0.9, 0.0]),
        Body("forearm", Capsule(0.05, 0.3), "link3"),
    ]
    scene = build_scene(ARM, bodies)
    move = _move(ARM)
    page = write_replay(move, ARM, tmp_path / "replay.html", scene=scene).read_text()
    assert f"<title>arm: {move.duration:.1f} s</title>" in page
    assert "__VISER_EMBED_DATA__=" in page
    assert len(page) < 5e6
    assert not re.search(r"(?:src|href)=[\"']https?:", page)


@pytest.mark.slow
@needs_viser
def test_a_robot_with_shapes_is_drawn_by_them_and_locked_joints_stay(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(_URDF)
    robot = load_urdf(file, locked={"grip": 0.5})
    pages = [
        write_replay(
            _move(robot), robot, tmp_path / f"{k}.html", shapes=shapes
        ).read_text()
        for k, shapes in enumerate(
            (ShapesFile(file, locked={"grip": 0.5}), ShapesFile(file), None) * 2
        )
    ]
    # The same is recorded again; another pose of the hand, or sticks, is not the same.
    recorded = [page.split("__VISER_EMBED_DATA__=")[-1] for page in pages]
    assert recorded[:3] == recorded[3:] and len(set(recorded)) == 3


def test_without_the_viewer_it_is_told_what_to_install_before_a_search(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ProblemError, match=r"needs viser; pip install .*\[viz\]"):
        write_replay(_move(ARM), ARM, tmp_path / "replay.html")
    output = str(tmp_path / "out")
    assert main(["excite", "problems/rx60", "--replay", "--output", output]) == 2
    assert "consistent-id[viz]" in capsys.readouterr().err
