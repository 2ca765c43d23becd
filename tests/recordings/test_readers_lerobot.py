"""LeRobot data sets: episodes, names of elements, units that nobody states."""

import json

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.log_formats import files_of, log_format
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.readers.lerobot import array_names, notes, require_units

FPS = 20
NAMES = ["pan.pos", "lift.pos", "gripper.pos"]
COLUMNS = Columns(
    "timestamp",
    "observation.state.{joint}.pos",
    position_command="action.{joint}.pos",
)


def _feature(names, shape):
    return {"dtype": "float32", "shape": shape, "names": names}


def _table(episodes, states):
    """Return a table of episodes, whose frames count from 0."""
    frame = np.concatenate([np.arange(count) for _, count in episodes])
    number = np.concatenate([np.full(count, e) for e, count in episodes])
    lists = pa.list_(pa.float32())
    return pa.table(
        {
            "action": pa.array((states + 1.0).tolist(), lists),
            "observation.state": pa.array(states.tolist(), lists),
            "timestamp": (frame / FPS).astype(np.float32),
            "episode_index": number,
            "index": np.arange(len(frame)),
        }
    )


def _data_set(folder, names, *, old=False):
    """Write 40 frames in two episodes; return the states."""
    states = np.arange(40.0)[:, None] / 32.0 * [1.0, -0.5, 64.0]
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    (folder / "meta").mkdir()
    if old:  # version 2: a file for each episode
        for e, part in enumerate((states[:15], states[15:])):
            table = _table([(e, len(part))], part)
            parquet.write_table(table, data / f"episode_{e:06d}.parquet")
    else:
        table = _table([(0, 15), (1, 25)], states)
        parquet.write_table(table, data / "file-000.parquet")
    info = {
        "codebase_version": "v2.1" if old else "v3.0",
        "robot_type": "so101_follower",
        "total_episodes": 2,
        "fps": FPS,
        "features": {
            "action": _feature(names, [3]),
            "observation.state": _feature(names, [3]),
            "observation.images.top": {"dtype": "video", "shape": [3, 4, 4]},
            "timestamp": _feature(None, [1]),
            "episode_index": {"dtype": "int64", "shape": [1], "names": None},
            "index": {"dtype": "int64", "shape": [1], "names": None},
        },
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return states.astype(np.float32)


@pytest.mark.parametrize("old", [False, True], ids=["v3", "v2"])
@pytest.mark.parametrize("names", [NAMES, {"motors": NAMES}], ids=["list", "parts"])
def test_joints_are_read_by_the_names_of_the_data_set(tmp_path, names, old):
    states = _data_set(tmp_path, names, old=old)
    log = read_recording(tmp_path, ["lift", "pan"], COLUMNS)
    np.testing.assert_array_equal(log.position, states[:, [1, 0]])
    np.testing.assert_array_equal(log.position_command, (states + 1.0)[:, [1, 0]])


@pytest.mark.parametrize("old", [False, True], ids=["v3", "v2"])
def test_episodes_follow_each_other_with_a_break(tmp_path, old):
    _data_set(tmp_path, NAMES, old=old)
    steps = np.diff(read_recording(tmp_path, ["pan"], COLUMNS).time)
    assert steps[14] == pytest.approx(3.0)
    np.testing.assert_allclose(np.delete(steps, 14), 1.0 / FPS, rtol=1e-5)


def test_a_file_of_the_data_is_read_with_the_names_of_its_data_set(tmp_path):
    states = _data_set(tmp_path, NAMES, old=True)
    file = tmp_path / "data" / "chunk-000" / "episode_000001.parquet"
    log = read_recording(file, ["pan"], COLUMNS)
    np.testing.assert_array_equal(log.position[:, 0], states[15:, 0])


def test_a_file_alone_has_arrays_and_the_breaks_between_episodes(tmp_path):
    states = np.zeros((4, 3))
    file = tmp_path / "file.parquet"
    parquet.write_table(_table([(0, 2), (1, 2)], states), file)
    assert log_format(file).name == "Parquet"
    columns = Columns("timestamp", "observation.state", array_joints=("a", "b", "c"))
    log = read_recording(file, ["a"], columns)
    np.testing.assert_allclose(np.diff(log.time), [0.05, 3.0, 0.05], rtol=1e-6)


def test_its_columns_and_its_description_are_said(tmp_path):
    _data_set(tmp_path, NAMES)
    names = array_names(tmp_path)
    assert names[:3] == ("timestamp", "episode_index", "index")
    assert "observation.state.gripper.pos" in names
    assert not any("images" in name for name in names)
    (said,) = notes(tmp_path)
    assert "v3.0 of so101_follower: 2 episodes, 20 samples a second" in said


def test_names_that_are_not_the_robots_are_proposed_as_an_option(tmp_path):
    _data_set(tmp_path, NAMES)
    with pytest.raises(
        RecordingError, match=r"gripper would not be read.*--names"
    ) as e:
        guess_columns(tmp_path, KnownColumns(("pan_joint", "lift_joint")))
    assert str(e.value).endswith("--names pan=pan_joint lift=lift_joint")


def test_without_effort_the_message_says_what_can_be_done(tmp_path):
    _data_set(tmp_path, NAMES)
    advice = r"commands in action\.\{joint\}\.pos: --gains .*consistent-id rollout"
    with pytest.raises(RecordingError, match=advice):
        guess_columns(tmp_path, KnownColumns(("pan", "lift")))
    known = KnownColumns(("pan", "lift"), commands=True)
    found = guess_columns(tmp_path, known).columns
    assert found.position_command == "action.{joint}.pos"


def test_positions_that_are_no_radians_are_refused(tmp_path):
    _data_set(tmp_path, NAMES)
    name = "observation.state.{}.pos"
    require_units(tmp_path, [name.format("pan"), name.format("lift")])
    with pytest.raises(RecordingError, match=r"reaches 78, .*-100 to 100.*--units deg"):
        require_units(tmp_path, [name.format("gripper")])
    file = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    parquet.write_table(_table([(0, 2)], np.full((2, 3), 150.0)), file)
    with pytest.raises(RecordingError, match=r"150.*If it is in degrees: --units deg$"):
        require_units(tmp_path, [name.format("pan")])
    missing = np.array([[np.nan, 1.0, 1.0], [150.0, 1.0, 1.0]])
    parquet.write_table(_table([(0, 2)], missing), file)
    with pytest.raises(RecordingError, match=r"pan\.pos reaches 150"):
        require_units(tmp_path, [name.format("pan"), name.format("lift")])


def test_the_files_of_a_log_are_those_that_are_read(tmp_path):
    _data_set(tmp_path / "set", NAMES, old=True)
    (tmp_path / "set" / "videos").mkdir()
    (tmp_path / "set" / "videos" / "top.mp4").touch()
    first, *data = files_of(tmp_path / "set")
    assert first == tmp_path / "set" / "meta" / "info.json"
    assert [f.name for f in data] == [f"episode_00000{k}.parquet" for k in (0, 1)]
    assert files_of(data[0]) == (data[0],)
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("metadata.yaml", "bag_0.mcap"):
        (bag / name).touch()
    assert files_of(bag) == (bag / "bag_0.mcap", bag / "metadata.yaml")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"features": []}'])
