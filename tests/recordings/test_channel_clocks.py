"""A log whose channels have clocks of their own is refused, if these differ."""

from pathlib import Path

import numpy as np
import pytest
from logged import write_arm

from consistent_id.errors import RecordingError
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.recordings.channel_clocks import own_clock, stem_of_clock
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns

JOINTS = ("a", "b")
TIME = np.arange(50) * 0.01
Q = np.column_stack([np.sin(TIME), np.cos(TIME)])


def write(folder, kind, shift, rows=50):
    """Write positions and torques with a clock each."""
    later = TIME[:rows] + shift
    if kind == "npz":
        path = folder / "log.npz"
        np.savez(path, q_time=TIME, q=Q, tau_time=later, tau=Q[:rows])
    elif kind == "hdf5":
        import h5py

        path = folder / "log.h5"
        with h5py.File(path, "w") as file:
            file["joint/time"], file["joint/position"] = TIME, Q
            file["drive/time"], file["drive/torque"] = later, Q[:rows]
    else:
        path = folder / "log.csv"
        lines = ["t_q,q1,q2,t_tau,tau1,tau2"]
        for k in range(len(TIME)):
            last = [later[k], *Q[k]] if k < rows else [""] * 3
            lines.append(",".join(map(str, [TIME[k], *Q[k], *last])))
        path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("kind", ["npz", "hdf5", "csv"])
@pytest.mark.parametrize(("shift", "rows"), [(0.3, 50), (0.0, 40)])
def test_a_torque_of_another_clock_is_not_read_as_if_of_the_positions(
    tmp_path, kind, shift, rows
):
    """A rate was proposed, with which the torque was 0.3 s early in silence."""
    path = write(tmp_path, kind, shift, rows)
    channels = {} if kind == "hdf5" else {"time": "q_time" if kind == "npz" else "t_q"}
    with pytest.raises(RecordingError, match="their times differ"):
        guess_columns(path, KnownColumns(JOINTS, channels))


@pytest.mark.parametrize("kind", ["npz", "hdf5", "csv"])
def test_equal_clocks_are_one(tmp_path, kind):
    path = write(tmp_path, kind, 0.0)
    if kind != "hdf5":
        with pytest.raises(RecordingError) as caught:
            guess_columns(path, KnownColumns(JOINTS))
        assert caught.value.options == f"--time {'q_time' if kind == 'npz' else 't_q'}"
        channels = {"time": caught.value.options.split()[1]}
        assert guess_columns(path, KnownColumns(JOINTS, channels)).columns.torque
    else:
        assert guess_columns(path, KnownColumns(JOINTS)).columns.torque


def test_a_clock_has_a_part_of_its_channels_name():
    clocks = ["time", "t_q", "time_tau", "drive/time"]
    assert list(map(stem_of_clock, clocks)) == ["", "q", "tau", "drive"]
    assert own_clock("q_{joint}", clocks) == "t_q"
    assert own_clock("qd_{joint}", clocks) is None
    assert own_clock("drive/torque", clocks) == "drive/time"


def test_a_column_that_does_not_rise_is_no_clock_of_a_channel(tmp_path):
    """Such as a temperature, ``tau_t``."""
    path = tmp_path / "log.npz"
    np.savez(path, time=TIME, q=Q, tau=Q, q_t=TIME, tau_t=np.full(50, 30.0))
    assert guess_columns(path, KnownColumns(JOINTS)).columns.torque == "tau"


def test_texts_are_no_clock_and_no_torque(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=TIME, q=Q, tau=Q, q_t=TIME, tau_t=np.array(["warm"] * 50))
    assert guess_columns(path, KnownColumns(JOINTS)).columns.torque == "tau"


def test_a_table_in_memory_has_one_clock_as_a_file(tmp_path):
    urdf, _ = write_arm(tmp_path)
    table = {"time": TIME, "t_q": TIME, "t_tau": TIME + 0.3}
    for k in (1, 2):
        table |= {f"q{k}": Q[:, k - 1], f"tau{k}": Q[:, k - 1]}
    memory = {Path("table"): table}
    with pytest.raises(RecordingError, match="their times differ"):
        robot_logs(urdf, Path("table"), tables=memory)
    memory[Path("table")] = {**table, "t_tau": TIME}
    robot_logs(urdf, Path("table"), tables=memory)
