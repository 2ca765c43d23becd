"""Soles by the boxes of a biped's feet; poses by its keyframes or as stated."""

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FOLDER

import consistent_id as ci
from consistent_id.errors import ProblemError
from consistent_id.robot.loaders import load_robot
from consistent_id.standing import standing_feet, standing_pose

BODY = '<inertial pos="0 0 0" mass="1" diaginertia="0.02 0.03 0.04"/>'
AXES = {"yaw": "0 0 1", "roll": "1 0 0", "pitch": "0 1 0", "knee": "0 1 0"}

#: Of the sole's box, whose axes are turned by 90 degrees about z: half sizes, middle.
HALF, MIDDLE = np.array([0.05, 0.1, 0.01]), np.array([0.03, 0.0, -0.04])
BOX = (
    f'<geom type="box" size="{" ".join(map(str, HALF))}" '
    f'pos="{" ".join(map(str, MIDDLE))}" euler="0 0 90"/>'
)
#: Much larger than the sole, but touches nothing.
DECORATION = '<geom type="box" size="1 1 1" contype="0" conaffinity="0"/>'


def biped(folder, shape=BOX, keyframe=""):
    """A trunk on two legs of five joints, with its file."""

    def leg(side, y):
        text = f'<body name="{side}_foot">{BODY}{shape}{DECORATION}'
        text += f'<joint name="{side}_ankle" axis="0 1 0"/></body>'
        for name, axis in reversed(AXES.items()):
            joint = f'<joint name="{side}_{name}" axis="{axis}"/>'
            place = f"0 {y} 0" if name == "yaw" else "0 0 -0.2"
            begin = f'<body name="{side}_{name}" pos="{place}">'
            text = f"{begin}{BODY}{joint}{text}</body>"
        return text

    file = folder / "biped.xml"
    file.write_text(
        f'<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/>{BODY}'
        f"{leg('left', 0.1)}{leg('right', -0.1)}</body></worldbody>{keyframe}</mujoco>"
    )
    return ci.robot.load_mjcf(file, base="floating"), file


def test_a_sole_is_pressed_within_its_box(tmp_path):
    robot, file = biped(tmp_path)
    feet = standing_feet(robot, file)
    assert [foot.frame for foot in feet] == ["left_foot", "right_foot"]
    # Turned by 90 degrees, the box is 0.2 m long and 0.1 m wide; 80 % of it bears.
    x, y = np.array([0.1, 0.05]) * 0.8
    bottom = MIDDLE[2] - HALF[2]
    corners = [[MIDDLE[0] + a * x, b * y, bottom] for a in (-1, 1) for b in (-1, 1)]
    for foot in feet:
        assert foot.flat
        assert np.allclose(foot.points, corners, atol=1e-12)


def test_a_stated_sole_lies_around_the_frames_origin(tmp_path):
    robot, file = biped(tmp_path, shape="")
    with pytest.raises(ProblemError, match="'left_foot' has no collision shape"):
        standing_feet(robot, file)
    (foot,) = standing_feet(robot, file, ["right_foot"], sole=(0.2, 0.1))
    assert (foot.frame, foot.flat) == ("right_foot", True)
    assert np.allclose(abs(foot.points), [0.08, 0.04, 0.0], atol=1e-12)
    assert np.allclose(foot.points.mean(axis=0), 0.0, atol=1e-12)
    assert len(np.unique(foot.points, axis=0)) == 4


def test_a_pose_is_the_keyframes_with_what_is_stated(tmp_path):
    values = np.linspace(0.1, 1.0, 10)  # in the order of the file's joints
    joints = " ".join(f"{v:.1f}" for v in values)
    key = f'<keyframe><key name="{{}}" qpos="0 0 1 1 0 0 0 {joints}"/></keyframe>'
    zero = '<keyframe><key name="fallen"/><key name="at_home"'
    text = key.format("at_home").replace('<keyframe><key name="at_home"', zero)
    robot, file = biped(tmp_path, keyframe=text)
    names = [f"{s}_{j}" for s in ("left", "right") for j in (*AXES, "ankle")]
    expected = dict(zip(names, values, strict=True))
    feet = standing_feet(robot, file)
    pose = standing_pose(robot, file, feet)
    assert pose == pytest.approx([expected[n] for n in robot.joint_names])
    pose = standing_pose(robot, file, feet, {"right_knee": -0.7})
    expected["right_knee"] = -0.7
    assert pose == pytest.approx([expected[n] for n in robot.joint_names])


def test_of_a_file_without_keyframes_joints_that_are_not_stated_stay_at_zero(tmp_path):
    robot, file = biped(tmp_path)
    feet = standing_feet(robot, file)
    pose = standing_pose(robot, file, feet, {"left_knee": 0.4})
    assert pose == pytest.approx([0.4 * (n == "left_knee") for n in robot.joint_names])
    with pytest.raises(ci.ConsistentIdError, match="left_knee"):
        standing_pose(robot, file, feet, {"left_nee": 0.4})


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER.exists(), reason="example-robot-data is missing")
@pytest.mark.parametrize("name", ["go2", "a1", "b1"])
def test_the_centre_of_mass_is_above_the_middle_of_the_feet(name):
    """Of quadrupeds without a keyframe, by Pinocchio; Go2 fell over its rear feet."""
    file = FOLDER / f"{name}_description" / "urdf" / f"{name}.urdf"
    robot = load_robot(file, base="floating")
    feet = standing_feet(robot, file, ())
    pose = standing_pose(robot, file, feet)
    model = pin.buildModelFromUrdf(str(file), pin.JointModelFreeFlyer())
    data, q = model.createData(), pin.neutral(model)
    for joint, position in zip(robot.joint_names, pose, strict=True):
        q[model.joints[model.getJointId(joint)].idx_q] = position
    centre = pin.centerOfMass(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    places = [data.oMf[model.getFrameId(foot.frame)].translation for foot in feet]
    assert np.linalg.norm((np.mean(places, axis=0) - centre)[:2]) < 2e-3
    assert abs(np.ptp(places, axis=0)[2]) < 1e-3  # and they stand on a level floor
