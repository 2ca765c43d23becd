"""Bags are decoded piece by piece: their regression is that of the whole bag."""

import numpy as np
import pytest
from logged import DRIVE, HEAD, moved, write_arm

import consistent_id as ci
from consistent_id.errors import RecordingError
from consistent_id.fleet import windows
from consistent_id.recordings.readers import bag, recording_file

pytest.importorskip("rosbags")

from ros_topics import header, write_mcap, write_ros1

START = 1_700_000_000_000_000_000  # ns
TEXT = (
    HEAD
    + """[data.columns]
time = "{time}"
position = "position"
torque = "effort"
[[data.recordings]]
file = "{file}"
role = "training"
[data.preparation]
resample = 100.0
motion_cutoff = 5.0
"""
)


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    """Windows and pieces so small that a short bag has many."""
    monkeypatch.setattr(windows, "WINDOW", 500)
    monkeypatch.setattr(bag, "_AT_ONCE", 300)
    monkeypatch.setattr(bag, "_ROWS", 700)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A robot's folder, and what it recorded."""
    folder = tmp_path_factory.mktemp("arm")
    urdf, _ = write_arm(folder)
    return folder, moved(ci.TorqueModel(ci.robot.load_urdf(urdf), DRIVE))


def state(log, k, joints, stamp):
    """The joint state of some joints at a sample."""
    return {
        "header": header(stamp),
        "name": [log.joints[j] for j in joints],
        "position": log.position[k, joints],
        "velocity": np.zeros(len(joints)),
        "effort": log.torque[k, joints],
    }


def messages(log, kind):
    """Messages of a log: of all joints; of one each, the second late; or unstamped."""
    jitter = np.random.default_rng(0).integers(-(10**6), 10**6, len(log))
    stamps = START + np.rint(log.time * 1e9).astype(np.int64) + jitter
    if kind == "unstamped":
        return [(s, state(log, k, [0, 1], 0)) for k, s in enumerate(stamps)]
    if kind == "together":
        return [(s + 5, state(log, k, [1, 0], s)) for k, s in enumerate(stamps)]
    late = 40_000_000  # ns: the second joint comes four samples after the first
    alone = [(s, state(log, k, [0], s)) for k, s in enumerate(stamps)]
    alone += [(s + late, state(log, k, [1], s)) for k, s in enumerate(stamps) if k % 50]
    return sorted(alone, key=lambda message: message[0])


def problem(folder, file, time="header.stamp"):
    path = folder / f"{file}.toml"
    path.write_text(TEXT.format(file=file, time=time))
    return ci.load_problem(path)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mcap", "ros1"])
@pytest.mark.parametrize("kind", ["together", "one by one", "unstamped"])
def test_streamed_bags_are_those_of_memory(arm, kind, form):
    folder, log = arm
    file = f"{kind}-{form}.bag" if form == "ros1" else kind
    if not (folder / file).exists():
        write = write_ros1 if form == "ros1" else write_mcap
        topics = {"/joints": ("sensor_msgs/msg/JointState", messages(log, kind))}
        write(folder / file, topics)
    given = problem(folder, file)
    streamed = ci.fleet.stream_regression(given)
    whole = ci.build_regression(given.model, given.training)
    assert streamed.counts == whole.counts
    for F, G in zip(streamed.factors, whole.factors, strict=True):
        H, K = F.T @ F, G.T @ G
        sizes = np.sqrt(np.diag(H))
        sizes = np.where(sizes > 1e-9 * sizes.max(), sizes, np.inf)
        assert abs((H - K) / np.outer(sizes, sizes)).max() < 1e-12
    np.testing.assert_allclose(streamed.effective, whole.effective, rtol=1e-9)


@pytest.mark.slow
def test_clocks_that_go_back_far_are_refused(arm):
    folder, log = arm
    some = messages(log, "together")
    again = [(at + 10**11, content) for at, content in some[:200]]
    topics = {"/joints": ("sensor_msgs/msg/JointState", some + again)}
    write_mcap(folder / "twice", topics)
    with pytest.raises(RecordingError, match="back to 1700000000"):
        ci.fleet.stream_regression(problem(folder, "twice"))


@pytest.mark.slow
def test_stamps_that_begin_late_are_refused(arm):
    folder, log = arm
    some = messages(log, "unstamped")[:400] + messages(log, "together")[400:]
    topics = {"/joints": ("sensor_msgs/msg/JointState", some)}
    write_mcap(folder / "mixed", topics)
    with pytest.raises(RecordingError, match="use time = 'log_time'"):
        ci.fleet.stream_regression(problem(folder, "mixed"))


@pytest.mark.slow
def test_bags_that_do_not_fit_name_what_streams_them(arm, monkeypatch):
    folder, log = arm
    topics = {"/joints": ("sensor_msgs/msg/JointState", messages(log, "together"))}
    bag = write_mcap(folder / "large", topics)
    size = sum(file.stat().st_size for file in bag.iterdir())
    monkeypatch.setattr(recording_file, "memory_of_this_computer", lambda: 2 * size - 1)
    given = problem(folder, "large")
    with pytest.raises(RecordingError, match="--streamed"):
        _ = given.training
    assert ci.fleet.stream_regression(given).counts[0] == pytest.approx(len(log), abs=1)
