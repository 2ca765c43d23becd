"""Any dialect of CSV gives the same numbers, and the fast way those of the exact."""

import time
from pathlib import Path

import numpy as np
import pytest
from elbow_files import refused, written
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import (
    Columns,
    csv,
    read_recording,
    table_text,
)
from consistent_id.recordings.readers.csv_header import CsvHeader
from consistent_id.recordings.readers.used_rows import UsedRows

REPEATABLE = settings(derandomize=True, deadline=None, max_examples=60)
NUMBER = st.floats(allow_nan=False, allow_infinity=False, width=64)
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t"}


@pytest.mark.slow
@REPEATABLE
@given(
    values=st.lists(st.tuples(NUMBER, NUMBER), min_size=2, max_size=5),
    separator=st.sampled_from(list(SEPARATORS.values())),
    decimal_comma=st.booleans(),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    quote=st.booleans(),
    space=st.sampled_from(["", " "]),
    note=st.sampled_from(["", "on", "1.5", "é", "a b"]),
    comments=st.integers(0, 2),
    last_end=st.booleans(),
)
def test_every_dialect_is_read_to_the_last_bit(
    tmp_path_factory,
    values,
    separator,
    decimal_comma,
    end,
    quote,
    space,
    note,
    comments,
    last_end,
):
    def number(value):
        mark = "," if decimal_comma and separator != "," else "."
        text = repr(float(value)).replace(".", mark)
        return f'"{text}"' if quote else space + text

    rows = [["time", "note", "q_elbow", "tau_elbow"]]
    for place, (q, tau) in enumerate(values):
        rows.append([number(place / 7), note, number(q), number(tau)])
    lines = ["# recorded by hand; 1,2"] * comments + [separator.join(r) for r in rows]
    text = end.join(lines) + end * last_end
    path = written(tmp_path_factory.getbasetemp(), text, "dialect.csv")
    log = read_recording(path, ["elbow"], Columns(torque="tau_{joint}"))
    np.testing.assert_array_equal(log.time, np.arange(len(values)) / 7)
    np.testing.assert_array_equal(np.c_[log.position, log.torque], values)


NUMERALS = "0 1 -2.5 3e1 1,5 1.5 ,5 5. nan inf Infinity +1 1_0 0x1 1d3 1e999 - ٣ x"
ODD = ["", " ", " 1 ", "\t1", "\x0b1", "\x1c1", "1\x00", "#1", "\u00a01", "é"]
ODD += ['"1"', ' "1"', '"1"2', '"1,5"', ' "a,b"', '"a\nb"', '"', '""']
CELL = st.sampled_from([*NUMERALS.split(" "), *ODD])


@pytest.mark.slow
@settings(REPEATABLE, max_examples=150)
@given(
    separator=st.sampled_from(list(SEPARATORS.values())),
    rows=st.lists(st.lists(CELL, min_size=2, max_size=3), min_size=1, max_size=3),
    end=st.sampled_from(["\n", "\r\n", "\r", "\n\n", "\n \n"]),
)
def test_the_fast_way_never_differs_from_the_exact_way(separator, rows, end):
    body = end.join(separator.join(row) for row in rows)
    header = CsvHeader(("a", "b"), separator, 1, 0)
    fast = csv._fast(body, header, [1, 0])
    if fast is not None:
        exact = csv._exact(Path("log.csv"), body, header, [1, 0], UsedRows())
        np.testing.assert_array_equal(fast, exact.numbers)
        assert not exact.flags


@pytest.mark.parametrize("note", ['"a, b"', '"a\nb"', '"say ""so"""'])
def test_quoted_fields_are_read_the_fast_way_or_not_at_all(note):
    """Some rows end within a quoted line end where PyArrow cuts its blocks of 1 MB."""
    rows = 60_000
    body = "".join(f'"{k}",{note},{k}.5\n' for k in range(rows))
    fast = csv._fast(body, CsvHeader(("a", "note", "b"), ",", 1, 0), [2, 0])
    if fast is None:
        assert "\n" in note
        return
    np.testing.assert_array_equal(fast[:, 1], np.arange(rows))
    np.testing.assert_array_equal(fast[:, 0], np.arange(rows) + 0.5)


