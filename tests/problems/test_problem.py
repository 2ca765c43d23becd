"""Problem files: the RX-60's content, and everything that can be wrong in a file."""

import re
from pathlib import Path

import numpy as np
import pytest

from consistent_id import ModelError, ProblemError, RecordingError, load_problem
from consistent_id.problems.file import problem_table

ARM = 'name = "arm"\n[model]\nmodified_dh = [{ alpha_deg = 0, a = 0 }]\n'
DATA = """
[data]
torque_joints = ["elbow"]
recordings = [{ file = "log.csv", role = "training" }]
"""
FREE = '[constraints]\nmasses = "free"\n'


def _load(tmp_path, text):
    (tmp_path / "problem.toml").write_text(text)
    return load_problem(tmp_path)


def test_the_rx60s_verification_motion_is_the_papers():
    problem = load_problem("problems/rx60")
    motion = problem.motion("verification")
    assert (len(motion), motion.rate) == (20001, pytest.approx(1000.0))
    t = motion.time
    amplitude = 0.6 * (-1.2 + 0.35 * t / 20.0)
    assert np.allclose(motion.position[:, 0], amplitude * np.sin(np.pi * t / 4))
    assert np.allclose(motion.position[:, 1], -amplitude * np.cos(np.pi * t / 4))
    assert np.allclose(motion.position[:, 2], np.cos(np.pi * t / 4))
    # Central differences at 1 kHz of motions of pi / 4 rad/s err by 1e-7.
    rate = np.gradient(motion.position, t, axis=0)[1:-1]
    assert np.allclose(motion.velocity[1:-1], rate, atol=1e-6)
    rate = np.gradient(motion.velocity, t, axis=0)[1:-1]
    assert np.allclose(motion.acceleration[1:-1], rate, atol=1e-6)


def test_the_file_may_be_named_instead_of_its_folder():
    assert load_problem("problems/rx60/problem.toml").name == "rx60"


