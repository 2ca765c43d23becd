"""One recording in several tables: their clock makes them one."""

from pathlib import Path

import numpy as np
import pytest
from logged import write_arm

from consistent_id import Columns, RecordingError, read_recording
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import Statement
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.log_formats import TABLES, log_format
from consistent_id.recordings.readers import csv, table_folder

TIME = np.arange(5) * 0.1


def table(folder, name, header, *columns):
    values = np.column_stack(columns)
    np.savetxt(folder / name, values, delimiter=",", header=header, comments="")


def test_tables_of_one_clock_are_read_side_by_side_and_others_named(tmp_path):
    table(tmp_path, "position.csv", "t,hip_position", TIME, TIME**2)
    table(tmp_path, "effort.csv", "t,hip_effort", TIME, -TIME)
    table(tmp_path, "wrench.csv", "t,fx", TIME + 0.05, TIME)
    assert log_format(tmp_path) is TABLES
    columns = Columns("t", "{joint}_position", torque="{joint}_effort")
    log = read_recording(tmp_path, ["hip"], columns)
    np.testing.assert_allclose(log.position[:, 0], TIME**2)
    np.testing.assert_allclose(log.torque[:, 0], -TIME)
    (note,) = table_folder.notes(tmp_path)
    assert note.endswith("they have another clock or no table: wrench.csv")


def test_what_is_no_table_is_named_and_a_faulty_clock_is_an_error(tmp_path):
    table(tmp_path, "position.csv", "t,hip_position", TIME, TIME**2)
    table(tmp_path, "effort.csv", "t,hip_effort", TIME, -TIME)
    (tmp_path / "README.txt").write_text("Logs of a hip, in rad.\nBy hand.\n")
    (tmp_path / "empty.csv").touch()
    assert len(table_folder.array_names(tmp_path)) == 3
    assert "no table: README.txt, empty.csv" in table_folder.notes(tmp_path)[0]
    (tmp_path / "wrench.csv").write_text("t,fx\n0,1\nx,2\n")
    with pytest.raises(RecordingError, match="'x' is not a number"):
        table_folder.array_names(tmp_path)


def test_a_text_that_begins_with_the_word_time_is_no_table(tmp_path):
    table(tmp_path, "position.csv", "t,hip_position", TIME, TIME**2)
    table(tmp_path, "effort.csv", "t,hip_effort", TIME, -TIME)
    (tmp_path / "events.txt").write_text("time of start: 10:30\nthe hip moved\n")
    assert table_folder.array_names(tmp_path) == ("t", "hip_effort", "hip_position")
    assert "no table: events.txt" in table_folder.notes(tmp_path)[0]
    # A table of a channel is not left out, if no row of it can be read.
    (tmp_path / "velocity.csv").write_text("time,hip_velocity\na,1\nb,2\n")
    with pytest.raises(RecordingError, match="'a' is not a number"):
        table_folder.array_names(tmp_path)


@pytest.mark.parametrize("clock", [True, False])
def test_tables_without_headers_have_the_clock_of_their_first_column(tmp_path, clock):
    """It was proposed as the position of the first joint."""
    time = np.arange(60) * 0.01
    q = np.sin(3 * time[:, None] + np.arange(2))
    for name, values in (("q", q), ("tau", 5 * q**3)):
        rows = np.column_stack([time, values]) if clock else values
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",")
    if not clock:
        assert table_folder.array_names(tmp_path)[:2] == ("q.column1", "q.column2")
        return
    with pytest.raises(RecordingError) as refused:
        guess_columns(tmp_path, KnownColumns(("pan", "lift")))
    assert refused.value.options == "--time column1"
    with pytest.raises(RecordingError) as refused:
        guess_columns(tmp_path, KnownColumns(("pan", "lift"), {"time": "column1"}))
    assert refused.value.options == "--names column2=pan column3=lift"
    columns = Columns(
        "column1",
        "q.{joint}",
        torque="tau.{joint}",
        names={"column2": "pan", "column3": "lift"},
    )
    log = read_recording(tmp_path, ("pan", "lift"), columns)
    np.testing.assert_allclose(log.time, time)
    np.testing.assert_allclose(log.position, q)