@pytest.mark.parametrize("separator", SEPARATORS.values(), ids=SEPARATORS)
def test_plain_numbers_are_read_the_fast_way(separator):
    body = f"0{separator}1.5\r\n\r\n2{separator}-3e1\r\n".replace(
        ".", "." if separator == "," else ","
    )
    header = CsvHeader(("a", "b"), separator, 1, 0)
    np.testing.assert_array_equal(
        csv._fast(body, header, [1, 0]), [[1.5, 0], [-30.0, 2]]
    )


@pytest.mark.slow
@REPEATABLE
@given(
    values=st.lists(st.tuples(NUMBER, NUMBER), min_size=2, max_size=5),
    decimal_comma=st.booleans(),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    gaps=st.lists(st.integers(1, 5), min_size=2, max_size=2),
    margins=st.lists(st.integers(0, 3), min_size=2, max_size=2),
)
def test_any_number_of_spaces_separates(
    tmp_path_factory, values, decimal_comma, end, gaps, margins
):
    def line(cells):
        between = (" " * gap for gap in (*gaps, 0))
        cells = [cell + gap for cell, gap in zip(cells, between, strict=True)]
        return " " * margins[0] + "".join(cells) + " " * margins[1]

    mark = "," if decimal_comma else "."
    lines = [line(["time", "q_elbow", "tau_elbow"])]
    for place, row in enumerate(values):
        lines.append(line([repr(float(v)).replace(".", mark) for v in (place, *row)]))
    path = written(tmp_path_factory.mktemp("log"), end.join(lines), "log.txt")
    log = read_recording(path, ["elbow"], Columns(torque="tau_{joint}"))
    np.testing.assert_array_equal(log.position[:, 0], [q for q, _ in values])
    np.testing.assert_array_equal(log.torque[:, 0], [tau for _, tau in values])


def test_a_log_of_universal_robots_real_time_data_is_read(tmp_path):
    text = "timestamp actual_q_0 actual_q_1\n12.002 1e-3 -2\n12.004 2e-3 -3\n"
    columns = Columns("timestamp", "actual_q_{index}")
    log = read_recording(written(tmp_path, text), ["a", "b"], columns)
    assert log.time.tolist() == [12.002, 12.004]
    assert log.position.tolist() == [[0.001, -2.0], [0.002, -3.0]]


def test_spaces_in_names_do_not_separate(tmp_path):
    text = "time;q elbow\n0;1\n1;2\n"
    columns = Columns("time", "q {joint}")
    log = read_recording(written(tmp_path, text), ["elbow"], columns)
    assert log.position[:, 0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("encoding", "said"),
    [("utf-8", 0), ("utf-8-sig", 0), ("utf-16", 1), ("latin-1", 1)],
)
def test_other_encodings_are_read_and_said(tmp_path, monkeypatch, encoding, said):
    text = "temps;q elbow [°]\n0;90\n1;180\n2;270\n"
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode(encoding))
    names = ["temps", "q elbow [°]"]
    assert csv.array_names(path) == tuple(names)
    assert len(csv.notes(path)) == said
    whole = csv.read_arrays(path, names)
    assert whole["q elbow [°]"].tolist() == [90.0, 180.0, 270.0]
    monkeypatch.setattr(
        table_text, "PIECE", 20
    )  # with the first letter that is not ASCII
    pieces = list(csv.read_batches(path, names, 1))
    assert np.concatenate([p["temps"] for p in pieces]).tolist() == [1.0, 2.0]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("ends", [(0, 1), (1, 0), (1, 1)])
def test_a_separator_may_end_names_or_rows(tmp_path, separator, ends):
    lines = ["time,q_elbow,tau_elbow", "0,1.5,3", "1,2.5,4", "2,3.5,5"]
    of_names, of_rows = ("," * end for end in ends)
    whole = [line + (of_rows if k else of_names) for k, line in enumerate(lines)]
    path = written(tmp_path, "\n".join(whole).replace(",", separator) + "\n")
    log = read_recording(path, ["elbow"], Columns(torque="tau_{joint}"))
    assert log.position[:, 0].tolist() == [1.5, 2.5, 3.5]
    assert log.torque[:, 0].tolist() == [3.0, 4.0, 5.0]
    names = [name for name in csv.array_names(path) if name]
    pieces = list(csv.read_batches(path, names, 1))
    assert np.concatenate([p["q_elbow"] for p in pieces]).tolist() == [2.5, 3.5]


