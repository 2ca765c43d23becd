"""Formats and joints are checked before any search."""

import pytest

from consistent_id.cli import main

BODY = """<inertial><mass value="1"/><origin xyz="0.1 0 0"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>"""


def _robot(folder, joints, sliding=()):
    links = "".join(f'<link name="l{k}">{BODY}</link>' for k in range(joints + 1))
    text = "".join(
        f"""<joint name="j{k}" type="{"prismatic" if k in sliding else "revolute"}">
        <parent link="l{k}"/>
        <child link="l{k + 1}"/><origin xyz="0.2 0 0"/>
        <axis xyz="0 {k % 2} {1 - k % 2}"/>
        <limit lower="-1" upper="1" velocity="2" effort="90"/></joint>"""
        for k in range(joints)
    )
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="r">{links}{text}</robot>')
    return file


@pytest.mark.parametrize(
    ("joints", "formats", "said"),
    [
        (6, "rsi,franka", "--format franka: 6 joints, expected 7"),
        (7, "csv,script", "--format script: 7 joints, expected 6"),
        (2, "rsi", "--format rsi: 2 joints, expected 6"),
    ],
)
@pytest.mark.parametrize("more", [[], ["--dry-run"]])
def test_a_format_for_other_robots_is_refused_before_the_search(
    tmp_path, capsys, monkeypatch, joints, formats, said, more
):
    def searched(*_, **__):
        raise AssertionError("the search began")

    monkeypatch.setattr("consistent_id.excitation.playable.playable_design", searched)
    file, output = _robot(tmp_path, joints), tmp_path / "out"
    asked = ["excite", str(file), "--acceleration", "5", "--output", str(output)]
    assert main([*asked, "--format", formats, *more]) == 2
    assert said in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.parametrize(
    ("joints", "ending", "said", "tried"),
    [
        (6, "rsi", "joint 'j2' slides, expected 6 joints that turn", ""),
        (7, "script", "joint 'j2' slides, expected 6 joints that turn", "--lock j2"),
        (8, "franka", "joint 'j2' slides, expected 7 joints that turn", "--lock j2"),
    ],
)
def test_a_joint_that_slides_has_no_axis_angle(
    tmp_path, capsys, joints, ending, said, tried
):
    file = _robot(tmp_path, joints, sliding=[2])
    call = ["excite", str(file), "--acceleration", "5", "--format", ending]
    assert main([*call, "--dry-run"]) == 2
    told = capsys.readouterr().err
    assert f"--format {ending}: {said}" in told
    assert ("try: " in told) is bool(tried) and tried in told


def test_the_tip_that_leaves_an_arm_of_the_format_is_named(tmp_path, capsys):
    """A gripper makes eight joints of seven."""
    file = _robot(tmp_path, 8)
    call = ["excite", str(file), "--acceleration", "5", "--format", "franka"]
    assert main([*call, "--dry-run"]) == 2
    told = capsys.readouterr().err
    assert "8 joints, expected 7" in told and "try: " in told and "--tip l7" in told


@pytest.mark.slow
@pytest.mark.parametrize("option", ["--lock j7", "--tip l7"])
def test_an_arm_with_a_finger_that_slides_may_drop_it(tmp_path, capsys, option):
    file = _robot(tmp_path, 8, sliding=[7])
    call = ["excite", str(file), "--acceleration", "5", "--format", "franka"]
    assert main([*call, "--dry-run"]) == 2
    assert option in capsys.readouterr().err
    assert main([*call, *option.split(), "--dry-run"]) == 0