def test_pieces_without_headers_are_one_table_without_a_header(tmp_path):
    time = np.arange(60) * 0.01
    rows = np.column_stack([time, np.sin(time), np.cos(time)])
    for k, part in enumerate(np.split(rows, [25])):
        np.savetxt(tmp_path / f"log{k}.csv", part, delimiter=",")
    assert table_folder.array_names(tmp_path) == ("column1", "column2", "column3")
    read = table_folder.read_arrays(tmp_path, ["column1", "column3"])
    np.testing.assert_allclose(np.column_stack([*read.values()]), rows[:, [0, 2]])


def test_a_name_of_several_tables_follows_its_table(tmp_path):
    table(tmp_path, "q.csv", "time,hip", TIME, TIME)
    table(tmp_path, "tau.csv", "time,hip", TIME, 2 * TIME)
    assert set(table_folder.array_names(tmp_path)) == {"time", "q.hip", "tau.hip"}


def test_tables_of_different_clocks_are_several_recordings(tmp_path):
    table(tmp_path, "a.csv", "t,q_hip", TIME, TIME)
    table(tmp_path, "b.csv", "t,q_hip", 2 * TIME, TIME)
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    assert table_folder.one_recording(files) is None
    with pytest.raises(RecordingError, match="same clock"):
        table_folder.array_names(tmp_path)


def test_files_of_one_recording_have_their_folder(tmp_path):
    table(tmp_path, "a.csv", "t,q_hip", TIME, TIME)
    table(tmp_path, "b.csv", "t,tau_hip", TIME, TIME)
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    assert table_folder.one_recording(files) == tmp_path
    assert table_folder.one_recording(files[:1]) is None


def test_a_table_of_another_clock_is_interpolated_to_the_slower_one(tmp_path):
    slow, fast = np.arange(0.0, 2.0, 0.02), np.arange(0.0111, 2.0, 0.005)
    for name, t, values in (("pos", slow, 3.0 * slow), ("tau", fast, 5.0 * fast)):
        np.savetxt(
            tmp_path / f"{name}.csv",
            np.column_stack([t, values]),
            delimiter=",",
            header=f"t,{name}_a",
            comments="",
        )
    columns = Columns("t", "pos_a", torque="tau_a")
    with pytest.raises(RecordingError) as refused:  # the torque begins later
        read_recording(tmp_path, ["a"], columns)
    assert refused.value.options == "--missing omit"
    log = read_recording(tmp_path, ["a"], columns, missing="omit")
    np.testing.assert_allclose(log.time, slow[1:], rtol=1e-12)
    np.testing.assert_allclose(log.torque[:, 0], 5.0 * slow[1:], rtol=1e-12)
    (said,) = table_folder.notes(tmp_path)
    assert "tau.csv: interpolated to the clock of pos.csv" in said


def test_runs_of_one_kind_with_like_clocks_stay_apart(tmp_path):
    for k, start in enumerate((0.0, 0.004)):
        t = start + np.arange(0.0, 2.0, 0.02)
        np.savetxt(
            tmp_path / f"run{k}.csv",
            np.column_stack([t, t]),
            delimiter=",",
            header="t,q_a",
            comments="",
        )
    with pytest.raises(RecordingError, match="no two of its 2 tables"):
        table_folder.array_names(tmp_path)


@pytest.mark.parametrize("headed", [True, False])
def test_tables_whose_clocks_follow_one_another_are_pieces(tmp_path, headed):
    """Also where only the first names the columns: the others were left out."""
    time = np.arange(40) * 0.1
    order = (2, 0, 1)  # of the names of the files
    for k, part in zip(order, np.split(time, [10, 25]), strict=True):
        header = "t,hip_position,hip_effort" if headed or k == order[0] else ""
        values = np.column_stack([part, part**2, -part])
        path = tmp_path / f"log{k}.csv"
        np.savetxt(path, values, delimiter=",", header=header, comments="")
        if not header:
            path.write_text(path.read_text().lstrip())
    columns = Columns("t", "{joint}_position", torque="{joint}_effort")
    log = read_recording(tmp_path, ["hip"], columns)
    np.testing.assert_allclose(log.time, time)
    np.testing.assert_allclose(log.torque[:, 0], -time)
    (note,) = table_folder.notes(tmp_path)
    assert note.startswith("log2.csv, log0.csv, log1.csv are pieces of one recording")


