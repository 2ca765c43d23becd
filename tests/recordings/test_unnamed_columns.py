"""Files without names of columns: what numbers alone say, and what is proposed."""

from time import process_time

import numpy as np
import pytest

from consistent_id import Columns, RecordingError, read_recording
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers import csv
from consistent_id.recordings.unnamed_columns import column_layout, is_clock

JOINTS = ("pan", "lift")


def motion(rows=200):
    t = np.arange(rows) * 0.01 + 3.0
    q = np.column_stack([np.sin(3 * t), np.cos(2 * t)])
    dq = np.column_stack([3 * np.cos(3 * t), -2 * np.sin(2 * t)])
    torque = 5 * q**3 + 1.0
    return t, q, dq, torque


def written(folder, table, **more):
    path = folder / "log.csv"
    np.savetxt(path, table, fmt="%.6f", delimiter=",", **more)
    return path


@pytest.mark.parametrize(("name", "value"), [("dt", 0.02), ("info_fps", 50)])
def test_a_single_number_states_the_rate(tmp_path, name, value):
    t, q, _, torque = motion()
    path = tmp_path / "log.npz"
    table = np.column_stack([q, torque])[:, None, :]  # samples, robots, joints
    arrays = {"dof_pos": table[..., :3], "dof_torque": table[..., 1:]}
    np.savez(path, **arrays, **{name: value})
    with pytest.raises(RecordingError, match=f"If {name}, which is") as caught:
        guess_columns(path, KnownColumns(JOINTS))
    assert caught.value.options == "--time 50Hz"
    with pytest.raises(RecordingError, match="3 columns, the robot has 2") as caught:
        guess_columns(path, KnownColumns(JOINTS, {"time": "50Hz"}))
    assert "--position 'dof_pos[0:2]'" in str(caught.value)
    stated = Columns("50Hz", "dof_pos[0:2]", torque="dof_torque[1:3]")
    guess = guess_columns(
        path,
        KnownColumns(
            JOINTS,
            {"time": "50Hz", "position": stated.position, "torque": stated.torque},
        ),
    )
    log = read_recording(path, JOINTS, guess.columns)
    np.testing.assert_array_equal(log.position, q)
    np.testing.assert_array_equal(log.torque, torque)
    np.testing.assert_allclose(np.diff(log.time), 0.02)
    assert len(log) == len(t)


def test_a_clock_beside_a_counter_is_proposed(tmp_path):
    t, q, _, torque = motion()
    table = np.column_stack([np.arange(len(t)), 1000 * t, q, torque])
    header = "seqno,tm,q1,q2,tau1,tau2"
    path = written(tmp_path, table, header=header, comments="")
    with pytest.raises(RecordingError, match="tm: numbers that rise") as caught:
        guess_columns(path, KnownColumns(JOINTS))
    assert caught.value.options == "--time tm --units time=ms"


def test_the_rate_of_change_of_a_block_is_its_velocity_in_any_order():
    t, q, dq, torque = motion()
    found = column_layout(np.column_stack([t, torque, dq, q]), 2)
    assert (found.time, found.torque, found.velocity, found.position) == (1, 2, 4, 6)


def test_a_command_that_follows_the_position_is_no_torque():
    t, q, dq, torque = motion()
    found = column_layout(np.column_stack([t, q, dq, q + 1e-3, torque]), 2)
    assert (found.position, found.torque, found.others) == (2, 8, ())


def test_a_coarse_position_is_not_taken_for_the_torque_of_its_rates():
    t, q, dq, torque = motion(400)
    ddq = np.column_stack([-9 * q[:, 0], -4 * q[:, 1]])
    coarse = np.round(q, 2)
    found = column_layout(np.column_stack([t, coarse, dq, ddq, torque]), 2)
    assert (found.position, found.velocity) == (2, 4)


@pytest.mark.slow
def test_hundreds_of_columns_are_compared_in_a_moment():
    t, q, dq, torque = motion()
    noise = np.random.default_rng(0).normal(size=(len(t), 1200)).cumsum(axis=0)
    begun = process_time()
    found = column_layout(np.column_stack([t, q, dq, torque, noise]), 2)
    assert (found.position, found.velocity, found.torque) == (2, 4, 6)
    assert process_time() - begun < 3.0


