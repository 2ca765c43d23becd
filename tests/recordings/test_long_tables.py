"""Tables with a row for each joint and instant are read side by side."""

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.readers.csv import read_arrays, read_batches
from consistent_id.recordings.readers.recording_file import column_names

JOINTS = ("shoulder", "elbow", "wrist")
TIME = np.arange(60) / 50.0


def position(time):
    return np.column_stack([np.sin(time), 0.3 * time, np.cos(2.0 * time)])


def effort(time):
    return 10.0 * position(time) + 1.0


def rows(names=JOINTS, late=0.0):
    """Rows of time, joint, position and effort; each joint is later by `late`."""
    return [
        (f"{t + j * late:.6f}", name, *(f"{x(t + j * late)[0, j]:.9f}" for x in BOTH))
        for t in TIME
        for j, name in enumerate(names)
    ]


BOTH = (lambda t: position(np.array([t])), lambda t: effort(np.array([t])))


def write(folder, lines, header="time,joint,position,effort", mark=","):
    file = folder / "log.csv"
    text = "\n".join(mark.join(line) for line in lines)
    file.write_text(f"{header.replace(',', mark)}\n{text}\n")
    return file


def read(file, joints=JOINTS, **known):
    guess = guess_columns(file, KnownColumns(joints, known))
    return read_recording(file, guess.joints, guess.columns)


def assert_is_the_motion(log, tolerance=1e-8):
    assert log.joints == JOINTS
    np.testing.assert_allclose(log.position, position(log.time), atol=tolerance)
    np.testing.assert_allclose(log.torque, effort(log.time), atol=10 * tolerance)


def in_blocks(lines):
    return sorted(lines, key=lambda line: JOINTS.index(line[1]))


@pytest.mark.parametrize("order", [list, in_blocks])
@pytest.mark.parametrize("header", ["time,joint,position,effort", "t,name,q,tau"])
def test_rows_of_joints_are_read_side_by_side(tmp_path, order, header):
    log = read(write(tmp_path, order(rows()), header))
    assert len(log) == len(TIME)
    assert_is_the_motion(log)


def test_the_note_says_so(tmp_path):
    file = write(tmp_path, rows())
    (note,) = log_format(file).notes(file)
    assert note == (
        "log.csv has a row for each instant and each of shoulder, elbow, wrist: they "
        "are read side by side"
    )


def test_decimal_commas_and_semicolons(tmp_path):
    lines = [[cell.replace(".", ",") for cell in line] for line in rows()]
    assert_is_the_motion(read(write(tmp_path, lines, mark=";")))


def test_instants_that_lack_a_joint_are_left_out(tmp_path):
    file = write(tmp_path, [line for k, line in enumerate(rows()) if k not in (4, 30)])
    log = read(file)
    assert len(log) == len(TIME) - 2
    assert_is_the_motion(log)
    (note,) = log_format(file).notes(file)
    assert note.endswith("; 2 instants that lack some of them are left out")


def test_stamps_that_differ_by_joint_are_interpolated(tmp_path):
    file = write(tmp_path, rows(late=0.002))
    log = read(file)
    assert_is_the_motion(log, tolerance=2e-4)
    (note,) = log_format(file).notes(file)
    assert "interpolated to the stamps of shoulder" in note


def test_nothing_is_interpolated_over_a_gap(tmp_path):
    """The elbow's messages stop for half a second."""
    gone = [
        line
        for line in rows(late=0.002)
        if not (line[1] == "elbow" and 0.3 < float(line[0]) < 0.8)
    ]
    log = read(write(tmp_path, gone))
    assert not ((log.time > 0.32) & (log.time < 0.78)).any()
    assert_is_the_motion(log, tolerance=2e-4)


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_count_the_joints(tmp_path, first):
    names = [str(first + k) for k in range(3)]
    file = write(tmp_path, rows(names), "time,joint_id,pos,torque")
    assert_is_the_motion(read(file))


