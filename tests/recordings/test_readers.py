"""A file becomes a Recording, or a RecordingError that says where it is faulty."""

import csv

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.recording import Recording

JOINTS = ("elbow", "wrist")
CHANNELS = ("position", "velocity", "acceleration", "torque")
ALL = Columns("t", *(f"{channel}_{{joint}}" for channel in CHANNELS))
# Seeds explicit: hypothesis derives its examples from the test's own source.
REPEATABLE = settings(derandomize=True, deadline=None, max_examples=60)


def table(values):
    """Columns by name, last channel first, with a text column that nobody wants."""
    names = [f"{channel}_{joint}" for channel in CHANNELS for joint in JOINTS]
    columns = {"note": ["free text"] * values.shape[1]}
    columns |= dict(zip(reversed(names), reversed(values), strict=True))
    return columns | {"t": np.arange(values.shape[1]) * 0.1}


def write(path, columns):
    if path.suffix == ".parquet":
        pq.write_table(pa.table(columns), path)
        return path
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def parquet(tmp_path, names=("time", "q_elbow"), *, elbow, time=(0.0, 1.0)):
    columns = [pa.array(time), elbow, *[elbow] * (len(names) - 2)]
    path = tmp_path / "log.parquet"
    pq.write_table(pa.Table.from_arrays(columns, names=list(names)), path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["csv", "parquet"])
@settings(REPEATABLE, max_examples=25)
@given(values=arrays(np.float64, (8, 3), elements=st.floats(allow_nan=False, width=32)))
def test_what_was_written_is_read_to_the_last_bit(tmp_path_factory, ending, values):
    values = np.where(np.isfinite(values), values, 0.1)
    path = write(tmp_path_factory.mktemp("round") / f"log.{ending}", table(values))
    log = read_recording(path, JOINTS, ALL)
    np.testing.assert_array_equal(log.time, np.arange(3) * 0.1)
    for place, channel in enumerate(CHANNELS):
        expected = values[2 * place : 2 * place + 2].T
        np.testing.assert_array_equal(getattr(log, channel), expected)
    assert (log.joints, log.name) == (JOINTS, path.name)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_joints_are_read_in_the_order_asked_for_and_no_others(tmp_path, ending):
    values = np.arange(24.0).reshape(8, 3)
    path = write(tmp_path / f"log.{ending}", table(values))
    log = read_recording(str(path), ["wrist"], ALL)
    np.testing.assert_array_equal(log.velocity, values[3:4].T)
    back = read_recording(path, JOINTS[::-1], Columns("t", "torque_{joint}"))
    np.testing.assert_array_equal(back.position, values[[7, 6]].T)
    assert back.velocity is back.acceleration is back.torque is None


def test_numbers_in_patterns_count_the_joints_asked_for_from_one(tmp_path):
    path = written(tmp_path, "time,q1,q02x\n0,1,2\n1,3,4\n")
    log = read_recording(path, ["wrist"], Columns(position="q{number}"))
    np.testing.assert_array_equal(log.position, [[1], [3]])
    columns = Columns(position="q{number:02d}x")
    with pytest.raises(RecordingError, match=r"log\.csv: no column 'q01x'"):
        read_recording(path, JOINTS, columns)


@pytest.mark.parametrize("gain", [-2.0, [10.0, 0.5]])
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_the_gain_multiplies_torque_only_joint_by_joint(tmp_path, ending, gain):
    values = np.arange(24.0).reshape(8, 3)
    path = write(tmp_path / f"log.{ending}", table(values))
    log = read_recording(path, JOINTS, ALL, torque_gain=gain)
    np.testing.assert_array_equal(log.torque, values[6:].T * gain)
    np.testing.assert_array_equal(log.position, values[:2].T)


def test_a_gain_that_is_not_finite_is_refused(tmp_path):
    path = write(tmp_path / "log.csv", table(np.zeros((8, 3))))
    with pytest.raises(RecordingError, match=r"torque_gain: entry \(1,\) is nan"):
        read_recording(path, JOINTS, ALL, torque_gain=[1.0, np.nan])