@pytest.mark.parametrize("separator", [" ", ","])
def test_the_numbers_of_rows_that_r_writes_have_no_name(tmp_path, separator):
    rows = [f'"{k}",{0.1 * k},{k + 0.5}' for k in range(1, 4)]
    text = "\n".join(['"time","q_elbow"', *rows]).replace(",", separator)
    log = read_recording(written(tmp_path, text + "\n"), ["elbow"])
    np.testing.assert_allclose(log.time, [0.1, 0.2, 0.3])
    assert log.position[:, 0].tolist() == [1.5, 2.5, 3.5]
    without = text.replace('"1"', "1").replace('"2"', "2")  # a name is missing
    refused(tmp_path, without, "3 fields, the header has 2")


def test_quoted_decimal_commas_stand_beside_commas(tmp_path):
    text = 'time,q_elbow\n"0,00","1,5"\n"0,01","-2,125"\n"0,02","3"\n'
    log = read_recording(written(tmp_path, text), ["elbow"])
    assert log.time.tolist() == [0.0, 0.01, 0.02]
    assert log.position[:, 0].tolist() == [1.5, -2.125, 3.0]


def test_a_word_in_place_of_a_number_is_answered_with_missing_values(tmp_path):
    refused(tmp_path, "time,q_elbow\n0,n/a\n1,2\n", "--missing omit")


def test_quoted_thousands_are_not_read_as_decimals(tmp_path):
    text = 'time,q_elbow\n"0","1,024"\n"1","2,048"\n'
    refused(tmp_path, text, "'1,024' is not a number")


def test_columns_of_a_file_without_header_are_numbered(tmp_path):
    path = written(tmp_path, "0.5,1,2\n1.5,2,3\n")
    assert csv.array_names(path) == ("column1", "column2", "column3")
    assert "no header" in csv.notes(path)[0]
    read = csv.read_arrays(path, ["column3", "column1"])
    assert read["column3"].tolist() == [2.0, 3.0]
    assert read["column1"].tolist() == [0.5, 1.5]


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"\x89PNG\x00\x01\xff,\n\xff\n")
    with pytest.raises(RecordingError, match=r"not readable as CSV.*Save the file"):
        csv.array_names(path)


@pytest.mark.parametrize("ending", ["csv", "tsv"])
def test_tabs_separate_in_both_endings(tmp_path, ending):
    path = written(tmp_path, "time\tq_elbow\n0\t1\n1\t2\n", f"log.{ending}")
    np.testing.assert_array_equal(read_recording(path, ["elbow"]).position, [[1], [2]])


def test_the_header_may_be_the_last_comment(tmp_path):
    path = tmp_path / "log.csv"
    np.savetxt(path, [[0, 1], [1, 2]], delimiter=",", header="by hand\ntime,q_elbow")
    np.testing.assert_array_equal(read_recording(path, ["elbow"]).position, [[1], [2]])


def test_names_of_the_log_are_mapped_to_joints(tmp_path):
    path = written(tmp_path, "t,A1.pos,A2.pos\n0,1,2\n1,3,4\n")
    columns = Columns("t", "{joint}.pos", names={"A1": "shoulder", "A2": "elbow"})
    log = read_recording(path, ["elbow", "shoulder"], columns)
    np.testing.assert_array_equal(log.position, [[2, 1], [4, 3]])


def test_a_name_that_belongs_to_another_joint_is_not_taken(tmp_path):
    path = written(tmp_path, "time,q_a,q_b\n0,1,2\n1,3,4\n")
    with pytest.raises(RecordingError, match="'a' of the log is joint 'b'"):
        read_recording(path, ["a"], Columns(names={"a": "b"}))
    swapped = Columns(names={"a": "b", "b": "a"})
    log = read_recording(path, ["a", "b"], swapped)
    np.testing.assert_array_equal(log.position, [[2, 1], [4, 3]])


def test_one_joint_under_two_names_is_refused():
    with pytest.raises(RecordingError, match="several names"):
        Columns(names={"x": "a", "y": "a"})


@pytest.mark.parametrize(
    "pattern",
    [
        "q_{joint}_deg",
        "q_{joint} [deg]",
        "q_deg_{joint}",
        "{joint}(DEG)",
        "q{number}_mm",
    ],
)
def test_a_position_in_another_unit_is_refused_by_its_name(tmp_path, pattern):
    refused(tmp_path, "", "contains .*not converted", Columns(position=pattern))


@pytest.mark.parametrize("name", ["time_ms", "t [ns]", "stamp_us", "time (µs)"])
def test_a_time_in_another_unit_is_refused_by_its_name(tmp_path, name):
    refused(tmp_path, "", "contains .*not converted", Columns(time=name))


