"""Tables in memory: data frames, Arrow tables, mappings of arrays, open files."""

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import Columns, recording_from
from consistent_id.recordings.readers.data_frames import table_names

JOINTS = ("elbow", "wrist")
SAMPLES = 5
TIME = np.arange(SAMPLES) * 0.1
VALUES = np.random.default_rng(0).normal(size=(SAMPLES, 3))
ARRAY = Columns("t", "q", array_joints=("base", "wrist", "elbow"))


TABLE = {"time": TIME, "q_elbow": TIME, "q_wrist": -TIME, "note": ["x"] * SAMPLES}


@pytest.mark.parametrize(
    "make", [dict, pd.DataFrame, pa.table, lambda t: pd.DataFrame(t).convert_dtypes()]
)
def test_tables_in_memory_are_read_by_name(make):
    log = recording_from(make(TABLE), JOINTS[::-1], name="memory")
    np.testing.assert_array_equal(log.position, np.c_[-TIME, TIME])
    assert (log.name, log.joints) == ("memory", JOINTS[::-1])


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (pd.DataFrame(), "the table has no columns"),
        (pd.DataFrame(VALUES), "the table has columns named 0, 1, 2, expected"),
        (pd.DataFrame(np.hstack([VALUES, VALUES])), "named 0, 1, 2, ..., expected"),
    ],
)
def test_a_table_without_names_of_columns_is_named_so(table, said):
    with pytest.raises(RecordingError, match=said):
        table_names(table, "memory")


def test_a_mapping_may_hold_arrays_of_all_joints():
    log = recording_from({"t": TIME, "q": VALUES.T}, JOINTS, ARRAY)
    np.testing.assert_array_equal(log.position, VALUES[:, [2, 1]])


def test_an_open_file_is_a_mapping(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.update({name: TABLE[name] for name in ("time", "q_elbow", "q_wrist")})
    np.savez(tmp_path / "log.npz", **TABLE)
    with h5py.File(tmp_path / "log.h5") as file:
        np.testing.assert_array_equal(recording_from(file, JOINTS).time, TIME)
    with np.load(tmp_path / "log.npz") as file:
        np.testing.assert_array_equal(recording_from(file, JOINTS).time, TIME)


def frame(**columns):
    return pd.DataFrame({"time": TIME, "q_elbow": TIME} | columns)


BAD_TABLES = {
    "missing": (frame().drop(columns="time"), "no column 'time'; known: q_elbow"),
    "twice": (pd.concat([frame(), frame()], axis=1), "'time' occurs twice"),
    "dates": (
        frame(time=pd.date_range("2020", periods=5)),
        "datetime64.*timedelta64\\(1, 's'",
    ),
    "durations": (frame(time=pd.timedelta_range(0, periods=5)), "holds timedelta64"),
    "text": (frame(q_elbow=list("12345")), "'q_elbow' holds object"),
    "logical": (frame(q_elbow=[True] * 5), "'q_elbow' holds bool"),
    "gap": (frame(q_elbow=[1, 2, None, 4, 5]), "'elbow' is nan at sample 2"),
    "back in time": (frame(time=TIME[::-1]), "time goes from 0.4 s"),
    "masked": ({"time": np.ma.array(TIME, mask=TIME > 0.3), "q_elbow": TIME}, "masked"),
    "ragged": (
        {"time": [[1], [1, 2]], "q_elbow": TIME},
        "'time' is not an array of num",
    ),
    "scalar": ({"time": 1.0, "q_elbow": TIME}, r"'time' has shape \(\), expected one"),
    "no names": ([TIME, TIME], "list has neither columns nor keys"),
    "indexed": (frame().set_index("time"), r"'time' is the index.*reset_index\(\)"),
    "numbered": (pd.DataFrame(VALUES), "no column 'time'; known: 0"),
}


@pytest.mark.parametrize(("table", "message"), BAD_TABLES.values(), ids=BAD_TABLES)
def test_tables_that_do_not_fit_are_refused(table, message):
    with pytest.raises(RecordingError, match=f"table.*{message}"):
        recording_from(table, ["elbow"])


@pytest.mark.parametrize("array", [False, True])
def test_torque_that_the_log_does_not_have_is_not_read(array):
    motion = {"time": [0.0, 0.5, 1.0], "q": np.ones((3, 2)), "tau": [[np.nan, 2.0]] * 3}
    columns = Columns(
        position="q", torque="tau", array_joints=("a", "b"), torque_joints=("b",)
    )
    if not array:
        motion = {"time": motion["time"], "q_a": [1, 1, 1], "q_b": [1, 1, 1]}
        motion["tau_b"] = [2.0, 2.0, 2.0]
        columns = Columns(torque="tau_{joint}", torque_joints=("b",))
    log = recording_from(motion, ["a", "b"], columns, torque_gain=[3.0, 3.0])
    assert log.torque.tolist() == [[0.0, 6.0]] * 3


def test_torque_of_a_joint_that_is_not_read_is_refused():
    columns = Columns(torque="tau_{joint}", torque_joints=("elbow",))
    with pytest.raises(RecordingError, match="torque_joints: no joint 'elbow'"):
        recording_from({"time": [0, 1], "q_a": [0, 1]}, ["a"], columns)