@pytest.mark.parametrize(
    ("name", "parameters", "contacts"),
    [("kuka_kr300", 88, 0), ("walker", 142, 4)],
)
def test_problems_that_bring_their_recordings_are_read(name, parameters, contacts):
    problem = load_problem(f"problems/{name}")
    assert problem.name == name
    assert len(problem.model.layout) == parameters
    (log,) = problem.training
    assert len(log) > 1000 and len(log.contacts) == contacts


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ARM + FREE + "colour = 1\n", r"line \d+: constraints has no key 'colour'"),
        ('name = 3\n[model]\nurdf = "a"\n', r"line 1: name: Expected `str`"),
        ('name = "x"\n', "the file needs the key 'model'"),
        ('name = "x"\n[model]\n', "needs one of urdf, mjcf, modified_dh, classical_dh"),
        (ARM + "[links.link7]\nmass = 1\n", "no moving link named 'link7'"),
        (ARM + "[joints.elbow]\nviscous = true\n", r"\[joints.elbow\].*joint1"),
        (ARM + FREE + '[drive]\ncoulomb = "tanh"\n', "velocity_scale"),
        (ARM + "[links.link1]\nmass = -1\n", r"line 5: links.NAME.mass: .* >= 0.0"),
        (ARM, "no link's datasheet has a mass"),
        (ARM + '[constraints]\nmasses = "bounds"\n', "mass_bounds"),
        (ARM + FREE + "shared_motors = true\n", "no gear coupling"),
        (ARM.replace("[model]", '[model]\njoints = ["elbow"]'), "no joint 'elbow'"),
        (ARM.replace("[model]", '[model]\nurdf = "a"'), "has urdf and modified_dh"),
        (ARM + FREE + DATA, "torque_joints: no joint 'elbow'"),
        ("name = ", "not TOML"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_its_path(tmp_path, text, message):
    with pytest.raises((ProblemError, ModelError), match=message):
        _load(tmp_path, text)


def test_a_file_that_is_not_there_or_not_text_is_refused(tmp_path):
    with pytest.raises(ProblemError, match="cannot be read"):
        load_problem(tmp_path / "nowhere")
    with pytest.raises(ProblemError, match=r"robot's file.*consistent-id init"):
        load_problem(tmp_path / "robot.urdf")
    (tmp_path / "problem.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProblemError, match="not TOML"):
        load_problem(tmp_path)


def test_a_missing_environment_variable_is_named(tmp_path, monkeypatch):
    monkeypatch.delenv("NO_SUCH_FOLDER", raising=False)
    with pytest.raises(ProblemError, match="environment variable NO_SUCH_FOLDER"):
        _load(tmp_path, 'name = "x"\n[model]\nurdf = "${NO_SUCH_FOLDER}/a.urdf"\n')


def test_a_problem_without_recordings_says_so(tmp_path):
    problem = _load(tmp_path, ARM + FREE)
    with pytest.raises(ProblemError, match=r"add a \[data\] table"):
        _ = problem.training
    with pytest.raises(ProblemError, match="no motion 'circle'"):
        problem.motion("circle")


def _with_log(tmp_path, rows, extra=""):
    time = np.arange(400) / 100
    table = np.column_stack([time, np.sin(3 * time), np.cos(3 * time)])
    header = "time,q_joint1,tau_joint1"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=header, comments="")
    return _load(
        tmp_path,
        ARM
        + FREE
        + "[data]\ntorque_gain = 2.0\n[data.columns]\n"
        + 'torque = "tau_{joint}"\n[data.preparation]\nmotion_cutoff = 20\n'
        + f'[[data.recordings]]\nfile = "log.csv"\nrole = "training"\n{rows}\n{extra}',
    )


def test_recordings_are_prepared_and_cut_to_rows_counted_from_one(tmp_path):
    (log,) = _with_log(tmp_path, "rows = [101, 300]").training
    assert (len(log), log.time[0], log.time[-1]) == (200, 1.0, 2.99)
    assert np.allclose(log.torque[:, 0], 2.0 * np.cos(3 * log.time))
    # The filter passes 0.5 Hz with a loss of (0.5 / 20)^8; differences err by 1.4e-3.
    assert np.allclose(log.velocity[:, 0], 3 * np.cos(3 * log.time), atol=2e-3)
    assert np.allclose(log.acceleration[:, 0], -9 * np.sin(3 * log.time), atol=2e-2)


def test_broken_rows_are_left_out_and_rows_stay_those_of_the_file(tmp_path):
    problem = _with_log(tmp_path, "rows = [101, 300]\nomit = [2, 3, 101]")
    lines = (tmp_path / "log.csv").read_text().splitlines()
    lines[2] = "2.7e154,0.0,0.0"  # two samples merged into one by a broken logger
    (tmp_path / "log.csv").write_text("\n".join(lines))
    (log,) = problem.logs("training")
    assert (len(log), log.time[0], log.time[-1]) == (199, 1.01, 2.99)
    with pytest.raises(RecordingError, match=r"time of sample 1 .*omit = \[2\]"):
        problem.read("log.csv")
    with pytest.raises(RecordingError, match="row 401, but there are 400"):
        problem.read("log.csv", omit=[401])


def test_rows_outside_the_file_and_missing_files_are_refused(tmp_path):
    with pytest.raises(ProblemError, match="rows 0 to 500, but the file has 400"):
        _ = _with_log(tmp_path, "rows = [0, 500]").training
    problem = _with_log(tmp_path, "")
    (tmp_path / "log.csv").unlink()
    with pytest.raises(RecordingError, match=r"log\.csv: no such file"):
        _ = problem.training


def test_a_classical_table_is_read_and_its_joints_can_be_locked(tmp_path):
    rows = "[{ alpha_deg = 90, a = 0, d = 0.3 }, { alpha_deg = 0, a = 0.4 }]"
    text = f'name = "arm"\n[model]\nclassical_dh = {rows}\n'
    robot = _load(tmp_path, text + FREE).model.robot
    assert np.allclose(robot.joints[1].rotation, [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert np.allclose(robot.joints[0].axis, [0, 1, 0])
    locked = _load(tmp_path, text + "locked = { joint2 = 0.5 }\n" + FREE).model.robot
    assert locked.joint_names == ("joint1",)
    assert locked.carrier("link2") == locked.carrier("frame2") == 0
    base = _load(tmp_path, text + 'base = "link1"\n' + FREE).model.robot
    assert base.joint_names == ("joint2",)


PAGE = (Path(__file__).parents[2] / "docs" / "problem-file.md").read_text()
SECTIONS = [part for part in re.split(r"\n(?=## )", PAGE)[1:] if "\n|---" in part]
EXAMPLES = [
    re.sub("^    ", "", block, flags=re.MULTILINE)
    for block in re.findall(r"(?:^    .*\n|^\n(?=    ))+", PAGE, re.MULTILINE)
    if re.search(r"^    \[[^,]*$", block, re.MULTILINE)
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.split("\n")[0].strip())
def test_examples_of_the_page_are_problem_files(example):
    named = example.lstrip().startswith("name = ")
    text = example if named else f'name = "shown"\n{example}'
    if "[model]" not in example:
        text = f'{text}\n[model]\nurdf = "robot.urdf"\n'
    if "[data" in example and "[[data.recordings]]" not in example:
        text += '\n[[data.recordings]]\nfile = "log.csv"\nrole = "training"\n'
    problem_table(text, Path("problem.toml"))


def test_every_section_of_the_page_with_keys_has_an_example():
    assert len(SECTIONS) > 12 and len(EXAMPLES) > 15
    bare = [s.split("\n")[0] for s in SECTIONS if "\n    " not in s]
    assert bare == []