@pytest.mark.parametrize(
    "pattern", ["dq_{joint} [deg/s]", "{joint}_rpm", "v_deg_per_s"]
)
def test_a_rate_in_another_unit_is_refused_by_its_name(tmp_path, pattern):
    refused(tmp_path, "", "contains .*not converted", Columns(velocity=pattern))


def test_units_of_joint_names_and_of_torque_are_left_alone(tmp_path):
    path = written(tmp_path, "time [s],q_arm_deg,i_arm_deg [A]_deg\n0,1,2\n1,3,4\n")
    columns = Columns("time [s]", "q_{joint}", torque="i_{joint} [A]_deg")
    read_recording(path, ["arm_deg"], columns)


UNIT_ROW = (
    "row 1 \\(line 2\\), column 'time': 's' is not a number"
    ".*units \\('s', 'rad'\\): values are read"
)
FAULTY = {
    "unit row": ("time,q_elbow\ns,rad\n0,1\n", UNIT_ROW),
    "unit row, semicolons": ("time;q_elbow\ns;rad\n0;1\n", UNIT_ROW),
    "text further down": (
        "time;q_elbow\n0;1\nend;log\n",
        "row 2 \\(line 3\\), column 'time': 'end'",
    ),
    "both marks": (
        "time;q_elbow\n0,5;1\n1.5;2\n",
        "row 2 \\(line 3\\), column 'time': '1.5'.*','",
    ),
    "both marks in a row": (
        "time;q_elbow\n0,5;1.5\n",
        "row 1 \\(line 2\\), column 'q_elbow': '1.5'",
    ),
    "point, then comma": (
        "time\tq_elbow\n0.5\t1\n1\t1,234\n",
        "'1,234' is.*'\\.' marks",
    ),
    "thousands": (
        "time;q_elbow\n0;1.234,5\n",
        "row 1 \\(line 2\\), column 'q_elbow': '1.234,5'",
    ),
    "more thousands": (
        "time;q_elbow\n0;1,234,567\n",
        "row 1 \\(line 2\\), column 'q_elbow': '1,23",
    ),
    "comments count": (
        "# a\n# b\ntime,q_elbow\n0,1\nx,1\n",
        "row 2 \\(line 5\\), column 'time'",
    ),
    "comment below": (
        "time,q_elbow\n0,1\n#\n1,2\n",
        "row 2 \\(line 3\\): 1 fields, the header",
    ),
    "comment as header": (
        "# time,q_elbow\n0,1\nx,1\n",
        "row 2 \\(line 3\\), column 'time': 'x'",
    ),
    "quoted line ends": (
        'time,q_elbow,"a\nb"\n0,1,2\nx,1,2\n',
        "row 2 \\(line 4\\), column 'time'",
    ),
    "two separators": (
        "time,q_elbow,;time;q_elbow\n0,1,2\n",
        "with each of ',' and ';'",
    ),
    "ragged to and fro": (
        "time,q_elbow\n0,1,2\n1\n",
        "row 1 \\(line 2\\): 3 fields, the header",
    ),
    "twice": ("time;q_elbow;q_elbow\n0;1;1\n", "'q_elbow' occurs twice"),
    "other separator": ("time;q_elbov\n0;1\n", "no column 'q_elbow'; known: q_elbov"),
    "commas for all": ("time,q_elbow\n0,5,1,0\n", "4 fields.*If commas mark decimals"),
    "no header": ("0,1\n1,2\n", "no column 'time'; known: column1, column2"),
    "empty cell": (
        "time,q_elbow\n0,1\n1,\n",
        "row 2 \\(line 3\\), column 'q_elbow' is empty",
    ),
    "a huge line": (
        "time,q_elbow\n0," + "x" * 200_000 + "\n1,1",
        "not readable as CSV",
    ),
}


@pytest.mark.parametrize(("text", "message"), FAULTY.values(), ids=FAULTY)
def test_a_faulty_dialect_is_refused_with_row_and_column(tmp_path, text, message):
    refused(tmp_path, text, message)


def test_free_text_with_points_stands_beside_decimal_commas(tmp_path):
    text = "time;day;q_elbow\n0,5;1.2.2020;1\n1,5;2.2.2020;2\n"
    log = read_recording(written(tmp_path, text), ["elbow"])
    np.testing.assert_array_equal(log.time, [0.5, 1.5])


