"""Feather and Arrow IPC: what pyarrow wrote is read, and what it did not is refused."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather

from consistent_id import Columns, RecordingError, read_recording
from consistent_id.recordings.readers.recording_file import column_names

TIME = np.arange(5) / 3
VALUES = np.random.default_rng(0).normal(size=(5, 4))
TABLE = pa.table(
    {
        "note": list("abcde"),
        "tau_elbow": VALUES[:, 3].astype(np.float32),
        "q_wrist": VALUES[:, 1],
        "q_elbow": VALUES[:, 0],
        "time": TIME,
    }
)
COLUMNS = Columns(torque="tau_{joint}", torque_joints=["elbow"])


def as_feather(path, table, compression="uncompressed"):
    feather.write_feather(table, str(path), compression=compression, chunksize=2)


def as_compressed(path, table):
    as_feather(path, table, "lz4")


def as_file(path, table):
    with pa.ipc.new_file(str(path), table.schema) as writer:
        writer.write_table(table, max_chunksize=2)


def as_stream(path, table):
    with pa.ipc.new_stream(str(path), table.schema) as writer:
        writer.write_table(table, max_chunksize=2)


@pytest.mark.parametrize("suffix", ["feather", "arrow"])
@pytest.mark.parametrize("write", [as_feather, as_compressed, as_file, as_stream])
def test_what_pyarrow_wrote_is_read_to_the_last_bit(tmp_path, write, suffix):
    path = tmp_path / f"log.{suffix}"
    write(path, TABLE)
    log = read_recording(path, ["elbow", "wrist"], COLUMNS)
    np.testing.assert_array_equal(log.time, TIME)
    np.testing.assert_array_equal(log.position, VALUES[:, :2])
    np.testing.assert_array_equal(log.torque[:, 0], VALUES[:, 3].astype(np.float32))
    assert not log.torque[:, 1].any()
    assert log.name == path.name
    assert column_names(path) == tuple(TABLE.column_names)


def test_a_recording_outlives_its_file(tmp_path):
    path = tmp_path / "log.feather"
    as_feather(path, TABLE)
    log = read_recording(path, ["wrist"])
    path.write_bytes(b"")
    np.testing.assert_array_equal(log.position[:, 0], VALUES[:, 1])


FAULTY = {
    "missing": (TABLE.drop_columns("q_wrist"), "no column 'q_wrist'; .*q_elbow"),
    "twice": (TABLE.append_column("time", [TIME]), "column 'time' occurs twice"),
    "text": (
        TABLE.set_column(2, "q_wrist", [list("abcde")]),
        "column 'q_wrist' holds string, expected numbers",
    ),
    "gap": (
        TABLE.set_column(2, "q_wrist", [[0.0, None, 1.0, 2.0, 3.0]]),
        "position of joint 'wrist' is nan at sample 1",
    ),
}


@pytest.mark.parametrize(("table", "message"), FAULTY.values(), ids=FAULTY)
@pytest.mark.parametrize("write", [as_file, as_stream])
def test_columns_that_cannot_be_used_are_refused(tmp_path, write, table, message):
    path = tmp_path / "log.feather"
    write(path, table)
    with pytest.raises(RecordingError, match=rf"log\.feather: .*{message}"):
        read_recording(path, ["elbow", "wrist"])


@pytest.mark.parametrize(
    "content", [b"", b"ARROW1", b"FEA1" + bytes(40), b"time,q_wrist\n0,1\n1,2\n" * 9]
)
def test_a_file_that_is_not_arrows_is_refused(tmp_path, content):
    path = tmp_path / "log.arrow"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"log\.arrow: not readable as Feather"):
        read_recording(path, ["wrist"])


@pytest.mark.parametrize("write", [as_feather, as_compressed, as_stream])
def test_damaged_files_are_refused_or_read(tmp_path, write):
    path, rng = tmp_path / "log.feather", np.random.default_rng(1)
    write(path, TABLE)
    whole = path.read_bytes()
    for trial in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 4):
            damaged[place] = rng.integers(256)
        end = rng.integers(len(whole)) if trial % 3 == 0 else len(whole)
        path.write_bytes(damaged[:end])
        try:
            read_recording(path, ["elbow", "wrist"], COLUMNS)
        except RecordingError as refusal:
            assert "log.feather" in str(refusal)
