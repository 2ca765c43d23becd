"""Logs that are read as a whole beside those that are streamed: the same regression."""

import logging

import numpy as np
import pytest
from logged import DRIVE, HEAD, moved, write_arm

import consistent_id as ci
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.fleet import windows
from consistent_id.recordings.readers import recording_file

FILTERED = "motion_cutoff = 5.0"


@pytest.fixture(autouse=True)
def small_windows(monkeypatch):
    """Windows so small that a short log has many."""
    monkeypatch.setattr(windows, "WINDOW", 500)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A robot's folder with one log in several forms."""
    folder = tmp_path_factory.mktemp("arm")
    urdf, _ = write_arm(folder)
    model = ci.TorqueModel(ci.robot.load_urdf(urdf), DRIVE)
    log = moved(model)
    columns = {"time": log.time}
    for k, joint in enumerate(log.joints):
        columns[f"q_{joint}"] = log.position[:, k]
        columns[f"tau_{joint}"] = log.torque[:, k]
        columns[f"dq_{joint}"] = np.gradient(log.position[:, k], log.time)
        columns[f"told_{joint}"] = log.position[:, k] + log.torque[:, k] / 200.0
    rows = np.column_stack(list(columns.values()))
    np.savetxt(folder / "log.csv", rows, "%.17g", ",", header=",".join(columns))
    text = (folder / "log.csv").read_text()
    (folder / "log.csv").write_text(text.removeprefix("# "))
    np.savez(folder / "log.npz", **columns)
    return folder


def problem(folder, entry="", preparation=FILTERED, columns="", data="", file=None):
    columns = columns or 'position = "q_{joint}"\ntorque = "tau_{joint}"'
    text = f"""{HEAD}{data}
[data.columns]
{columns}
[[data.recordings]]
file = "{file or "log.csv"}"
role = "training"
{entry}
[data.preparation]
{preparation}
"""
    path = folder / f"{abs(hash(text))}.toml"
    path.write_text(text)
    return ci.load_problem(path)


def assert_same(streamed, whole):
    assert streamed.counts == whole.counts
    for F, G in zip(streamed.factors, whole.factors, strict=True):
        H, K = F.T @ F, G.T @ G
        sizes = np.sqrt(np.diag(H))
        sizes = np.where(sizes > 1e-9 * sizes.max(), sizes, np.inf)
        assert abs((H - K) / np.outer(sizes, sizes)).max() < 1e-12
    np.testing.assert_allclose(streamed.effective, whole.effective, rtol=1e-9)


MEASURED = 'position = "q_{joint}"\ntorque = "tau_{joint}"\nvelocity = "dq_{joint}"'
TOLD = 'position = "q_{joint}"\nposition_command = "told_{joint}"'
GAINS = "kp = [200.0, 200.0], kd = [0.0, 0.0]"
TRACK = (
    '[[data.recordings.tracks]]\nfile = "log.npz"\nchannel = "torque"\n'
    'column = "tau_{joint}"\ndelay = 0.013'
)
WHOLE = {
    "smoother": {"preparation": 'method = "smoother"'},
    "least_joint_speed": {
        "preparation": f"{FILTERED}\nleast_joint_speed = 0.1\ntorque_cutoff = 8.0"
    },
    "most_joint_speed": {"preparation": f"{FILTERED}\nmost_joint_speed = 0.5"},
    "delay is estimated": {
        "preparation": f'{FILTERED}\ndelays = {{velocity = "estimated"}}',
        "columns": MEASURED,
    },
    "piece by piece are read": {"file": "log.npz"},
    "scaled or shifted": {
        "data": "position_scale = {shoulder = -1.0}\nposition_offset = {elbow = 0.1}"
    },
    "tracks": {"entry": TRACK, "columns": 'position = "q_{joint}"'},
    "gains": {
        "data": f"gains = {{{GAINS}, delay = 0.004}}",
        "columns": TOLD,
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("reason", WHOLE)
def test_what_takes_a_whole_log_is_read_whole(folder, caplog, reason):
    given = problem(folder, **WHOLE[reason])
    with caplog.at_level(logging.WARNING):
        streamed = ci.fleet.stream_regression(given)
    assert f"read as a whole: {reason}" in caplog.text or reason in caplog.text
    assert_same(streamed, ci.build_regression(given.model, given.training))


@pytest.mark.slow
def test_logs_of_both_kinds_add_up(folder):
    other = '[[data.recordings]]\nfile = "log.npz"\nrole = "training"'
    given = problem(folder, f"rows = [1, 1900]\n{other}\nrows = [200, 2400]")
    whole = ci.build_regression(given.model, given.training)
    assert_same(ci.fleet.stream_regression(given), whole)
    here = ci.fleet.stream_regression(given, executor="serial")
    for F, G in zip(
        ci.fleet.stream_regression(given).factors, here.factors, strict=True
    ):
        np.testing.assert_array_equal(F, G)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"preparation": f'{FILTERED}\nleast_joint_speed = "estimated"'},
            "give the speed that a part",
        ),
        (
            {
                "data": f'gains = {{{GAINS}, scale = "estimated"}}',
                "columns": TOLD,
            },
            "a scale that is estimated needs all recordings",
        ),
    ],
)
def test_what_takes_all_recordings_is_refused(folder, changes, message):
    with pytest.raises(ProblemError, match=message):
        ci.fleet.stream_regression(problem(folder, **changes))


def test_what_has_to_be_whole_and_does_not_fit_is_refused(folder, monkeypatch):
    given = problem(folder, file="log.npz")
    size = (folder / "log.npz").stat().st_size
    monkeypatch.setattr(recording_file, "memory_of_this_computer", lambda: 2 * size - 1)
    with pytest.raises(RecordingError, match="piece by piece are read CSV"):
        ci.fleet.stream_regression(given)
    with ci.large_files():
        ci.fleet.stream_regression(given)


@pytest.mark.parametrize(
    ("moved", "back"),
    [
        ("position_scale = {shoulder = -2.0}", [[-2.0, 0.0], [0.0, 1.0]]),
        ("position_offset = {shoulder = 0.5}", np.eye(2)),
        ('coupled = {elbow = "shoulder"}', [[1.0, -1.0], [0.0, 1.0]]),
    ],
)
def test_a_velocity_in_another_file_is_that_of_the_same_joints(folder, moved, back):
    entry = TRACK.replace("torque", "velocity").replace("tau", "dq")
    plain, changed = (
        problem(folder, entry.replace("0.013", "0.0"), data=data).logs("training")[0]
        for data in ("", moved)
    )
    np.testing.assert_allclose(changed.velocity, plain.velocity @ back, atol=1e-12)
