"""Records of JSON, in a list or in lines, are arrays."""

import json

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import (
    Columns,
    json_records,
    read_recording,
)

RECORDS = [{"t": 0.1 * k, "state": {"q": [0.5 * k, -k], "on": True}} for k in range(9)]


@pytest.mark.parametrize("form", ["lines", "list", "object"])
def test_records_of_json_are_arrays(tmp_path, form):
    path = tmp_path / ("log.jsonl" if form == "lines" else "log.json")
    if form == "lines":
        path.write_text("\n".join(map(json.dumps, RECORDS)) + "\n\n")
    elif form == "list":
        path.write_text(json.dumps(RECORDS))
    else:
        whole = {"t": [r["t"] for r in RECORDS], "name": "run 1"}
        whole["state"] = {"q": [r["state"]["q"] for r in RECORDS]}
        path.write_text(json.dumps(whole))
    columns = Columns("t", "state.q", array_joints=("a", "b"))
    log = read_recording(path, ["b", "a"], columns)
    np.testing.assert_array_equal(log.time, [r["t"] for r in RECORDS])
    expected = [r["state"]["q"][::-1] for r in RECORDS]
    np.testing.assert_array_equal(log.position, expected)


@pytest.mark.parametrize("text", ["[1, 2]", "{", "3", '"t"', "[]", '[{"t": 1}, 2]'])
def test_json_without_records_is_refused(tmp_path, text):
    path = tmp_path / "log.json"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"log\.json"):
        read_recording(path, ["a"], Columns("t", "q_{joint}"))


def test_a_flag_among_numbers_of_json_is_missing(tmp_path):
    """It was 1.0, in silence; lists of flags are flags."""
    path = tmp_path / "log.json"
    path.write_text(
        '{"time": [0, 1, 2], "q": [0.5, true, 0.7], "on": [true, false, true]}'
    )
    with pytest.raises(RecordingError, match="nan at sample 1") as refused:
        read_recording(path, ["a"], Columns(position="q"))
    assert refused.value.options == "--missing omit"
    with pytest.raises(RecordingError, match="'on' holds bool"):
        read_recording(path, ["a"], Columns(position="on"))


def test_numbers_that_are_nan_as_python_writes_them_are_read(tmp_path):
    path = tmp_path / "log.json"
    path.write_text(json.dumps({"time": [0, 1, 2], "q": [0.5, float("nan"), 0.7]}))
    assert "NaN" in path.read_text()
    columns = Columns(position="q")
    log = read_recording(path, ["a"], columns, missing="omit")
    assert log.position.ravel().tolist() == [0.5, 0.7]


def test_records_in_lines_are_read_whatever_the_ending(tmp_path):
    lines = [json.dumps({"time": k, "q": 0.5 * k}) for k in range(3)]
    for name in ("log.json", "log.jsonl"):
        (tmp_path / name).write_text("\n".join(lines))
        log = read_recording(tmp_path / name, ["a"], Columns(position="q"))
        assert log.position.ravel().tolist() == [0.0, 0.5, 1.0]
    (tmp_path / "log.jsonl").write_text("\n".join(lines)[:-3])
    with pytest.raises(RecordingError, match=r"line 3: .* cut off: delete it"):
        read_recording(tmp_path / "log.jsonl", ["a"], Columns(position="q"))


def test_numbers_of_records_may_be_texts(tmp_path):
    """Such columns were missing, also from the names that messages list."""
    path = tmp_path / "log.jsonl"
    records = [{"time": f"{k}", "q": f"{0.5 * k}", "mode": "1a"} for k in range(3)]
    path.write_text("\n".join(map(json.dumps, records)))
    assert json_records.array_names(path) == ("time", "q")
    log = read_recording(path, ["a"], Columns(position="q"))
    assert log.position.ravel().tolist() == [0.0, 0.5, 1.0]