def test_a_faulty_description_is_refused(tmp_path, text):
    _data_set(tmp_path, NAMES)
    (tmp_path / "meta" / "info.json").write_text(text)
    with pytest.raises(RecordingError, match=r"info\.json: not readable as the desc"):
        array_names(tmp_path)


def test_a_data_set_without_data_is_refused(tmp_path):
    _data_set(tmp_path, NAMES)
    (tmp_path / "data" / "chunk-000" / "file-000.parquet").unlink()
    with pytest.raises(RecordingError, match="no Parquet file under"):
        read_recording(tmp_path, ["pan"], COLUMNS)


def test_fewer_elements_than_names_are_refused(tmp_path):
    _data_set(tmp_path, NAMES)
    file = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    parquet.write_table(_table([(0, 2)], np.zeros((2, 2))), file)
    with pytest.raises(RecordingError, match="names at least 3 elements"):
        read_recording(tmp_path, ["gripper"], COLUMNS)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_time_stamps_of_parquet_are_seconds(tmp_path, unit):
    of_a_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    stamps = pa.array(
        [1_700_000_000 * of_a_second + k * of_a_second for k in range(3)],
        pa.timestamp(unit),
    )
    since = pa.array([k * of_a_second for k in range(3)], pa.duration(unit))
    file = tmp_path / "log.parquet"
    table = pa.table({"timestamp": stamps, "since": since, "q_a": [0.0, 1.0, 2.0]})
    parquet.write_table(table, file)
    log = read_recording(file, ["a"], Columns("timestamp"))
    assert log.time.tolist() == [1.7e9, 1.7e9 + 1.0, 1.7e9 + 2.0]
    assert read_recording(file, ["a"], Columns("since")).time.tolist() == [0, 1, 2]
