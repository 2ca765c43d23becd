"""Arrays beside names of joints are read by the names, not in the robot's order."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow.feather import write_feather
from scipy.io import savemat

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import (
    Columns,
    feather,
    parquet,
    read_recording,
)
from consistent_id.recordings.readers.recording_file import column_names

JOINTS = ("shoulder", "elbow")
OTHER = ["elbow", "shoulder"]  # ROS sorts names
TIME = np.arange(30) / 10.0
POSITION = np.column_stack([np.sin(TIME), 0.2 * TIME])
TORQUE = 3.0 * POSITION + 1.0


def read(file):
    guess = guess_columns(file, KnownColumns(JOINTS))
    return read_recording(file, guess.joints, guess.columns)


def assert_is_read(file):
    log = read(file)
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(log.position, POSITION)
    np.testing.assert_allclose(log.torque, TORQUE)


STRUCTURE = [("t", object), ("state", object), ("tau", object)]


@pytest.mark.slow
@pytest.mark.parametrize("samples", [30, 130])
def test_a_structure_for_each_sample_is_a_row(tmp_path, samples):
    """MATLAB's ``log(k).q = ...`` makes one; few are structures of joints."""
    time = np.arange(samples) / 10.0
    position = np.column_stack([np.sin(time), 0.2 * time])
    log = np.array(
        [
            (t, {"q": q, "label": "moving"}, 3.0 * q)
            for t, q in zip(time, position, strict=True)
        ],
        dtype=STRUCTURE,
    )
    savemat(tmp_path / "log.mat", {"log": log, "note": "run 3"})
    if samples < 100:
        with pytest.raises(RecordingError):
            read(tmp_path / "log.mat")
        return
    found = read(tmp_path / "log.mat")
    np.testing.assert_allclose(found.time, time)
    np.testing.assert_allclose(found.position, position)
    np.testing.assert_allclose(found.torque, 3.0 * position)


def test_a_structure_for_each_run_has_no_samples(tmp_path):
    run = (np.arange(200.0), np.ones((200, 2)), np.ones((200, 2)))
    log = np.array([run] * 120, dtype=STRUCTURE)
    savemat(tmp_path / "log.mat", {"log": log})
    with pytest.raises(RecordingError, match="no column or array of numbers"):
        read(tmp_path / "log.mat")


def test_structures_in_cells_are_read_by_their_numbers(tmp_path):
    cells = np.empty((1, 2), object)
    for j in range(2):
        cells[0, j] = {"q": POSITION[:, [j]], "tau": TORQUE[:, [j]]}
    savemat(tmp_path / "log.mat", {"t": TIME, "joint": cells})
    assert_is_read(tmp_path / "log.mat")


def test_the_clock_of_a_channel_is_no_channel(tmp_path):
    """``q.time`` has the word of a position, and a column."""
    channels = {
        name: {
            "time": TIME[:, None],
            "signals": {"values": values.T[:, None, :], "dimensions": [[2.0, 1.0]]},
        }
        for name, values in (("q", POSITION), ("tau", TORQUE))
    }
    savemat(tmp_path / "log.mat", {"out": {"tout": TIME[:, None], **channels}})
    assert_is_read(tmp_path / "log.mat")


PANDAS = {
    "columns": lambda table, rows: {
        name: dict(zip(map(str, range(len(rows))), column, strict=True))
        for name, column in zip(table, zip(*rows, strict=True), strict=True)
    },
    "split": lambda table, rows: {
        "columns": table,
        "index": list(range(len(rows))),
        "data": rows,
    },
    "index": lambda table, rows: {
        name: {str(row[0]): row[k] for row in rows} for k, name in enumerate(table) if k
    },
    "split index": lambda table, rows: {
        "columns": table[1:],
        "index": [row[0] for row in rows],
        "data": [row[1:] for row in rows],
    },
}


@pytest.mark.parametrize("form", PANDAS)
def test_frames_as_pandas_writes_them_are_read(tmp_path, form):
    time = np.arange(130) / 10.0
    position = np.column_stack([np.sin(time), 0.2 * time])
    names = ["time", *(f"{w}_{j}" for w in ("q", "tau") for j in JOINTS)]
    rows = np.column_stack([time, position, 3.0 * position]).tolist()
    file = tmp_path / "log.json"
    file.write_text(json.dumps(PANDAS[form](names, rows)))
    log = read(file)
    np.testing.assert_allclose(log.time, time)
    np.testing.assert_allclose(log.position, position)
    np.testing.assert_allclose(log.torque, 3.0 * position)


