"""Logs with a wrench sensor's columns: what is said, and that it is right."""

import numpy as np
import pytest
from walking import write_csv

import consistent_id as ci
from consistent_id.problems.study import Study

URDF = """
<robot name="arm"><link name="base"/>
{links}
<link name="tool0"/>
<joint name="flange" type="fixed"><parent link="l3"/><child link="tool0"/>
<origin xyz="0.1 0 0" rpy="0 0.5 0"/></joint></robot>
"""
LINK = """<link name="l{k}"><inertial><mass value="2"/><origin xyz="0.1 0 0"/><inertia
ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>
<origin xyz="0.3 0 0" rpy="{turn} 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="3" effort="90"/></joint>"""
TOOL = ci.InertialParameters.from_central(1.3, [0.02, 0, 0.08], 4e-3 * np.eye(3))
NAMES = [f"wrench.{part}.{axis}" for part in ("force", "torque") for axis in "xyz"]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    parents = ("base", "l1", "l2")
    links = "".join(
        LINK.format(k=k, parent=parent, turn=1.57 * (k > 1))
        for k, parent in enumerate(parents, 1)
    )
    file = tmp_path_factory.mktemp("robot") / "arm.urdf"
    file.write_text(URDF.format(links=links))
    return file


def columns(robot, seed=0, *, torque=False):
    """A log of the arm whose flange carries a tool on a sensor."""
    arm, rng = ci.robot.load_urdf(robot), np.random.default_rng(seed)
    tones = 0.4 * rng.normal(size=(2, 3, 3))
    path = ci.recordings.FourierTrajectory(
        arm.joint_names,
        ci.recordings.harmonics_of(0.2, 3),
        np.zeros(3),
        *tones,
        duration=10,
    )
    log = path.recording(rate=100.0)
    none, moved = (
        np.zeros((len(log), 0)),
        ci.regression.sensor_motion(arm, log, "tool0"),
    )
    truth = np.append(TOOL.vector, [3, -2, 5, 0.1, -0.2, 0.05])
    wrench = ci.regression.tool_model("tool").predict(
        truth, none, none, none, base=moved
    )
    wrench += rng.normal(size=wrench.shape) * ([0.2] * 3 + [0.02] * 3)
    found = {"time": log.time}
    found |= {f"q_{j}": log.position[:, k] for k, j in enumerate(arm.joint_names)}
    if torque:
        state = log.position, log.velocity, log.acceleration
        tau = ci.TorqueModel(arm).predict(arm.nominal, *state)
        found |= {f"tau_{j}": tau[:, k] for k, j in enumerate(arm.joint_names)}
    return found | {name: wrench[:, k] for k, name in enumerate(NAMES)}


@pytest.mark.slow
def test_a_draft_says_how_to_use_a_wrench(robot, tmp_path):
    write_csv(tmp_path / "log.csv", columns(robot, torque=True))
    draft = ci.draft_problem(robot, tmp_path / "log.csv", select=False)
    (note,) = [note for note in draft.notes if "wrench" in note]
    assert '[wrist_sensor] frame = "tool0"' in note
    assert "wrench.force.x, wrench.force.y" in note
    assert "[wrist_sensor]" in " ".join(draft.text(tmp_path).split())


@pytest.mark.slow
def test_a_log_of_a_wrench_alone_is_for_the_tool_as_the_message_says(robot, tmp_path):
    write_csv(tmp_path / "training.csv", columns(robot))
    write_csv(tmp_path / "validation.csv", columns(robot, 1))
    with pytest.raises(ci.RecordingError, match="what hangs on it, not") as said:
        ci.draft_problem(robot, tmp_path / "training.csv")
    # Its words, line by line, are the problem file that finds the tool.
    values = str(said.value).split("values = ")[1].split("]")[0] + "]"
    (tmp_path / "problem.toml").write_text(
        f"""name = "tool"
[model]
urdf = "{robot}"
[wrist_sensor]
frame = "tool0"
[data]
recordings = [
  {{ file = "training.csv", role = "training" }},
  {{ file = "validation.csv", role = "validation" }},
]
[[data.wrenches]]
frame = "tool0"
values = {values}
[data.preparation]
motion_cutoff = 20.0
torque_cutoff = 20.0
"""
    )
    study = Study(ci.load_problem(tmp_path, trust=True))
    assert study.constrained.links[0][0] == pytest.approx(TOOL.mass, rel=5e-3)


def test_columns_of_a_table_in_memory_are_seen_too(robot):
    with pytest.raises(ci.RecordingError, match="look like a wrench sensor's"):
        ci.draft_problem(robot, columns(robot))