def test_a_clock_rises_evenly():
    t = np.arange(100) * 0.01
    assert is_clock(t)
    assert is_clock(np.repeat(t, 2))
    assert not is_clock(np.repeat(t, 20))
    assert not is_clock(t[::-1])
    assert not is_clock(np.where(t > 0.5, t + 9.0, t))
    assert not is_clock(np.zeros(100))


def test_columns_without_a_header_are_proposed_quoted_and_read(tmp_path):
    t, q, dq, torque = motion()
    path = written(tmp_path, np.column_stack([t, q, dq, torque]))
    with pytest.raises(RecordingError, match="no header") as refusal:
        guess_columns(path, KnownColumns(JOINTS))
    assert refusal.value.options == (
        "--time column1 --position 'column{2..3}' --velocity 'column{4..5}' "
        "--torque 'column{6..7}'"
    )
    log = read_recording(
        path, JOINTS, Columns("column1", "column{2..3}", torque="column{6..7}")
    )
    assert abs(log.position - q).max() < 1e-6
    assert abs(log.torque - torque).max() < 1e-6


def test_numbers_without_a_clock_are_refused(tmp_path):
    _, q, dq, torque = motion()
    path = written(tmp_path, np.column_stack([q, dq, torque]))
    with pytest.raises(RecordingError, match="none of them rises like a clock"):
        guess_columns(path, KnownColumns(JOINTS))


def test_a_header_that_counts_the_columns_is_no_row(tmp_path):
    t, q, _, torque = motion()
    table = np.column_stack([t, q, torque])
    path = written(tmp_path, table, header="0,1,2,3,4", comments="")
    assert len(csv.read_arrays(path, ["column1"])["column1"]) == len(t)


