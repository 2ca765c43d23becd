"""Which joints a log may have, of a robot with branches."""

from consistent_id.problems.robot_logs import chains_of
from consistent_id.robot import load_urdf

_LINK = (
    '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
    'ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
_JOINT = (
    '<joint name="{1}_joint" type="revolute"><parent link="{0}"/><child link="{1}"/>'
    '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
)


def _robot(folder, *pairs):
    """Return the robot that links, each with its parent, make."""
    names = dict.fromkeys(name for pair in pairs for name in pair)
    parts = [_LINK.format(name) for name in names]
    parts += [_JOINT.format(*pair) for pair in pairs]
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="robot">{"".join(parts)}</robot>')
    return load_urdf(file)


def test_of_a_robot_with_branches_chains_are_known_by_their_length(tmp_path):
    robot = _robot(
        tmp_path,
        ("base", "wheel"),
        ("base", "torso"),
        ("torso", "arm"),
        ("torso", "head"),
        ("arm", "hand"),
    )
    # Two chains have one joint, and two have two.
    assert chains_of(robot) == {3: ("torso_joint", "arm_joint", "hand_joint")}


def test_of_a_robot_without_branches_the_first_joints_are_the_chain(tmp_path):
    assert chains_of(_robot(tmp_path, ("base", "arm"), ("arm", "hand"))) is None
