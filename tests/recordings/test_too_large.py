"""A file that does not fit into memory is refused with the way that does."""

import os

import pytest

import consistent_id as ci
from consistent_id._support.files import memory_of_this_computer
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import recording_file

JOINTS = ("a",)


def log(folder):
    path = folder / "log.csv"
    rows = [f"{0.01 * k},{k},0" for k in range(5)]
    path.write_text("\n".join(["time,q_a,tau_a", *rows]))
    return path


COLUMNS = ci.Columns(time="time", position="q_{joint}", torque="tau_{joint}")


def read(path):
    return ci.read_recording(path, JOINTS, COLUMNS)


def test_a_file_larger_than_memory_names_what_streams_it(tmp_path):
    path = log(tmp_path)
    os.truncate(path, memory_of_this_computer())  # its end takes no place on the disk
    with pytest.raises(RecordingError, match="consistent-id compress") as raised:
        read(path)
    assert "stream_regression" in str(raised.value)


def test_half_the_memory_is_the_limit_which_can_be_lifted(tmp_path, monkeypatch):
    path = log(tmp_path)
    room = 2 * path.stat().st_size
    monkeypatch.setattr(recording_file, "memory_of_this_computer", lambda: room)
    assert len(read(path)) == 5
    monkeypatch.setattr(recording_file, "memory_of_this_computer", lambda: room - 1)
    with pytest.raises(RecordingError, match="piece by piece"):
        read(path)
    with ci.large_files():
        assert len(read(path)) == 5
    monkeypatch.setattr(recording_file, "memory_of_this_computer", lambda: None)
    assert len(read(path)) == 5