@pytest.mark.parametrize(
    "text",
    [
        b"\xef\xbb\xbftime,q_elbow\n0,1\n1,2\n",  # byte-order mark, as Excel writes
        "time,q_elbow\r\n0,1\r\n1,2\r\n",
        "time,q_elbow\r0,1\r1,2\r",
        '"time",  q_elbow \n"0",1\n\n1, 2',
        "q_elbow,é,time\n1e0,-,+0\n+.2E+1,-,1.\n\n",
        "time,q_elbow,\n0,1,\n1,2,\n",
    ],
)
def test_the_dialects_of_csv_are_read_alike(tmp_path, text):
    log = read_recording(written(tmp_path, text), ["elbow"])
    np.testing.assert_array_equal(log.time, [0, 1])
    np.testing.assert_array_equal(log.position, [[1], [2]])


FAULTY_CSV = {
    "missing column": ("time,q_elbov,x\n0,1,2\n", "no column 'q_elbow'.*: q_elbov"),
    "no time": ("t,q_elbow\n0,1\n1,2\n", "no column 'time'; known: "),
    "repeated column": ("time,q_elbow,q_elbow\n0,1,1\n", "'q_elbow' occurs twi"),
    "unit row": (
        "time,q_elbow\ns,rad\n0,1\n",
        "row 1 \\(line 2\\), column 'time': 's' is not a n",
    ),
    "text": (
        "time,q_elbow\n0,1\n1,ten\n",
        "row 2 \\(line 3\\), column 'q_elbow': 'ten'",
    ),
    "empty field": (
        "time,q_elbow\n0,\n1,2\n",
        "row 1 \\(line 2\\), column 'q_elbow' is empty",
    ),
    "blank line counts": (
        "time,q_elbow\n0,1\n\nx,1\n",
        "row 2 \\(line 4\\), column 'time': 'x'",
    ),
    "decimal comma": (
        "time,q_elbow\n0,1\n0,5,2\n",
        "row 2 \\(line 3\\): 3 fields, the header has",
    ),
    "quoted thousands": (
        'time,q_elbow\n"0,500",1\n',
        r"row 1 \(line 2\), column 'time': '0,500'.*'\.'",
    ),
    "spaces": ("time q_elbow\n0 1 2\n", r"row 1 \(line 2\): 3 fields, .* has 2"),
    "short row": (
        "time,q_elbow\n0,1\n1\n",
        "row 2 \\(line 3\\): 1 fields, the header has 2",
    ),
    "empty": ("", "no column 'time'; there are none"),
    "header only": ("time,q_elbow\n", "no row below the header"),
    "one sample": ("time,q_elbow\n0,1\n", "1 samples, expected 2"),
    "nan": ("time,q_elbow\n0,1\n1,nan\n", "position of joint 'elbow' is nan at sample"),
    "overflow": ("time,q_elbow\n0,1\n1,1e999\n", "joint 'elbow' is inf at sample 1"),
    "time": ("time,q_elbow\n0,1\n0,2\n", r"time goes from 0 s \(sample 0\) to 0 s"),
    "no text": (b"time,q_elbow\x00\xff\n0,1\n", "not readable as CSV"),
    "half of utf-16": ("time,q_elbow\n0".encode("utf-16")[:-1], "not readable as CSV"),
    "binary": (bytes(range(256)) * 8, "not readable as CSV"),
    "zeros": (bytes(64), "no column 'time'"),
    "one huge field": ("time,q_elbow\n0," + "x" * 200_000, "not readable as CSV"),
}


@pytest.mark.parametrize(("text", "message"), FAULTY_CSV.values(), ids=FAULTY_CSV)
def test_a_faulty_csv_is_refused_with_file_and_place(tmp_path, text, message):
    with pytest.raises(RecordingError, match=rf"log\.csv.*{message}"):
        read_recording(written(tmp_path, text), ["elbow"])


FIELD = st.sampled_from(
    "0 1 -2.5 3e1 1e9 nan inf , ,, ; \" ' \n \r\n \t x é".split(" ")
)
FREE_TEXT = st.text(alphabet='01234.,-+eE"\n\r nainf;\x00\ufeffé', max_size=40)
# All that UTF-8 can write, without hypothesis' trying it, which takes a second.
ANY_TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


