"""Dates, times and flags in text are read as numbers, or refused."""

import numpy as np
import pytest
from elbow_files import refused, written

from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import (
    Columns,
    csv,
    read_recording,
)


@pytest.mark.parametrize(("separator", "mark"), [(",", "."), (";", ",")])
@pytest.mark.parametrize("zone", ["", "+00:00", "Z"])
def test_dates_are_seconds(tmp_path, separator, mark, zone):
    stamps = [f"2001-09-09T01:46:40.{half}{zone}" for half in ("000000", "500000")]
    rows = [f"{t}{separator}{q}{mark}5" for t, q in zip(stamps, (1, 2), strict=True)]
    text = "\n".join([f"time{separator}q_elbow", *rows])
    log = read_recording(written(tmp_path, text), ["elbow"])
    assert log.time.tolist() == [1e9, 1e9 + 0.5]  # the well-known round second
    assert log.position[:, 0].tolist() == [1.5, 2.5]


@pytest.mark.parametrize(
    "form", ["20010909T0146{}.5", "2001-09-09_01-46-{}.5", "09-Sep-2001 01:46:{}.5"]
)
def test_further_forms_of_dates_are_seconds(tmp_path, form):
    """Of ISO 8601 without marks, of names of files, of MATLAB."""
    rows = [f"{form.format(40 + k)},{k}.5" for k in range(2)]
    text = "\n".join(["time,q_elbow", *rows])
    log = read_recording(written(tmp_path, text), ["elbow"])
    assert log.time.tolist() == [1e9 + 0.5, 1e9 + 1.5]


def test_a_date_that_is_none_is_refused(tmp_path):
    refused(tmp_path, "time,q_elbow\n2001-13-09T01:46:40,1\n", "is not a number")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("03/04/2026 23:59:50.250", 1772668790.25),  # March, 4th
        ("13/04/2026 00:00:00", 1776038400.0),  # there is no 13th month
        ("3/4/2026 11:59:50 PM", 1772668790.0),
        ("3/4/2026 12:00 AM", 1772582400.0),
        ("3/4/2026 1:00 pm", 1772629200.0),
    ],
)
def test_dates_of_countries_are_seconds(tmp_path, text, seconds):
    file = tmp_path / "log.csv"
    file.write_text(f"time,q_a\n{text},1\n{text.replace('2026', '2027')},2\n")
    log = read_recording(file, ["a"], Columns(position="q_{joint}"))
    assert log.time.tolist() == [seconds, seconds + 365 * 86400.0]


def test_german_dates_stand_beside_decimal_commas(tmp_path):
    file = tmp_path / "log.csv"
    rows = ("04.03.2026 23:59:59,50;1,5", "05.03.2026 00:00:00,25;2,5")
    file.write_text("\n".join(["time;q_a", *rows]))
    log = read_recording(file, ["a"], Columns(position="q_{joint}"))
    assert log.time.tolist() == [1772668799.5, 1772668800.25]
    assert log.position.ravel().tolist() == [1.5, 2.5]


@pytest.mark.parametrize("text", ["31.02.2026 10:00:00", "3/4/2026", "1.2/2026 10:00"])
def test_what_is_no_date_of_a_country_is_refused(tmp_path, text):
    file = tmp_path / "log.csv"
    file.write_text(f"time,q_a\n{text},1\n{text},2\n")
    with pytest.raises(RecordingError, match="is not a number"):
        read_recording(file, ["a"], Columns(position="q_{joint}"))


def dated(folder, *dates):
    file = folder / "log.csv"
    rows = [f"{date},{k}" for k, date in enumerate(dates)]
    file.write_text("time,q1\n" + "\n".join(rows) + "\n")
    return file


@pytest.mark.parametrize(
    ("dates", "steps", "said"),
    [
        (["3/12/2026 23:59:59", "3/13/2026 0:00:00"], [1.0], ""),
        (["12/4/2026 23:59:59", "13/4/2026 0:00:00"], [1.0], ""),
        (["3/4/2026 23:59:59", "3/5/2026 0:00:00"], [1.0], "the month first"),
        (["3/4/2026 23:59:59", "4/4/2026 0:00:00"], [1.0], "the day first"),
        (["3/4/2026 10:00:00", "3/4/2026 10:00:02"], [2.0], "the month first"),
    ],
)
def test_dates_with_slashes_have_one_order(tmp_path, dates, steps, said):
    file = dated(tmp_path, *dates)
    whole = csv.read_arrays(file, ["time"])["time"]
    assert np.diff(whole).tolist() == steps
    pieces = [piece["time"] for piece in csv.read_batches(file, ["time"], 0)]
    assert np.concatenate(pieces).tolist() == whole.tolist()
    notes = log_format(file).notes(file)
    assert [said in note for note in notes] == [True] * bool(said)


def test_dates_of_two_orders_are_refused(tmp_path):
    file = dated(tmp_path, "13/4/2026 10:00:00", "4/13/2026 10:00:01")
    with pytest.raises(RecordingError, match="'4/13/2026 10:00:01' is not a number"):
        csv.read_arrays(file, ["time"])


def test_the_year_may_come_first_beside_slashes(tmp_path):
    file = dated(tmp_path, "2026/04/13 23:59:59.5", "2026/04/14 00:00:00")
    assert np.diff(csv.read_arrays(file, ["time"])["time"]).tolist() == [0.5]


def test_a_column_of_true_and_false_is_one_of_flags(tmp_path):
    """As pandas writes flags, such as the torque enable of a servo."""
    log = tmp_path / "log.csv"
    log.write_text("time,q,enabled\n0,1,True\n1,2,False\n2,3,true\n")
    assert csv.read_arrays(log, ["enabled"])["enabled"].tolist() == [True, False, True]
    (batch,) = csv.read_batches(log, ["time", "enabled"], 1)
    assert batch["enabled"].tolist() == [False, True]
    with pytest.raises(RecordingError, match="'enabled' holds bool, expected numbers"):
        read_recording(log, ["a"], Columns(position="enabled"))


def test_missing_flags_are_numbers(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time,q,enabled\n0,1,True\n1,2,\n2,3,false\n")
    flags = csv.read_arrays(log, ["enabled"], missing="omit")["enabled"]
    np.testing.assert_equal(flags, [1.0, np.nan, 0.0])


@pytest.mark.parametrize("word", ["true", "False"])
def test_a_flag_among_numbers_is_a_fault(tmp_path, word):
    """It was read as 1.0, in silence."""
    log = tmp_path / "log.csv"
    log.write_text(f"time,q\n0,1\n1,{word}\n2,3\n3,4\n")
    with pytest.raises(
        RecordingError, match=r"row 2 \(line 3\), column 'q'"
    ) as refused:
        read_recording(log, ["a"], Columns(position="q"))
    assert f"{word!r} is not a number" in str(refused.value)
    assert refused.value.options == "--omit 2"
    log = read_recording(log, ["a"], Columns(position="q"), omit=[2])
    assert log.position.ravel().tolist() == [1.0, 3.0, 4.0]
