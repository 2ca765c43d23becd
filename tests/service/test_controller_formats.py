"""Loads as controllers take them: order, units and frames of each vendor's form."""

import json
import os
import re
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from consistent_id._support.ownership import sealed
from consistent_id.errors import ModelError, ProblemError
from consistent_id.robot import FixedFrame, InertialParameters
from consistent_id.robot.inertia import principal_inertia
from consistent_id.service import CONTROLLER_FORMATS, ControllerLoad, controller_text
from consistent_id.service.controller_formats import (
    quaternion_wxyz,
    turned_zyx,
)

MOMENTS = np.array([0.01, 0.02, 0.025])
COM = np.array([0.1, -0.02, 0.05])
TURN = pin.rpy.rpyToMatrix(0.3, -0.2, 0.5)
INERTIA = TURN @ np.diag(MOMENTS) @ TURN.T
FLANGE = FixedFrame("tool0", pin.rpy.rpyToMatrix(0.1, 0.7, -0.4), [0.0, 0.117, 0.02])
TOOL = FixedFrame("tcp", pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2), [0.0, 0.0, 0.2])
NINE = 1e-8  # nine digits are written
SIX = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]


def load(inertia=INERTIA, **more):
    body = InertialParameters.from_central(2.5, COM, inertia)
    return ControllerLoad("box", body, FLANGE, "wrist", TOOL, **more)


def numbers(text):
    return [float(word) for word in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def near(found, expected):
    np.testing.assert_allclose(found, expected, rtol=NINE, atol=1e-11)


def six(matrix):
    return [matrix[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def test_ur_gets_metres_and_xx_yy_zz_xy_xz_yz_about_the_centre_of_mass():
    call = controller_text(load(), "ur").splitlines()[1]
    name, rest = call.split("(", 1)
    assert name == "set_target_payload"
    near(numbers(rest), [2.5, *COM, *six(INERTIA)])
    assert re.fullmatch(r"[^[]+, \[[^]]+\], \[[^]]+\]\)", rest)


FORMS = {  # what ``ros2 interface show`` prints: the request
    "geometry_msgs/Inertia payload\n\tfloat64 m\n\tfloat64 ixx\n---\n": (
        ["payload", "m", "com", *"xyz", *SIX]
    ),
    "float32 mass\ngeometry_msgs/Vector3 center_of_gravity\nfloat64 ixx\n---\n": (
        ["mass", "center_of_gravity", *"xyz", *SIX]
    ),
    "float32 mass\ngeometry_msgs/Vector3 center_of_gravity\n---\n": (
        ["mass", "center_of_gravity", *"xyz"]
    ),
}


def called(folder, form, shown=""):
    """Return the words that a script calls `ros2` with, which shows one interface."""
    (folder / "shown").write_text(shown)
    ros2 = folder / "ros2"
    ros2.write_text(
        '#!/bin/sh\nif [ "$1" = interface ]; then cat shown; else\n'
        'printf "%s\\n" "$@" > called; fi\n'
    )
    ros2.chmod(0o755)
    (folder / "call.sh").write_text(controller_text(load(), form))
    path = f"{folder}:{os.environ['PATH']}"
    subprocess.run(
        ["sh", "call.sh"], cwd=folder, env={**os.environ, "PATH": path}, check=True
    )
    return (folder / "called").read_text().splitlines()


def test_franka_s_ros_2_call_has_nine_entries_column_by_column(tmp_path):
    *call, request = called(tmp_path, "franka-ros2")
    place = "/service_server/set_load"
    assert call == ["service", "call", place, "franka_msgs/srv/SetLoad"]
    content = yaml.safe_load(request)
    assert list(content) == ["mass", "center_of_mass", "load_inertia"]
    near(content["mass"], 2.5)
    near(content["center_of_mass"], COM)
    near(np.reshape(content["load_inertia"], (3, 3), order="F"), INERTIA)


@pytest.mark.parametrize(("shown", "words"), FORMS.items())
def test_the_ros_2_call_has_the_form_of_the_installed_service(tmp_path, shown, words):
    """A `ros2` that shows one form of the service, and keeps what it is called with."""
    *call, request = called(tmp_path, "ur-ros2", shown)
    place = "/io_and_status_controller/set_payload"
    assert call == ["service", "call", place, "ur_msgs/srv/SetPayload"]
    assert re.findall(r"[a-z_]+(?=:)", request) == words
    expected = [2.5, *COM, *six(INERTIA)]
    near(numbers(request), expected[: 10 if "ixx" in words else 4])
    assert yaml.safe_load(request)


def test_franka_gets_nine_entries_column_by_column():
    text = controller_text(load(), "franka").splitlines()[1]
    assert text.startswith("robot.setLoad(") and text.endswith("}});")
    near(numbers(text), [2.5, *COM, *INERTIA.T.ravel()])


def test_franka_s_end_effector_has_the_tool_s_frame_column_by_column():
    content = json.loads(controller_text(load(), "franka-end-effector"))
    near(content["mass"], 2.5)
    near(content["centerOfMass"], COM)
    near(np.reshape(content["inertia"], (3, 3), order="F"), INERTIA)
    placed = np.reshape(content["transformation"], (4, 4), order="F")
    near(placed, pin.SE3(TOOL.rotation, TOOL.translation).homogeneous)
    keys = "id name color mass centerOfMass transformation inertia"
    assert set(content) == set(keys.split())


def test_kuka_gets_millimetres_degrees_and_principal_moments():
    text = controller_text(load(), "kuka").splitlines()[1]
    shape = (
        r"LOAD_DATA\[1\]={M .*,CM {X .*,Y .*,Z .*,A .*,B .*,C .*},J {X .*,Y .*,Z .*}}"
    )
    assert re.fullmatch(shape, text)
    m, x, y, z, a, b, c, *moments = numbers(text.partition("=")[2])
    near([m, x, y, z], [2.5, *1e3 * COM])
    about_z, about_y, about_x = (
        pin.rpy.rpyToMatrix(*angles)
        for angles in np.radians([[0, 0, a], [0, b, 0], [c, 0, 0]])
    )
    axes = about_z @ about_y @ about_x
    np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, INERTIA, atol=1e-9)


def test_kuka_s_angle_a_turns_about_z():
    turned = pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(30.0))
    inertia = turned @ np.diag(MOMENTS) @ turned.T
    text = controller_text(load(inertia), "kuka").splitlines()[1]
    near(numbers(text.partition("CM")[2])[3:], [30.0, 0.0, 0.0, *MOMENTS])


def test_abb_gets_the_load_in_the_frame_of_the_tool():
    text = controller_text(load(), "abb").splitlines()[1]
    assert re.fullmatch(r"PERS loaddata box:=\[.*,\[.*\],\[.*\],.*,.*,.*\];", text)
    m, x, y, z, w, *vector, ix, iy, iz = numbers(text.partition(":=")[2])
    place = pin.SE3(TOOL.rotation, TOOL.translation)
    near([m, x, y, z], [2.5, *1e3 * place.actInv(COM)])
    axes = pin.Quaternion(w, *vector).matrix()
    in_tool = TOOL.rotation.T @ INERTIA @ TOOL.rotation
    np.testing.assert_allclose(
        axes @ np.diag([ix, iy, iz]) @ axes.T, in_tool, atol=1e-9
    )


def test_abb_s_quaternion_has_its_real_part_first():
    turned = pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(30.0))
    half = np.radians(15.0)
    near(quaternion_wxyz(turned), [np.cos(half), 0.0, 0.0, np.sin(half)])