@pytest.mark.slow
@REPEATABLE
@given(
    st.sampled_from(["", "time,q_elbow\n", "q_elbow,time,x\n"]),
    st.lists(FIELD, max_size=20).map(",".join) | FREE_TEXT | ANY_TEXT,
)
def test_any_text_is_a_recording_or_a_recording_error(tmp_path_factory, header, text):
    path = tmp_path_factory.getbasetemp() / "fuzz.csv"
    path.write_text(header + text, encoding="utf-8", errors="replace", newline="")
    try:
        log = read_recording(path, ["elbow"])
    except RecordingError as refusal:
        assert "fuzz.csv" in str(refusal)
    else:
        assert isinstance(log, Recording) and np.isfinite(log.position).all()


@pytest.mark.parametrize("name", ["none.csv", "none.parquet", "no/folder.csv"])
def test_a_missing_file_is_refused(tmp_path, name):
    with pytest.raises(RecordingError, match=f"{name}: no such file"):
        read_recording(tmp_path / name, JOINTS)


@pytest.mark.parametrize("name", ["log.doc", "log"])
def test_an_ending_that_cannot_be_read_is_refused(tmp_path, name):
    path = written(tmp_path, "time,q_elbow\n0,1\n1,2\n", name)
    with pytest.raises(
        RecordingError, match=rf"{name}: cannot read .*\.csv, .*folder of a ROS bag"
    ):
        read_recording(path, ["elbow"])


@pytest.mark.parametrize(
    "pattern", ["{}", "{0}", "{name}", "{joint", "joint}", "{joint!x}", "{joint:d}"]
)
def test_a_bad_pattern_is_refused_before_the_file_is_opened(tmp_path, pattern):
    with pytest.raises(RecordingError, match=r"{joint}, {number}, {index} and a range"):
        read_recording(tmp_path / "none.csv", JOINTS, Columns(position=pattern))


def test_a_pattern_that_does_not_tell_joints_apart_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="'q' gives one name for several"):
        read_recording(tmp_path / "none.csv", JOINTS, Columns(position="q"))


@pytest.mark.parametrize("kind", [pa.float32(), pa.int16(), pa.uint64()])
def test_every_numeric_type_of_parquet_is_read(tmp_path, kind):
    path = parquet(tmp_path, elbow=pa.array([3, 4], kind), time=[0, 1])
    log = read_recording(path, ["elbow"])
    np.testing.assert_array_equal(log.position, [[3.0], [4.0]])


@pytest.mark.parametrize(
    ("elbow", "message"),
    [
        (pa.array(["1", "x"]), "column 'q_elbow' holds string, expected numbers"),
        (pa.array([[1.0], [2.0, 3.0]]), "column 'q_elbow' holds lists of diff"),
        (pa.array([True, False]), "column 'q_elbow' holds bool, expected numbers"),
        (pa.array([1.0, None]), "position of joint 'elbow' is nan at sample 1"),
        (pa.array([None, 2]), "position of joint 'elbow' is nan at sample 0"),
    ],
)
def test_parquet_columns_without_numbers_are_refused(tmp_path, elbow, message):
    with pytest.raises(RecordingError, match=rf"log\.parquet: .*{message}"):
        read_recording(parquet(tmp_path, elbow=elbow), ["elbow"])


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("time", "q_elbov"), "no column 'q_elbow'; known: q_elbov"),
        (("time", "q_elbow", "q_elbow"), "column 'q_elbow' occurs twice"),
    ],
)
def test_missing_and_repeated_parquet_columns_are_refused(tmp_path, names, message):
    path = parquet(tmp_path, names, elbow=pa.array([1.0, 2.0]))
    with pytest.raises(RecordingError, match=rf"log\.parquet: {message}"):
        read_recording(path, ["elbow"])


@pytest.mark.parametrize("keep", [0, 4, 100, -1])
def test_a_cut_parquet_file_is_refused(tmp_path, keep):
    path = parquet(tmp_path, elbow=pa.array([1.0, 2.0]))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(RecordingError, match=r"log\.parquet: not readable as Parquet"):
        read_recording(path, ["elbow"])


@pytest.mark.parametrize(
    ("name", "advice"),
    [("log.pkl", "run any code"), ("log.csv.gz", "unpack"), ("log.xlsx", "as CSV")],
)
def test_files_that_are_not_read_have_advice(tmp_path, name, advice):
    with pytest.raises(RecordingError, match=advice):
        read_recording(tmp_path / name, JOINTS)