def test_a_unit_of_a_column_stays_one(tmp_path):
    file = write(tmp_path, rows(), "time,joint,position [deg],effort")
    log = read(file)
    np.testing.assert_allclose(log.position, np.radians(position(log.time)), atol=1e-9)


def test_signals_with_values(tmp_path):
    lines = [
        (line[0], f"{word}_{line[1]}", value)
        for line in rows()
        for word, value in zip(("q", "tau"), line[2:], strict=True)
    ]
    assert_is_the_motion(read(write(tmp_path, lines, "time,signal,value")))


@pytest.mark.parametrize("key", ["topic", "label"])
def test_signals_of_a_plot_are_read(tmp_path, key):
    """Foxglove writes the path of each plotted value, beside clocks and a topic."""
    lines = [
        [f"{t:.6f}", f"{1e9 + t:.6f}", "/arm", f"/joint_states.{word}[{j}]", f"{v:.9f}"]
        for word, values in (("position", position(TIME)), ("effort", effort(TIME)))
        for t, row in zip(TIME, values, strict=True)
        for j, v in enumerate(row)
    ]
    header = f"elapsed time,receive time,robot name,{key},value"
    assert_is_the_motion(read(write(tmp_path, lines, header)))


def test_a_table_without_a_clock(tmp_path):
    lines = [line[1:] for line in rows()]
    file = write(tmp_path, lines, "joint,position,effort")
    assert_is_the_motion(read(file, time="50Hz"))


def test_a_broken_last_row_is_left_out(tmp_path):
    file = write(tmp_path, [*rows(), ("1.2", "should")])
    assert_is_the_motion(read(file))


def test_it_is_read_in_pieces_as_a_whole(tmp_path):
    file = write(tmp_path, in_blocks(rows()))
    names = column_names(file)
    (piece,) = read_batches(file, names, 0)
    whole = read_arrays(file, names)
    assert all(np.array_equal(piece[name], whole[name]) for name in names)


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        ("name", lambda k: "ab"[k % 2]),
        ("name", lambda k: "ab"[k > 30]),
        ("state", lambda k: ["move", "rest"][k % 2]),
        ("motor_id", lambda k: str(k % 3)),
        ("joint", lambda k: str(k % 3)),
    ],
)
def test_a_text_or_number_beside_wide_columns_is_no_joint(tmp_path, name, cell):
    values = np.hstack([position(TIME), effort(TIME)])
    lines = [
        (f"{t}", cell(k), *map(repr, map(float, row)))
        for k, (t, row) in enumerate(zip(TIME, values, strict=True))
    ]
    numbers = ",".join(f"{word}{k}" for word in ("q", "tau") for k in (1, 2, 3))
    file = write(tmp_path, lines, f"time,{name},{numbers}")
    assert column_names(file) == ("time", name, *numbers.split(","))
    assert log_format(file).notes(file) == ()
    assert_is_the_motion(read(file))


def test_a_text_beside_the_columns_of_two_joints_is_no_joint(tmp_path):
    lines = [
        (f"{t}", "ab"[k % 2], *map(str, position(np.array([t]))[0]))
        for k, t in enumerate(TIME)
    ]
    file = write(tmp_path, lines, "time,name,hip_pos,knee_pos,effort")
    assert column_names(file)[:3] == ("time", "name", "hip_pos")


def test_a_fault_in_a_long_table_names_no_line_of_the_file(tmp_path):
    """Its rows are those of instants, which --omit counts, too."""
    rows = [f"{k / 10},{j},{k},1" for k in range(40) for j in ("a", "b")]
    rows[21] = rows[21].replace(",1", ",ERR")
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["time,joint,position,effort", *rows]))
    columns = Columns(position="{joint}.position", torque="{joint}.effort")
    with pytest.raises(RecordingError, match=r"row 11 \(of the table") as caught:
        read_recording(log, ("a", "b"), columns)
    assert "(line" not in str(caught.value)
    assert caught.value.options == "--omit 11"
    assert len(read_recording(log, ("a", "b"), columns, omit=[11])) == 39