def test_pinocchio_reads_the_urdf_on_the_flange():
    link = controller_text(load(), "urdf")
    inner = link.split('<robot name="box">')[1]
    robot = (
        '<robot name="r"><link name="base"/><link name="tool0"/><joint name="j" '
        'type="revolute"><parent link="base"/><child link="tool0"/><axis xyz="0 0 1"/>'
        f'<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>{inner}'
    )
    body = pin.buildModelFromXML(robot).inertias[1]
    near(body.mass, 2.5)
    near(body.lever, COM)
    near(body.inertia, INERTIA)


def in_mujoco(text):
    """Return the place of the load's body in the link, and its inertia in its axes."""
    body = text.split("<worldbody>")[1].split("</worldbody>")[0]
    arm = (
        '<mujoco><worldbody><body name="wrist"><joint axis="0 0 1"/><inertial pos="0 0 '
        f'0" mass="1" diaginertia="1 1 1"/>{body}</body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(arm)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    which = model.body("box").id
    near(model.body_mass[which], 2.5)
    axes = data.ximat[which].reshape(3, 3)
    return data.xipos[which], axes @ np.diag(model.body_inertia[which]) @ axes.T


@pytest.mark.parametrize("point", [False, True])
def test_mujoco_reads_the_body_in_the_link_that_carries_it(point):
    place, found = in_mujoco(controller_text(load(inertia_open=point), "mjcf"))
    near(place, pin.SE3(FLANGE.rotation, FLANGE.translation).act(COM))
    expected = FLANGE.rotation @ INERTIA @ FLANGE.rotation.T
    np.testing.assert_allclose(found, 0.0 * INERTIA if point else expected, atol=1e-9)


@pytest.mark.parametrize("moments", [(1.0, 2.0, 3.0), (1.0, 1.0, 2.0), (0.0, 1.0, 1.0)])
def test_mujoco_reads_plates_and_rods(moments):
    """On the cone's edge: one moment is the sum of the others, or zero."""
    rng = np.random.default_rng(0)
    for size in (1e-4, 0.7):
        for _ in range(5):
            axes = pin.exp3(rng.normal(size=3))
            inertia = axes @ np.diag(np.multiply(size, moments)) @ axes.T
            _, found = in_mujoco(controller_text(load(inertia), "mjcf"))
            expected = FLANGE.rotation @ inertia @ FLANGE.rotation.T
            np.testing.assert_allclose(found, expected, atol=4e-7 * size)


def test_a_load_of_open_inertia_is_sent_as_a_point_mass():
    point = load(inertia_open=True)
    assert numbers(controller_text(point, "ur").splitlines()[1])[4:] == [0.0] * 6
    kuka = controller_text(point, "kuka").splitlines()[1].partition("CM")[2]
    assert numbers(kuka)[3:] == [0.0] * 6
    abb = numbers(controller_text(point, "abb").splitlines()[1].partition(":=")[2])
    assert abb[4:] == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_principal_axes_are_the_nearest_rotation():
    rng = np.random.default_rng(0)
    for _ in range(50):
        axes = pin.exp3(rng.normal(size=3))
        inertia = axes @ np.diag(MOMENTS) @ axes.T
        found = principal_inertia(inertia)
        turned = found.axes
        np.testing.assert_allclose(
            turned @ np.diag(found.moments) @ turned.T, inertia, atol=1e-15
        )
        assert np.linalg.det(turned) == pytest.approx(1.0)
        # No rotation to the nearest of the 24 orders and signs is above 62.8 degrees.
        assert np.degrees(np.linalg.norm(pin.log3(turned))) < 62.81
        a, b, c = np.radians(turned_zyx(turned))
        np.testing.assert_allclose(pin.rpy.rpyToMatrix(c, b, a), turned, atol=1e-12)
        quaternion = pin.Quaternion(turned)
        expected = np.array([quaternion.w, *quaternion.vec()])
        expected *= np.sign(expected[0])
        np.testing.assert_allclose(quaternion_wxyz(turned), expected, atol=1e-12)


def test_what_is_no_body_is_refused():
    body = InertialParameters.from_central(-1.0, COM, INERTIA)
    with pytest.raises(ModelError, match=r"mass -1 kg.*expected a positive mass"):
        ControllerLoad("box", body, FLANGE, "wrist", TOOL)
    bent = InertialParameters.from_central(1.0, COM, np.diag([1.0, 0.1, 0.1]))
    with pytest.raises(ModelError, match="consistent: False"):
        ControllerLoad("box", bent, FLANGE, "wrist", TOOL)


def test_an_unknown_controller_is_refused_with_the_nearest():
    with pytest.raises(ProblemError, match=r"no controller 'kukas'.*kuka"):
        controller_text(load(), "kukas")
    names = [form.file for form in CONTROLLER_FORMATS]
    assert len(set(names)) == len(names)


def test_a_rod_has_no_negative_moment():
    """Turned by 0.3 rad, rounding makes the moment about its axis -1e-18."""
    c, s = np.cos(0.3), np.sin(0.3)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moments, _ = principal_inertia(axes @ np.diag([0.0, 0.1, 0.1]) @ axes.T)
    np.testing.assert_allclose(sorted(moments), [0.0, 0.1, 0.1], atol=1e-15)
    assert moments.min() == 0.0


@pytest.mark.parametrize("name", ["record", "Load", "TASK", "tool0"])
def test_words_of_rapid_name_no_load_there(name):
    body = InertialParameters.from_central(2.5, COM, INERTIA)
    one = ControllerLoad(name, body, FLANGE, "wrist", TOOL)
    with pytest.raises(ModelError, match=f"{name!r}, a word of abb's language"):
        controller_text(one, "abb")
    assert controller_text(one, "kuka")


def test_every_file_but_franka_s_json_is_known_by_its_mark():
    unmarked = []
    for form in CONTROLLER_FORMATS:
        content = controller_text(load(), form.name).encode()
        if sealed(Path(form.file), content) == content:
            unmarked.append(form.name)
    assert unmarked == ["franka-end-effector"]
