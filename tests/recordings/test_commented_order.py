"""A comment that names the joints says whose the numbered columns are."""

import shlex

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers import read_recording

JOINTS = ("shoulder_joint", "elbow_joint", "wrist_joint")
OTHER = (2, 0, 1)  # places of the robot's joints in the log
ORDER = [JOINTS[k] for k in OTHER]
TIME = np.arange(30) / 10.0
POSITION = np.column_stack([np.sin(TIME), 0.2 * TIME, np.cos(TIME)])
TORQUE = 3.0 * POSITION + 1.0


def write(folder, comment, order=OTHER, word="q_{}", first=1):
    names = [word, word.replace("q", "tau")]
    numbers = range(first, first + 3)
    header = ["time", *(name.format(k) for name in names for k in numbers)]
    places = list(order)
    table = np.column_stack([TIME, POSITION[:, places], TORQUE[:, places]])
    rows = [",".join(map(repr, row)) for row in table.tolist()]
    file = folder / "log.csv"
    file.write_text("\n".join([*comment, ",".join(header), *rows]) + "\n")
    return file


def read(file, **channels):
    guess = guess_columns(file, KnownColumns(JOINTS, channels))
    log = read_recording(file, guess.joints, guess.columns)
    np.testing.assert_array_equal(log.position, POSITION)
    np.testing.assert_array_equal(log.torque, TORQUE)


@pytest.mark.parametrize("first", [0, 1])
def test_another_order_is_answered_with_the_columns_of_each_joint(tmp_path, first):
    file = write(tmp_path, ["# run 3", f"# joints: {', '.join(ORDER)}"], first=first)
    with pytest.raises(RecordingError, match="names the joints in another") as caught:
        guess_columns(file, KnownColumns(JOINTS))
    words = shlex.split(caught.value.options)
    assert words[::2] == ["--position", "--torque"]
    read(file, position=words[1], torque=words[3])


@pytest.mark.parametrize(
    "comment",
    [
        [f"# joints: {', '.join(JOINTS)}"],
        ["# joints: wrist_joint, elbow_joint"],  # not all
        [f"# a: {', '.join(ORDER)}", f"# b: {', '.join(ORDER[::-1])}"],  # no one order
    ],
)
def test_the_robots_order_and_other_comments_change_nothing(tmp_path, comment):
    read(write(tmp_path, comment, order=range(3)))


def test_columns_with_the_joints_names_are_no_question(tmp_path):
    file = write(tmp_path, [f"# joints: {', '.join(ORDER)}"])
    text = file.read_text()
    for k, joint in enumerate(ORDER, 1):
        text = text.replace(f"q_{k}", f"{joint}_q").replace(f"tau_{k}", f"{joint}_tau")
    file.write_text(text)
    read(file)