@pytest.mark.slow
def test_a_fault_in_the_last_row_of_a_long_log_is_found(tmp_path):
    rows = "".join(f"{k},{k}.5,x\n" for k in range(20_000))
    text = "time,q_elbow,note\n" + rows
    log = read_recording(written(tmp_path, text), ["elbow"])
    np.testing.assert_array_equal(log.position[:, 0], np.arange(20_000) + 0.5)
    refused(
        tmp_path,
        text + "20000,1;5,x\n",
        "row 20001 \\(line 20002\\), column 'q_elbow': '1;5'",
    )


@pytest.mark.slow
def test_a_long_log_is_read_in_well_under_a_second(tmp_path):
    rng = np.random.default_rng(0)
    names = [f"{channel}_{k}" for channel in ("q", "dq", "tau") for k in range(6)]
    values = np.c_[np.arange(20_000) * 1e-3, rng.normal(size=(20_000, 18))]
    path = tmp_path / "log.csv"
    header = ",".join(["time", *names])
    np.savetxt(path, values, "%.17g", delimiter=",", header=header, comments="")
    columns = Columns(velocity="dq_{joint}", torque="tau_{joint}")
    start = time.process_time()
    log = read_recording(path, [str(k) for k in range(6)], columns)
    # A fifth of 1e5 rows; 0.12 s were measured, by the exact way alone 0.25 s.
    assert time.process_time() - start < 1.0
    read = np.c_[log.time, log.position, log.velocity, log.torque]
    np.testing.assert_array_equal(read, values)


def test_a_clock_that_begins_again_separates_recordings_of_one_file(tmp_path, caplog):
    time = np.concatenate([np.arange(150) * 0.01, np.arange(120) * 0.01])
    rows = np.column_stack([time, np.sin(time), np.cos(time)])
    path = tmp_path / "twice.csv"
    np.savetxt(path, rows, delimiter=",", header="time,q,tau", comments="")
    columns = Columns(position="q", torque="tau")
    log = read_recording(path, ("a",), columns)
    assert len(log) == 270
    assert log.time[150] - log.time[149] == pytest.approx(3.0)
    assert log.time[-1] == pytest.approx(1.49 + 3.0 + 1.19)
    assert "goes back at row 151" in caplog.text
    # A part this short is no recording, but a fault.
    np.savetxt(path, rows[:200], delimiter=",", header="time,q,tau", comments="")
    with pytest.raises(RecordingError, match="must increase"):
        read_recording(path, ("a",), columns)


@pytest.mark.slow
@pytest.mark.parametrize("separator", SEPARATORS.values(), ids=SEPARATORS)
def test_a_header_may_be_longer_than_a_field_of_the_csv_module(tmp_path, separator):
    count = csv.csv.field_size_limit() // 6
    names = ["time", *(f"q{k:05}" for k in range(count))]
    rows = [separator.join([str(k), *["2"] * count]) for k in range(2)]
    path = written(tmp_path, "\n".join([separator.join(names), *rows]))
    assert csv.array_names(path) == tuple(names)
    found = csv.read_arrays(path, ["time", names[-1]])
    assert [values.tolist() for values in found.values()] == [[0.0, 1.0], [2.0, 2.0]]


def test_a_row_of_units_is_left_out_by_the_option_that_is_named(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,q_a\ns,rad\n0,1\n1,3\n")
    columns = Columns(position="q_{joint}")
    with pytest.raises(RecordingError, match=r"units \('s', 'rad'\)") as refused:
        read_recording(file, ["a"], columns)
    assert refused.value.options == "--omit 1"
    log = read_recording(file, ["a"], columns, omit=[1])
    assert log.position.tolist() == [[1.0], [3.0]]


def test_a_row_of_other_units_is_not_just_left_out(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,q_a\ns,deg\n0,1\n1,3\n")
    with pytest.raises(RecordingError, match="only if --units states them") as refused:
        read_recording(file, ["a"], Columns(position="q_{joint}"))
    assert refused.value.options == ""


def test_a_broken_last_row_is_left_out_by_the_option_that_is_named(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,q_a\n0,1\n1,3\n2,5\n3")
    columns = Columns(position="q_{joint}")
    with pytest.raises(RecordingError, match="1 fields, the header has 2") as refused:
        read_recording(file, ["a"], columns)
    assert refused.value.options == "--omit 4"
