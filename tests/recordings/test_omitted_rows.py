"""A broken row is named by the number that leaves it out, and leaving it out mends."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import Columns, read_recording, recording_from
from consistent_id.recordings.readers.recording_file import LogRows
from consistent_id.recordings.readers.used_rows import broken_samples
from consistent_id.recordings.recording import Recording

SAMPLES = 400
COLUMNS = Columns(torque="tau_{joint}")


def _lines():
    time = np.arange(SAMPLES) / 100
    rows = [f"{t:.2f},{np.sin(t):.6f},{np.cos(t):.6f}" for t in time]
    return ["# made by hand", "time,q_elbow,tau_elbow", *rows]


def _with(tmp_path, changed):
    """Write the log with some rows, counted from 1, replaced by other text."""
    lines = _lines()
    for row, text in changed.items():
        lines[row + 1] = text
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    return path


def _advised(read):
    """Return the rows that the refusal names, in the form of both ways to say them."""
    with pytest.raises(RecordingError) as refused:
        read()
    found = re.search(r"--omit ([\d,]+) \(omit = \[(.*?)\]", str(refused.value))
    if found is None:
        return str(refused.value), []
    rows = [int(row) for row in found[1].split(",")]
    assert rows == [int(row) for row in found[2].split(",")]
    return str(refused.value), rows


def _whole(tmp_path):
    return read_recording(_with(tmp_path, {}), ["elbow"], COLUMNS)


@pytest.mark.parametrize(
    "text",
    ["1.49,,0.1", ",,", "1.49,1e5", "1.49,nan,0", "1.49,x,0", "9999,0,0", "-7,0,0"],
)
def test_a_row_that_cannot_be_read_is_left_out_by_the_number_in_the_message(
    tmp_path, text
):
    whole = _whole(tmp_path)
    path = _with(tmp_path, {150: text})
    message, rows = _advised(lambda: read_recording(path, ["elbow"], COLUMNS))
    assert rows == [150] and message.startswith((str(path), "log.csv"))
    log = read_recording(path, ["elbow"], COLUMNS, omit=rows)
    kept = np.delete(np.arange(SAMPLES), 149)
    np.testing.assert_array_equal(log.time, whole.time[kept])
    np.testing.assert_array_equal(log.torque, whole.torque[kept])


def test_a_message_of_a_text_file_has_the_row_and_the_line(tmp_path):
    path = _with(tmp_path, {150: "1.49,,0.1"})
    with pytest.raises(RecordingError, match=r"row 150 \(line 152\), column 'q_elbow'"):
        read_recording(path, ["elbow"], COLUMNS)


def test_all_broken_rows_are_named_at_once_and_count_as_in_the_file(tmp_path):
    path = _with(tmp_path, {3: "0.02,,1", 90: "0.89", 200: "nan,0,0", 310: "2e99,0,0"})
    read = {"omit": ()}
    seen = []
    while True:
        try:
            log = read_recording(path, ["elbow"], COLUMNS, **read)
            break
        except RecordingError as refused:
            advice = re.search(r"--omit ([\d,]+)", str(refused))[1].split(",")
            read["omit"] = (*read["omit"], *map(int, advice))
            seen.append(sorted(read["omit"]))
    assert seen == [[3, 90], [3, 90, 200, 310]]
    assert len(log) == SAMPLES - 4


@pytest.mark.parametrize("piece", [2**22, 1000])
def test_rows_read_in_pieces_are_left_out_alike(tmp_path, monkeypatch, piece):
    monkeypatch.setattr("consistent_id.recordings.readers.table_text.PIECE", piece)
    path = _with(tmp_path, {3: "x,,1", 90: "0.89", 310: "x"})
    rows = LogRows(path, ("elbow",), COLUMNS)
    message, advised = _advised(lambda: np.concatenate(list(rows.times())))
    assert 3 in advised and "row 3 (line 5)" in message
    rows = LogRows(path, ("elbow",), COLUMNS, omit=(90, 3, 310))
    whole = read_recording(path, ["elbow"], COLUMNS, omit=(90, 3, 310))
    np.testing.assert_array_equal(np.concatenate(list(rows.times())), whole.time)
    for part, first in zip(rows.windows([(0, 200), (200, 397)]), (0, 200), strict=True):
        wanted = whole.position[first : first + len(part)]
        np.testing.assert_array_equal(part.position, wanted)


def test_a_window_names_the_rows_of_the_file(tmp_path):
    path = _with(tmp_path, {3: "0.02,,1", 310: "3.09,nan,0"})
    rows = LogRows(path, ("elbow",), COLUMNS, omit=(3,))
    assert _advised(lambda: list(rows.windows([(200, 399)])))[1] == [310]


def test_a_wild_first_stamp_is_mended_by_the_rows_that_are_named(tmp_path):
    """What stands before it belongs to another time, and would leave a gap."""
    lines = [f"{50 + row / 100:.2f},0,0" for row in range(SAMPLES)]
    changed = dict(enumerate(lines, start=1)) | {1: "0,0,0", 2: "2.7e154,0,0"}
    path = _with(tmp_path, changed)
    rows = _advised(lambda: read_recording(path, ["elbow"], COLUMNS))[1]
    assert rows == [1, 2]
    log = read_recording(path, ["elbow"], COLUMNS, omit=rows)
    assert np.diff(log.time).max() < 0.011
    alone = read_recording(path, ["elbow"], COLUMNS, omit=[2])
    assert np.diff(alone.time).max() > 49.0  # the gap that leaving out one row left


def test_a_good_row_before_a_wild_one_is_kept(tmp_path):
    path = _with(tmp_path, {2: "2.7e154,0,0"})
    assert _advised(lambda: read_recording(path, ["elbow"], COLUMNS))[1] == [2]


@pytest.mark.parametrize("kind", ["parquet", "frame"])
def test_a_missing_value_of_any_table_is_left_out_by_its_row(tmp_path, kind):
    time = np.arange(SAMPLES) / 100
    table = {"time": time, "q_elbow": np.sin(time), "tau_elbow": np.cos(time)}
    table["q_elbow"][149] = np.nan

    def read(**options):
        if kind == "frame":
            return recording_from(table, ["elbow"], COLUMNS, **options)
        pq.write_table(pa.table(table), tmp_path / "log.parquet")
        return read_recording(tmp_path / "log.parquet", ["elbow"], COLUMNS, **options)

    assert _advised(lambda: read(omit=[7]))[1] == [150]
    assert len(read(omit=[7, 150])) == SAMPLES - 2


def test_rows_are_not_named_where_leaving_them_out_mends_nothing(tmp_path):
    back = {row: f"{row / 100 - 3:.2f},0,0" for row in range(341, SAMPLES + 1)}
    path = _with(tmp_path, back)  # the clock starts again, for too short a recording
    assert not _advised(lambda: read_recording(path, ["elbow"], COLUMNS))[1]
    many = {row: ",," for row in range(100, 150)}
    path = _with(tmp_path, many)
    assert not _advised(lambda: read_recording(path, ["elbow"], COLUMNS))[1]


def test_broken_samples_are_those_that_a_random_fault_broke():
    rng = np.random.default_rng(0)
    for _ in range(200):
        time = 10.0 + np.arange(60) * 0.01
        broken = np.sort(rng.choice(60, 3, replace=False))
        # Far from the log's clock, so that the faulty stamps cannot fit between others.
        time[broken] = rng.choice([np.nan, np.inf, -5.0, 1e3, 1e200], 3)
        np.testing.assert_array_equal(broken_samples(time, []), broken)


@pytest.mark.parametrize("unit", ["s", "ns"])
def test_a_wild_stamp_in_a_clock_of_seconds_is_no_other_unit(unit):
    time = np.arange(60) * {"s": 0.01, "ns": 1e7}[unit]
    time += 1e13 * (unit == "ns")
    time[1] = 2.7e154
    table = {"time": time, "q_elbow": np.sin(time), "tau_elbow": np.cos(time)}
    with pytest.raises(RecordingError) as refused:
        recording_from(table, ["elbow"], COLUMNS)
    said = str(refused.value)
    assert ("State the unit: --units time=ns" in said) == (unit == "ns")
    assert ("that stamp is broken" in said) == (unit == "s")
    if unit == "s":
        assert refused.value.options == "--omit 2"


@pytest.mark.parametrize("late", [-0.02, 0.02])
def test_a_stamp_that_jitters_back_begins_no_recording(late, caplog):
    """It was read as two recordings, three seconds apart."""
    time = np.arange(400) * 0.008
    time[200] += late
    table = {"time": time, "q_elbow": np.sin(time), "tau_elbow": np.cos(time)}
    with pytest.raises(RecordingError, match="must increase") as refused:
        recording_from(table, ["elbow"], COLUMNS)
    assert refused.value.options == "--omit 201"
    assert not caplog.text
    assert len(recording_from(table, ["elbow"], COLUMNS, omit=[201])) == 399


@pytest.mark.parametrize("nothing", ["", "nan", "NA"])
def test_rows_with_missing_values_are_left_out_when_asked(tmp_path, nothing):
    """A table of two topics has rows in which only the other topic has values."""
    lines = ["time,q_elbow,tau_elbow,other"]
    for k in range(SAMPLES):
        t = k / 100
        lines.append(f"{t:.3f},{np.sin(t):.6f},{np.cos(t):.6f},{nothing}")
        lines.append(f"{t + 0.004:.3f},{nothing},{nothing},1")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError) as refused:
        read_recording(path, ["elbow"], COLUMNS)
    assert refused.value.options == ("--missing omit" if nothing != "NA" else "")
    log = read_recording(path, ["elbow"], COLUMNS, missing="omit")
    whole = _whole(tmp_path)
    np.testing.assert_array_equal(log.time, whole.time)
    np.testing.assert_array_equal(log.torque, whole.torque)


def test_channels_that_are_never_complete_together_are_refused():
    nan = np.nan
    table = {"time": [0.0, 0.1], "q_elbow": [1.0, nan], "tau_elbow": [nan, 1.0]}
    with pytest.raises(RecordingError, match=r"no row of 2 has all.*1, 1 complete"):
        recording_from(
            {k: np.array(v) for k, v in table.items()},
            ["elbow"],
            COLUMNS,
            missing="omit",
        )


@pytest.mark.parametrize(
    ("channel", "said"),
    [
        ("torque", "torque of b has no value in any row.*--torque-joints a$"),
        ("position", "position of b has no value in any row: record it"),
    ],
)
def test_a_joint_without_any_value_is_named(tmp_path, channel, said):
    file = tmp_path / "log.csv"
    header = "time,q_a,q_b,tau_a,tau_b"
    row = "0.1,0.2,0.3," if channel == "torque" else "0.1,,0.3,0.4"
    file.write_text("\n".join([header, *(f"{k},{row}" for k in range(9))]))
    columns = Columns(position="q_{joint}", torque="tau_{joint}")
    with pytest.raises(RecordingError, match=said) as refused:
        read_recording(file, ["a", "b"], columns, missing="omit")
    known = "--torque-joints a" if channel == "torque" else ""
    assert refused.value.options == known


@pytest.mark.parametrize(
    ("rate", "periods"), [(100.0, 4), (1000.0, 5), (62.5, 8), (1024.0, 4)]
)
def test_rounded_stamps_are_answered_with_the_rate(rate, periods):
    time = np.floor(np.arange(int(rate * periods)) / rate)
    position = np.arange(len(time))[:, None]
    with pytest.raises(RecordingError, match="stamps are rounded") as refused:
        Recording(("a",), time, position)
    assert refused.value.options == f"--time {rate:g}Hz"


@pytest.mark.parametrize(
    ("time", "position"),
    [
        ([0, 0, 0, 0, 1], range(5)),  # few
        ([0, 0, 1, 1], range(4)),
        (np.repeat(range(9), 8), np.repeat(range(9), 8)),  # rows are repeated
        ([*[0] * 200, *range(1, 60)], range(259)),  # stuck at first
    ],
)
def test_other_repeated_stamps_are_answered_with_the_first_of_them(time, position):
    time, position = np.array(time, float), np.array(position, float)
    with pytest.raises(RecordingError, match="must increase") as refused:
        Recording(("a",), time, position[:, None])
    assert refused.value.options == "--duplicates first"


@pytest.mark.parametrize("stamp", ["nan", "inf", "1e9", "0.0"])
def test_a_broken_stamp_is_answered_with_the_row_to_leave_out(tmp_path, stamp):
    log = tmp_path / "log.csv"
    rows = [f"{0.01 * k:.2f},{k}" for k in range(40)]
    rows[20] = f"{stamp},20"
    log.write_text("\n".join(["time,q", *rows]))
    with pytest.raises(RecordingError, match="leave it out: --omit 21") as caught:
        read_recording(log, ["a"], Columns(position="q"))
    assert caught.value.options == "--omit 21"
    assert len(read_recording(log, ["a"], Columns(position="q"), omit=[21])) == 39
