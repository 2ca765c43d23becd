"""A channel that was written into a file of its own, on a clock of its own."""

import numpy as np
import pytest

from consistent_id import ProblemError, RecordingError, load_problem
from consistent_id.recordings import read_track

LATE = 0.0123  # s
TONES = 2 * np.pi * np.array([0.4, 1.1, 1.7])  # rad/s


def _angle(time, derivative=0):
    """Sum of tones, or its second derivative."""
    factor = -(TONES**2) if derivative == 2 else np.ones(3)
    return (factor * np.sin(np.outer(time, TONES))).sum(axis=1)


def _save(path, time, name, values):
    table = np.column_stack([time, *np.transpose(values)])
    header = "time," + name
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")


@pytest.fixture
def folder(tmp_path):
    """Encoders and torque at 1 kHz, accelerations at 300 Hz that come late."""
    fast, slow = np.arange(10_000) / 1000, np.arange(3000) / 300
    both = np.column_stack([_angle(fast), np.cos(3 * fast)])
    _save(tmp_path / "log.csv", fast, "q_joint1,tau_joint1", both)
    seen = _angle(slow - LATE, 2)[:, None]
    _save(tmp_path / "imu.csv", slow, "ddq_joint1", seen)
    return tmp_path


def _problem(folder, track="", preparation=""):
    (folder / "problem.toml").write_text(f"""
name = "arm"
[model]
modified_dh = [{{ alpha_deg = 0, a = 0 }}]
[constraints]
masses = "free"
[data.columns]
torque = "tau_{{joint}}"
[data.preparation]
{preparation}
[[data.recordings]]
file = "log.csv"
role = "training"
rows = [1001, 9000]
{track}
""")
    return load_problem(folder)


IMU = """
[[data.recordings.tracks]]
file = "imu.csv"
channel = "acceleration"
column = "ddq_{joint}"
delay = "estimated"
"""


def test_a_track_is_read_by_the_names_of_its_columns(folder):
    track = read_track(folder / "imu.csv", ["joint1"], "acceleration", "ddq_{joint}")
    assert (track.channel, track.joints) == ("acceleration", ("joint1",))
    assert np.allclose(track.values[:, 0], _angle(track.time - LATE, 2))
    with pytest.raises(RecordingError, match="no column 'ddq_elbow'"):
        read_track(folder / "imu.csv", ["elbow"], "acceleration", "ddq_{joint}")


@pytest.mark.slow
def test_a_problem_brings_two_clocks_to_the_slower_and_takes_out_the_delay(folder):
    (log,) = _problem(folder, IMU).training
    assert log.rate == pytest.approx(300.0)
    assert 1.0 <= log.time[0] < 1.004
    # Largest acceleration 180 rad/s^2; a delay wrong by 1e-5 s would miss it by 0.02.
    assert np.allclose(log.acceleration[:, 0], _angle(log.time, 2), atol=0.02)
    assert np.allclose(log.torque[:, 0], np.cos(3 * log.time), atol=1e-3)


def test_a_track_that_is_not_there_is_missing(folder):
    (folder / "imu.csv").unlink()
    assert _problem(folder, IMU).missing == ("imu.csv",)


@pytest.mark.parametrize(
    ("track", "preparation", "message"),
    [
        (IMU, 'method = "smoother"', "acceleration of imu.csv.*takes all motion"),
        (IMU.replace("acceleration", "torque"), "", "delay of torque cannot be found"),
    ],
)
def test_tracks_that_make_no_sense_are_refused(folder, track, preparation, message):
    with pytest.raises(ProblemError, match=message):
        _problem(folder, track, preparation)