def test_an_index_that_counts_rows_is_no_clock(tmp_path):
    table = {
        f"{w}_{j}": {str(k): 0.1 * k for k in range(130)} for w in "q" for j in JOINTS
    }
    file = tmp_path / "log.json"
    file.write_text(json.dumps(table))
    assert column_names(file) == ("q_shoulder", "q_elbow")


def message(k):
    lists = {"position": POSITION[k, ::-1].tolist(), "effort": TORQUE[k, ::-1].tolist()}
    return {"name": OTHER, "velocity": [], **lists}


def joint(k, j):
    values = {"position": POSITION[k, j], "effort": TORQUE[k, j]}
    return {"name": JOINTS[j], **values}


RECORDS = {
    "joint states": lambda k: {"time": TIME[k], **message(k)},
    "within": lambda k: {"time": TIME[k], "msg": message(k)},
    "lists of joints": lambda k: {"t": TIME[k], "joints": [joint(k, 1), joint(k, 0)]},
    "dates": lambda k: {"time": f"2026-01-01T10:00:{TIME[k]:06.3f}Z", **message(k)},
}


@pytest.mark.parametrize("record", RECORDS.values(), ids=RECORDS)
def test_records_with_names(tmp_path, record):
    file = tmp_path / "log.jsonl"
    file.write_text("\n".join(json.dumps(record(k)) for k in range(len(TIME))))
    assert_is_read(file)
    assert log_format(file).notes(file) == ()


def test_records_of_a_joint_each(tmp_path):
    records = [
        {"time": TIME[k], "joint": JOINTS[j], "q": POSITION[k, j], "tau": TORQUE[k, j]}
        for k in range(len(TIME))
        for j in (1, 0)
    ]
    file = tmp_path / "log.json"
    file.write_text(json.dumps(records))
    assert_is_read(file)
    (note,) = log_format(file).notes(file)
    assert "each of elbow, shoulder: they are read side by side" in note


def arrays(names):
    return {
        "joint_names": names,
        "time": TIME,
        "position": POSITION[:, ::-1],
        "torque": TORQUE[:, ::-1],
    }


def test_arrays_beside_their_names(tmp_path):
    npz, plain = tmp_path / "log.npz", tmp_path / "log.json"
    np.savez(npz, **arrays(np.array(OTHER)))
    lists = {name: np.asarray(v).tolist() for name, v in arrays(OTHER).items()}
    plain.write_text(json.dumps(lists))
    assert_is_read(npz)
    assert_is_read(plain)


@pytest.mark.parametrize("kind", ["cell", "char"])
@pytest.mark.parametrize("struct", [False, True])
def test_variables_of_matlab_beside_their_names(tmp_path, kind, struct):
    names = ["elbow", "shoulder"]  # of a char array, the shorter is filled with blanks
    fields = arrays(np.array(names, dtype=object if kind == "cell" else None))
    savemat(tmp_path / "log.mat", {"log": fields} if struct else fields)
    assert_is_read(tmp_path / "log.mat")