def pieces(folder, starts, rows=40):
    """Write tables of one hip from each time on."""
    files = [folder / f"run{k}.csv" for k in range(len(starts))]
    for file, start in zip(files, starts, strict=True):
        time = start + 0.01 * np.arange(rows)
        values = np.column_stack([time, time, -time])
        header = "t,q_hip,tau_hip"
        np.savetxt(file, values, "%.15g", ",", header=header, comments="")
    return files


@pytest.mark.parametrize("begin", [0.0, 1.7e9])
def test_runs_an_hour_apart_are_no_pieces(tmp_path, begin):
    """They were read as one recording."""
    files = pieces(tmp_path, [begin, begin + 3600.0])
    with pytest.raises(RecordingError, match="without a gap, so they are no") as caught:
        table_folder.array_names(tmp_path)
    assert caught.value.options.split() == list(map(str, files))
    assert caught.value.replaces == (str(tmp_path),)
    assert table_folder.one_recording(files) is None


def test_pieces_may_lack_a_few_samples_between_them(tmp_path):
    pieces(tmp_path, [0.0, 0.45, 0.9])
    log = read_recording(tmp_path, ["hip"], Columns("t", "q_{joint}"))
    assert len(log) == 120


def test_pieces_that_share_a_sample_are_answered_with_the_one_to_take(tmp_path):
    pieces(tmp_path, [0.0, 0.39])
    columns = Columns("t", "q_{joint}")
    with pytest.raises(RecordingError) as caught:
        read_recording(tmp_path, ["hip"], columns)
    assert caught.value.options == "--duplicates first"
    assert len(read_recording(tmp_path, ["hip"], columns, duplicates="first")) == 79


@pytest.mark.parametrize("kind", ["csv", "parquet", "feather"])
def test_a_table_without_rows_is_no_piece(tmp_path, kind):
    """As of a logger that ended just after it had begun a file."""
    pd = pytest.importorskip("pandas")
    for file in pieces(tmp_path, [0.0, 0.4, 0.8]):
        table = pd.read_csv(file)
        file.unlink()
        table = table if "2" not in file.name else table[:0]
        getattr(table, f"to_{kind}")(
            file.with_suffix(f".{kind}"), **{"index": False} if kind == "csv" else {}
        )
    log = read_recording(tmp_path, ["hip"], Columns("t", "q_{joint}"))
    assert len(log) == 80
    (note,) = table_folder.notes(tmp_path)
    assert note.endswith(f"or have no rows: run2.{kind}")
    (tmp_path / f"run1.{kind}").unlink()
    with pytest.raises(RecordingError, match=f"only run0.{kind} is a table") as caught:
        table_folder.array_names(tmp_path)
    assert caught.value.options == str(tmp_path / f"run0.{kind}")


def test_a_table_without_a_clock_is_beside_the_pieces(tmp_path):
    pieces(tmp_path, [0.0, 0.4])
    (tmp_path / "limits.csv").write_text("name,value\n1,2\n")
    assert len(read_recording(tmp_path, ["hip"], Columns("t", "q_{joint}"))) == 80
    assert "limits.csv" in table_folder.notes(tmp_path)[0]


def test_the_tables_of_a_folder_are_read_once(tmp_path, monkeypatch):
    """Each question of a folder read the clocks of all its files again."""
    pieces(tmp_path, [0.0, 0.4, 0.8])
    read = list[Path]()
    whole = csv.read_arrays

    def counted(path, *given, **named):
        read.append(path)
        return whole(path, *given, **named)

    monkeypatch.setattr(csv, "read_arrays", counted)
    for question in (table_folder.array_names, table_folder.notes) * 2:
        question(tmp_path)
    assert len(read) == 3
    table_folder.read_arrays(tmp_path, ["t", "q_hip"])
    assert len(read) == 6
    pieces(tmp_path, [0.0, 0.4, 0.81])  # written anew
    table_folder.array_names(tmp_path)
    assert len(read) == 9


def test_runs_in_a_folder_are_answered_with_the_command_for_each(tmp_path):
    urdf, log = write_arm(tmp_path)
    (tmp_path / "runs").mkdir()
    names = [str(tmp_path / "runs" / f"{k}.csv") for k in "ab"]
    for name, lines in zip(names, (1000, 1200), strict=True):
        Path(name).write_text("".join(log.read_text().splitlines(True)[:lines]))
    with pytest.raises(RecordingError, match="one by one") as caught:
        robot_logs(urdf, tmp_path / "runs")
    assert caught.value.options.split() == names
    assert caught.value.replaces == (str(tmp_path / "runs"),)


