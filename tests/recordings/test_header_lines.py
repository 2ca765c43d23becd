"""Headers of several lines, and lines above a table, name the columns."""

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import read_recording
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.readers.csv import array_names, read_arrays, read_batches

JOINTS = ("hip", "knee")
NAMES = "time,q_hip,q_knee,tau_hip,tau_knee"
ROWS = np.column_stack([np.arange(5.0), np.arange(20.0).reshape(5, 4)])


def write(folder, *header, mark=",", rows=ROWS):
    file = folder / "log.csv"
    lines = [*header, *(",".join(map(str, row)) for row in rows)]
    file.write_text("\n".join(lines).replace(",", mark) + "\n")
    return file


def read(file):
    guess = guess_columns(file, KnownColumns(JOINTS))
    return read_recording(file, guess.joints, guess.columns)


def assert_is_read(file, position=1.0):
    log = read(file)
    np.testing.assert_allclose(log.time, ROWS[:, 0])
    np.testing.assert_allclose(log.position, position * ROWS[:, 1:3])
    np.testing.assert_allclose(log.torque, ROWS[:, 3:])


_OF_LABVIEW = (
    "LabVIEW Measurement,",
    "Decimal_Separator,.",
    "***End_of_Header***,",
    ",",
    "Channels,4,,,,,",
    "Samples,5,5,5,5,,",
    "X0,0,0,0,0,,",
    "Delta_X,1,1,1,1,,",
    "***End_of_Header***,,,,,,",
)


@pytest.mark.parametrize("more", ["", ",Comment"])
def test_the_table_of_labview_is_below_its_settings(tmp_path, more):
    """Its settings have rows of numbers, too; its rows lack the column of comments."""
    assert_is_read(write(tmp_path, *_OF_LABVIEW, NAMES + more, mark="\t"))


@pytest.mark.parametrize("mark", ["//", "%", "!"])
@pytest.mark.parametrize("above", [[], ["recorded by, jo"]])
def test_a_mark_of_a_comment_is_no_name_among_spaces(tmp_path, mark, above):
    above = [f"{mark} {line}" for line in above]
    assert_is_read(write(tmp_path, *above, f"{mark} {NAMES}", mark=" "))


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_settings_above_the_names_are_not_read(tmp_path, mark):
    above = ["Measurement,arm 1", "Rate,100", "", "Remarks"]
    file = write(tmp_path, *above, NAMES, mark=mark)
    assert_is_read(file)
    (note,) = log_format(file).notes(file)
    said = "line 5 names the columns: time, q_hip, q_knee, tau_hip, ..."
    assert note == f"log.csv: {said}"


def test_lines_with_as_many_fields_are_no_names(tmp_path):
    assert_is_read(write(tmp_path, "Measurement,arm 1,,,", "By,me,,,", NAMES))


@pytest.mark.parametrize(
    ("units", "position"),
    [("s,rad,rad,Nm,Nm", 1.0), ("[s],[deg],[deg],[Nm],[Nm]", np.pi / 180.0)],
)
def test_a_row_of_units_below_the_names_is_read(tmp_path, units, position):
    assert_is_read(write(tmp_path, NAMES, units), position)
    assert_is_read(write(tmp_path, "Measurement: 7", NAMES, units), position)


@pytest.mark.parametrize(
    "header",
    [
        (",position,,effort,", "time,hip,knee,hip,knee"),
        ("time,position,position,effort,effort", ",hip,knee,hip,knee"),
        (",position,position,effort,effort", ",hip,knee,hip,knee", "time,,,,"),
    ],
)
def test_words_above_the_joints_are_a_part_of_the_names(tmp_path, header):
    file = write(tmp_path, *header)
    names = ("position hip", "position knee", "effort hip", "effort knee")
    assert array_names(file) == ("time", *names)
    assert_is_read(file)


def test_rows_and_lines_keep_their_numbers(tmp_path):
    rows = [list(map(str, row)) for row in ROWS]
    rows[2][1] = "ERR"
    file = write(tmp_path, "By me", NAMES, rows=rows)
    with pytest.raises(RecordingError, match=r"row 3 \(line 5\), column 'q_hip'"):
        read(file)


def test_it_is_read_in_pieces_as_a_whole(tmp_path):
    file = write(tmp_path, "By me", NAMES, "ms,deg,deg,Nm,Nm")
    names = array_names(file)
    assert names[:2] == ("time [ms]", "q_hip [deg]")
    (piece,) = read_batches(file, names, 0)
    whole = read_arrays(file, names)
    assert all(np.array_equal(piece[name], whole[name]) for name in names)


@pytest.mark.parametrize(
    "row", ["x,ERR,ERR,ERR,ERR", "0,ERR,ERR,ERR,ERR", "NA" + ",NA" * 4]
)
def test_a_faulty_first_row_is_no_header(tmp_path, row):
    file = write(tmp_path, NAMES, row)
    assert array_names(file) == tuple(NAMES.split(","))
    with pytest.raises(RecordingError, match="row 1"):
        read(file)


def test_a_line_that_states_the_separator_is_above_decimal_commas(tmp_path):
    """Such rows have more commas than semicolons."""
    log = tmp_path / "log.csv"
    log.write_text("sep=;\nt;q1;tau1\n0,5;1,5;2,25\n1,5;2,5;3,25\n2,5;3,5;4,25\n")
    assert array_names(log) == ("t", "q1", "tau1")
    read = read_arrays(log, ["tau1"])["tau1"]
    assert read.tolist() == [2.25, 3.25, 4.25]


def test_a_column_without_values_does_not_hide_the_clock(tmp_path):
    log = tmp_path / "log.lvm"
    rows = [f"{k}\t{k}.5\t3\t\n" for k in range(9)]
    log.write_text("".join(["X_Value\tq1\ttau1\tComment\n", *rows]))
    with pytest.raises(RecordingError, match="X_Value counts up by 1"):
        guess_columns(log, KnownColumns(("a",)))


def test_a_first_row_without_its_last_value_is_no_separator_at_the_end(tmp_path):
    """Numbers of rows without a name would be the clock."""
    log = tmp_path / "log.csv"
    log.write_text("t,q_a,tau_a\n0,0.0,1,\n1,0.1,2,3\n2,0.2,2,3\n")
    columns = Columns("t", "q_{joint}", torque="tau_{joint}")
    with pytest.raises(RecordingError, match="4 fields, the header has 3"):
        read_recording(log, ("a",), columns, missing="omit")