def test_a_cell_array_of_matlab_73_beside_arrays(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        for name in ("time", "position", "torque"):
            file[name] = np.atleast_2d(arrays(OTHER)[name].T)  # column by column
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        cells = []
        for name in OTHER:
            codes = np.array([[ord(letter)] for letter in name], dtype=np.uint16)
            file[f"#refs#/{name}"] = codes
            file[f"#refs#/{name}"].attrs["MATLAB_class"] = np.bytes_("char")
            cells.append(file[f"#refs#/{name}"].ref)
        file["joint_names"] = np.array([cells], dtype=h5py.ref_dtype)
        file["joint_names"].attrs["MATLAB_class"] = np.bytes_("cell")
    assert_is_read(tmp_path / "log.mat")


def test_arrays_beside_names_may_have_fewer_joints_or_more_than_the_robot(tmp_path):
    file = tmp_path / "log.npz"
    np.savez(file, **arrays(np.array(OTHER)))
    guess = guess_columns(file, KnownColumns(("base", *JOINTS)))
    assert guess.joints == JOINTS
    more = arrays(np.array([*OTHER, "gripper"]))
    for name in ("position", "torque"):
        more[name] = np.column_stack([more[name], TIME])
    np.savez(file, **more)
    assert_is_read(file)
    of_others = arrays(np.array([*OTHER, "gripper"]))  # names of another thing
    np.savez(file, **of_others)
    assert guess_columns(file, KnownColumns(JOINTS)).columns.array_joints == JOINTS


def test_lists_in_cells_beside_their_names(tmp_path):
    file = tmp_path / "log.csv"
    frame = {"time": TIME, "name": [OTHER] * len(TIME)}
    frame |= {"position": POSITION[:, ::-1], "effort": TORQUE[:, ::-1]}
    lines = [
        ",".join(f'"{np.asarray(frame[n][k]).tolist()}"' for n in frame)
        for k in range(len(TIME))
    ]
    gripper = '"9.0","[\'left\', \'right\']","[1.0, 2.0]","[3.0, 4.0]"'
    file.write_text("\n".join([",".join(frame), *lines[:5], gripper, *lines[5:]]))
    assert column_names(file)[-4:] == (
        *(f"position.{joint}" for joint in OTHER),
        *(f"effort.{joint}" for joint in OTHER),
    )
    log = read_recording(
        file,
        JOINTS,
        Columns("time", "position.{joint}", torque="effort.{joint}"),
    )
    np.testing.assert_allclose(log.position, POSITION)
    np.testing.assert_allclose(log.torque, TORQUE)


@pytest.mark.parametrize("group", ["", "run/"])
def test_datasets_beside_their_names(tmp_path, group):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, values in arrays(np.array(OTHER, dtype="S")).items():
            file[group + name] = values
    assert_is_read(tmp_path / "log.h5")


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_columns_of_lists_beside_their_names(tmp_path, kind):
    lists = arrays([OTHER] * len(TIME))
    table = pa.table({name: list(values) for name, values in lists.items()})
    file = tmp_path / f"log.{kind}"
    {"parquet": pq.write_table, "feather": write_feather}[kind](table, file)
    assert_is_read(file)


def test_other_names_are_mapped_by_the_option_that_the_message_names(tmp_path):
    file = tmp_path / "log.npz"
    np.savez(file, **arrays(np.array(["A2", "A1"])))
    with pytest.raises(
        RecordingError, match="joint_names names other joints"
    ) as refused:
        read(file)
    assert refused.value.options == "--names A2=shoulder A1=elbow"


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_a_long_table_of_arrow_is_read_side_by_side(tmp_path, kind):
    file = tmp_path / f"log.{kind}"
    table = {
        "time": np.repeat(TIME, 2),
        "joint": OTHER * len(TIME),
        "position": POSITION[:, ::-1].ravel(),
        "effort": TORQUE[:, ::-1].ravel(),
    }
    {"parquet": pq.write_table, "feather": write_feather}[kind](pa.table(table), file)
    assert_is_read(file)
    (note,) = log_format(file).notes(file)
    assert "each of elbow, shoulder: they are read side by side" in note
    assert not log_format(file).in_pieces(file)


def test_a_long_table_is_read_once_as_long_as_the_file_is_the_same(
    tmp_path, monkeypatch
):
    file = tmp_path / "log.parquet"
    table = {
        "time": np.repeat(TIME, 2),
        "joint": OTHER * len(TIME),
        "position": POSITION[:, ::-1].ravel(),
        "effort": TORQUE[:, ::-1].ravel(),
    }
    times, read_columns = [], parquet.read_columns

    def counted(path, names):
        times.append(path)
        return read_columns(path, names)

    monkeypatch.setattr(parquet, "read_columns", counted)
    pq.write_table(pa.table(table), file)
    assert_is_read(file)
    assert len(log_format(file).notes(file)) == 1
    assert len(times) == 1
    table["joint"] = ["hand", "wrist"] * len(TIME)
    pq.write_table(pa.table(table), file)
    assert "hand.position" in column_names(file)


@pytest.mark.parametrize("beside", [False, True])
def test_names_above_nested_lists_are_those_of_their_items(tmp_path, beside):
    """As in messages of a controller's state, whose joints have any order."""
    records = [
        {
            "time": k / 10,
            "joint_names": ["elbow", "shoulder"],
            "output": {"positions": [9, 9], "effort": [9, 9]},
            "feedback": {"positions": [k, -k], "effort": [2 * k, 3]},
        }
        for k in range(120)
    ]
    file = tmp_path / "log.json"
    file.write_text(json.dumps({"of": "arm", "log": records} if beside else records))
    guess = guess_columns(file, KnownColumns(("shoulder", "elbow")))
    assert guess.columns.torque == "feedback.effort.{joint}"
    log = read_recording(file, ("shoulder", "elbow"), guess.columns)
    np.testing.assert_array_equal(log.position[:, 1], np.arange(120))
    np.testing.assert_array_equal(log.torque[:, 0], np.full(120, 3))


@pytest.mark.parametrize("nested", [False, True])
def test_names_are_of_no_other_lists_of_equal_length(tmp_path, nested):
    """A pose of a tool has six numbers, as an arm of six joints has positions."""
    records = []
    for k in range(120):
        lists = {"joint_position": [k, -k], "joint_effort": [2 * k, 3]}
        tool = {"position": [9, 9], "effort": [9, 9]}
        body = {"arm": lists} if nested else lists
        of_tools = {"tcp": tool, "box": tool}
        names = {"joint_names": ["elbow", "shoulder"]}
        records.append({"time": k / 10, **names, **of_tools, **body})
    file = tmp_path / "log.json"
    file.write_text(json.dumps(records))
    guess = guess_columns(file, KnownColumns(("shoulder", "elbow")))
    log = read_recording(file, ("shoulder", "elbow"), guess.columns)
    np.testing.assert_array_equal(log.position[:, 1], np.arange(120))
    np.testing.assert_array_equal(log.torque[:, 0], np.full(120, 3))


def test_an_object_for_each_joint_is_one_of_their_columns(tmp_path):
    file = tmp_path / "log.jsonl"
    rows = [{"t": k, "m": [{"q": k, "tau": 1}, {"q": -k, "tau": 2}]} for k in range(9)]
    file.write_text("\n".join(map(json.dumps, rows)))
    columns = guess_columns(file, KnownColumns(("shoulder", "elbow"))).columns
    log = read_recording(file, ("shoulder", "elbow"), columns)
    np.testing.assert_array_equal(log.position[:, 1], -np.arange(9))
    np.testing.assert_array_equal(log.torque[:, 1], np.full(9, 2))


def test_a_long_table_of_feather_is_put_side_by_side_once(tmp_path, monkeypatch):
    file = tmp_path / "log.feather"
    table = {
        "time": np.repeat(TIME, 2),
        "joint": OTHER * len(TIME),
        "position": POSITION[:, ::-1].ravel(),
        "effort": TORQUE[:, ::-1].ravel(),
    }
    times, side_by_side = [], feather.side_by_side

    def counted(columns):
        times.append(len(columns))
        return side_by_side(columns)

    monkeypatch.setattr(feather, "side_by_side", counted)
    write_feather(pa.table(table), file)
    assert_is_read(file)
    assert len(log_format(file).notes(file)) == 1
    assert len(times) == 1
    table["joint"] = ["hand", "wrist"] * len(TIME)
    write_feather(pa.table(table), file)
    assert "hand.position" in column_names(file)


@pytest.mark.parametrize("labels", [("position", "torque"), ("", "")])
def test_arrays_of_structures_are_read_by_their_labels_or_numbers(tmp_path, labels):
    """As Simulink writes the signals of a scope."""
    signals = np.zeros(2, dtype=[("values", object), ("label", object)])
    for k, values in enumerate((POSITION, TORQUE)):
        signals[k] = values, labels[k]
    file = tmp_path / "log.mat"
    savemat(file, {"scope": {"time": TIME[:, None], "signals": signals}})
    if labels[0]:
        assert_is_read(file)
    else:
        names = [f"scope.signals({k}).values" for k in (1, 2)]
        assert set(names) <= set(column_names(file))
        columns = Columns("scope.time", names[0], torque=names[1], array_joints=JOINTS)
        log = read_recording(file, JOINTS, columns)
        np.testing.assert_allclose(log.torque, TORQUE)


def test_arrays_of_three_dimensions_of_which_one_is_one_are_read(tmp_path):
    """Simulink logs vectors as 2 x 1 x samples."""
    file = tmp_path / "log.mat"
    arrays = {"q": POSITION, "tau": TORQUE}
    tall = {name: values.T[:, None, :] for name, values in arrays.items()}
    savemat(file, {"time": TIME, **tall})
    assert_is_read(file)


@pytest.mark.parametrize("place", ["position_{}", "position{}", "position[{}]"])
def test_numbered_columns_beside_a_list_of_names_are_of_these(tmp_path, place):
    """As bagpy writes joint states; they were taken in the robot's order."""
    numbers = [place.format(k) for k in (0, 1)]
    numbers += [n.replace("position", "effort") for n in numbers]
    lines = [",".join(["Time", "name", *numbers])]
    for k, time in enumerate(TIME):
        values = [*POSITION[k, ::-1], *TORQUE[k, ::-1]]
        lines.append(
            ",".join([f"{time}", f'"{OTHER}"', *map(repr, map(float, values))])
        )
    file = tmp_path / "log.csv"
    file.write_text("\n".join(lines))
    assert_is_read(file)
    lines[9] = lines[9].replace("elbow", "wrist")
    file.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="not all rows are of the joints"):
        read(file)