@pytest.mark.parametrize("clock", [True, False])
def test_runs_on_equal_clocks_are_no_channels_of_one_recording(tmp_path, clock):
    """As simulators write them: of two, the first was read."""
    urdf, log = write_arm(tmp_path)
    (tmp_path / "runs").mkdir()
    lines = log.read_text().splitlines()
    lines = [line if clock else line.partition(",")[2] for line in lines]
    names = [str(tmp_path / "runs" / f"{k}.csv") for k in "ab"]
    for name in names:
        Path(name).write_text("\n".join(lines))
    stated = Statement() if clock else Statement(time="100Hz")
    with pytest.raises(RecordingError, match="they are runs") as caught:
        robot_logs(urdf, tmp_path / "runs", stated)
    assert caught.value.options.split() == names
    assert caught.value.replaces == (str(tmp_path / "runs"),)


def test_channels_in_tables_of_the_same_columns_are_one_recording(tmp_path):
    urdf, log = write_arm(tmp_path)
    (tmp_path / "run").mkdir()
    names, *rows = (line.split(",") for line in log.read_text().splitlines())
    for channel, word in (("position", "q"), ("torque", "tau")):
        places = [0, *(k for k, n in enumerate(names) if n.startswith(f"{word}_"))]
        columns = ["time", *(names[k].removeprefix(f"{word}_") for k in places[1:])]
        lines = [columns, *([row[k] for k in places] for row in rows)]
        path = tmp_path / "run" / f"{channel}.csv"
        path.write_text("\n".join(map(",".join, lines)))
    columns = robot_logs(urdf, tmp_path / "run").columns
    assert columns.position == "position.{joint}"
    assert columns.torque == "torque.{joint}"


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["README.md", "a.npz", "b.npz"], "give the logs a.npz, b.npz one by one"),
        (["README.md", "a.csv"], "give a.csv in place of the folder"),
        (["README.md", "config.yaml"], "there is no log in it"),
        ([], "there is no log in it"),
    ],
)
def test_a_folder_of_other_files_is_answered_with_the_logs_in_it(tmp_path, names, said):
    """It was said to be a bag that lacks its metadata."""
    for name in names:
        (tmp_path / name).write_text("x")
    with pytest.raises(RecordingError, match=said):
        log_format(tmp_path)


def test_a_faulty_row_of_a_piece_is_not_one_of_the_folder(tmp_path):
    """A row to omit was proposed, which is another one of the whole recording."""
    files = pieces(tmp_path, [0.0, 0.4])
    files[1].write_text(files[1].read_text()[:-12])
    with pytest.raises(
        RecordingError, match=r"run1\.csv, row 40 .* Mend that row"
    ) as no:
        table_folder.read_arrays(tmp_path, ["t", "tau_hip"])
    assert not no.value.options


def test_events_beside_pieces_are_not_of_them(tmp_path):
    pieces(tmp_path, [0.0, 0.4])
    (tmp_path / "events.csv").write_text("t,event\n0.1,start\n0.3,end\n")
    assert len(read_recording(tmp_path, ["hip"], Columns("t", "q_{joint}"))) == 80
    assert "events.csv" in table_folder.notes(tmp_path)[0]


def test_channels_of_several_runs_are_refused(tmp_path):
    """Only the first run was read."""
    for run, begin in enumerate((0.0, 100.0)):
        for word in ("q", "tau"):
            table(tmp_path, f"{word}_{run}.csv", f"t,{word}_hip", begin + TIME, TIME)
    with pytest.raises(
        RecordingError, match=r"q_1\.csv, tau_1\.csv have the same columns"
    ):
        table_folder.array_names(tmp_path)


def test_a_copy_of_a_piece_is_no_channel(tmp_path):
    first, second = pieces(tmp_path, [0.0, 0.4])
    (tmp_path / "run0 (copy).csv").write_text(first.read_text())
    with pytest.raises(RecordingError, match="they are copies, or runs") as caught:
        table_folder.array_names(tmp_path)
    assert str(second) in caught.value.options
