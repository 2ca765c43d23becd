"""Formats and joints are checked before any search."""

import pytest

from consistent_id.cli import main

BODY = """<inertial><mass value="1"/><origin xyz="0.1 0 0"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>"""


def _robot(folder, joints):
    links = "".join(f'<link name="l{k}">{BODY}</link>' for k in range(joints + 1))
    text = "".join(
        f"""<joint name="j{k}" type="revolute"><parent link="l{k}"/>
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