def test_a_comment_names_the_columns_if_it_has_as_many_words(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("# recorded on a Monday\n0.5,1,2\n1.5,2,3\n")
    assert csv.array_names(path) == ("column1", "column2", "column3")
    path.write_text("# time,q_pan,tau_pan\n0.5,1,2\n1.5,2,3\n")
    assert csv.array_names(path) == ("time", "q_pan", "tau_pan")


def test_a_comment_of_savetxt_names_columns_that_commas_separate(tmp_path):
    t, q, _, torque = motion()
    names = "time q_pan q_lift tau_pan tau_lift"
    path = written(tmp_path, np.column_stack([t, q, torque]), header=names)
    assert csv.array_names(path) == tuple(names.split())
    read = csv.read_arrays(path, ["time", "tau_lift"])
    assert len(read["time"]) == len(t)
    np.testing.assert_allclose(read["tau_lift"], torque[:, 1], atol=1e-6)


@pytest.mark.parametrize("header", ["0,1,2", "100,200,300", "# by hand\n7,8,9"])
def test_numbers_in_a_header_are_names_if_they_are_stated(tmp_path, header):
    path = tmp_path / "log.csv"
    path.write_text(f"{header}\n0.5,1,2\n1.5,2,x\n")
    first, second, third = header.splitlines()[-1].split(",")
    read = csv.read_arrays(path, [first, second])
    assert read[first].tolist() == [0.5, 1.5]
    place = rf"row 2 \(line {2 + len(header.splitlines())}\), column '{third}'"
    with pytest.raises(RecordingError, match=place):
        csv.read_arrays(path, [third])


@pytest.mark.parametrize("pattern", ["column{2..4}", "column{4..2}"])
def test_a_range_has_as_many_numbers_as_there_are_joints(tmp_path, pattern):
    path = written(tmp_path, np.zeros((3, 7)))
    with pytest.raises(RecordingError, match="one for each of the 2 joints"):
        read_recording(path, JOINTS, Columns("column1", pattern))


def in_a_structure(folder, **more):
    from scipy.io import savemat

    t, q, _, torque = motion()
    fields = {
        "time_cont": t[None],
        "act_pos_se_deg": np.zeros_like(q).T,  # of encoders that are not there
        "act_pos_mot_deg": np.degrees(q).T,
        "act_torque_nm": torque.T,
    }
    savemat(folder / "data.mat", {"rec": fields, "note": "by hand"} | more)
    return folder / "data.mat"


def test_arrays_of_a_matlab_structure_are_found_with_their_clock(tmp_path):
    found = guess_columns(in_a_structure(tmp_path), KnownColumns(JOINTS))
    assert found.columns.time == "rec.time_cont"
    assert found.columns.position == "rec.act_pos_mot_deg"
    assert found.columns.torque == "rec.act_torque_nm"
    assert found.columns.units["position"] == "deg"


def test_of_two_clocks_none_is_taken(tmp_path):
    path = in_a_structure(tmp_path, time_ref=motion()[0])
    with pytest.raises(RecordingError, match=r"rec.time_cont, time_ref: numbers that"):
        guess_columns(path, KnownColumns(JOINTS))


def test_datasets_of_hdf5_are_found(tmp_path):
    import h5py

    t, q, _, torque = motion()
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["run/time"], file["run/q"], file["run/tau"] = t, q, torque
    found = guess_columns(tmp_path / "log.h5", KnownColumns(JOINTS))
    assert found.columns.position == "run/q"
    assert found.columns.torque == "run/tau"


def test_fewer_joints_than_the_robots_are_found_by_the_columns(tmp_path):
    t, q, dq, torque = motion()
    path = written(tmp_path, np.column_stack([t, q, dq, torque]))
    with pytest.raises(RecordingError) as refused:
        guess_columns(path, KnownColumns((*JOINTS, "finger")))
    assert refused.value.options == (
        "--lock finger --time column1 --position 'column{2..3}' "
        "--velocity 'column{4..5}' --torque 'column{6..7}'"
    )


def test_without_a_clock_a_rate_is_asked_for_and_used(tmp_path):
    _, q, dq, torque = motion()
    path = written(tmp_path, np.column_stack([q, dq, torque]))
    with pytest.raises(RecordingError, match="state their rate") as refused:
        guess_columns(path, KnownColumns(JOINTS))
    assert refused.value.options == "--time RATEHz"
    with pytest.raises(RecordingError) as refused:
        guess_columns(path, KnownColumns(JOINTS, {"time": "100Hz"}))
    assert refused.value.options == (
        "--position 'column{1..2}' --velocity 'column{3..4}' --torque 'column{5..6}'"
    )
    columns = Columns("100Hz", "column{1..2}", torque="column{5..6}")
    log = read_recording(path, JOINTS, columns)
    np.testing.assert_allclose(log.time, np.arange(200) / 100.0, rtol=1e-15)


@pytest.mark.parametrize(
    ("clock", "options"),
    [
        ("Tick", "--time RATEHz"),  # rows, or milliseconds at 1000 Hz
        ("duration", "--time duration --units time=ms"),
    ],
)
def test_a_column_that_counts_by_one_is_no_clock_unless_its_name_says_so(
    tmp_path, clock, options
):
    t, q, _, torque = motion()
    names = [clock, "q1", "q2", "tau1", "tau2"]
    table = np.column_stack([np.arange(len(t)), q, torque])
    log = written(tmp_path, table, header=",".join(names), comments="")
    with pytest.raises(RecordingError) as caught:
        guess_columns(log, KnownColumns(JOINTS))
    assert caught.value.options == options


@pytest.mark.parametrize(
    ("others", "clock"),
    [
        (["timestamp"], "timestamp"),  # a minimum and an enthalpy beside it
        (["time_ms"], "time_ms"),
        (["StampSec", "StampNanoSec"], "StampSec + StampNanoSec"),
        ([], "time_h"),
    ],
)
def test_minutes_and_hours_are_of_a_clock_if_no_other_is_there(tmp_path, others, clock):
    t, q, _, torque = motion()
    names = ["t_min", *others, "time_h", "q1", "q2", "tau1", "tau2"]
    columns = [0 * t - 1.0, *[t] * len(others), t / 3600.0, q, torque]
    path = tmp_path / "log.csv"
    header = ",".join(names)
    np.savetxt(path, np.column_stack(columns), "%.12g", ",", header=header, comments="")
    assert guess_columns(path, KnownColumns(JOINTS)).columns.time == clock


def test_the_clock_is_the_shortest_name_whose_numbers_rise(tmp_path):
    t, q, _, torque = motion()
    table = np.column_stack([0 * t + 7.0, t, q, torque])
    path = written(tmp_path, table, header="t,time,q1,q2,tau1,tau2", comments="")
    assert guess_columns(path, KnownColumns(JOINTS)).columns.time == "time"
