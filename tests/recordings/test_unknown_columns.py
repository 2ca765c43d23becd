"""Columns whose names say nothing, and arrays wider than the robot, are proposed."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns, of_unit
from consistent_id.recordings.column_words import is_bare
from consistent_id.recordings.readers import Columns, csv, read_recording
from consistent_id.recordings.unknown_columns import joints_of_wide

JOINTS = ("pan", "lift")
TIME = np.arange(300) * 0.01
Q = np.column_stack([np.sin(3 * TIME), np.cos(2 * TIME)])
DQ = np.column_stack([3 * np.cos(3 * TIME), -2 * np.sin(2 * TIME)])
TAU = 5 * Q**3 + 1.0


def options_of(path, joints=JOINTS, channels=()):
    with pytest.raises(RecordingError) as caught:
        guess_columns(path, KnownColumns(joints, dict(channels)))
    return caught.value.options


def read_with(path, options, joints=JOINTS):
    """Read a log with options, as a shell passes them."""
    words = options.replace("'", "").split()
    channels = {w[2:]: v for w, v in zip(words[::2], words[1::2], strict=True)}
    guess = guess_columns(path, KnownColumns(joints, channels))
    return read_recording(path, joints, guess.columns)


def assert_is_read(log):
    np.testing.assert_allclose(log.position, Q)
    np.testing.assert_allclose(log.torque, TAU)


@pytest.mark.parametrize(
    "names",
    [
        ("posicion_{}", "velocidad_{}", "par_{}"),
        ("угол{}", "скорость{}", "момент{}"),
        ("pozycja_{}", "predkosc_{}", "naped_{}"),
    ],
)
def test_words_of_other_languages_are_found_by_their_numbers(tmp_path, names):
    header = ["t", *(name.format(k) for name in names for k in (1, 2))]
    path = tmp_path / "log.csv"
    table = np.column_stack([TIME, Q, DQ, TAU])
    np.savetxt(path, table, "%.17g", ",", header=",".join(header), comments="")
    options = options_of(path)
    each = [name.format("{number}") for name in names]
    channels = ("position", "velocity", "torque")
    expected = [f"--{c} '{n}'" for c, n in zip(channels, each, strict=True)]
    assert options == " ".join(expected)
    assert_is_read(read_with(path, options))


def test_letters_that_are_not_latin_are_a_word():
    """Such a column was taken as the position, because it had no word."""
    assert is_bare("{number}")
    assert not is_bare("角度{number}")
    assert not is_bare("скорость{number}")


@pytest.mark.parametrize("lying", [False, True])
def test_a_state_is_split_into_position_and_velocity(tmp_path, lying):
    """Drake's logs have samples in columns."""
    path = tmp_path / "log.npz"
    arrays = {"x": np.hstack([Q, DQ]), "u": TAU}
    arrays = {n: v.T if lying else v for n, v in arrays.items()}
    np.savez(path, sample_times=TIME, **arrays)
    options = options_of(path)
    assert options == "--position 'x[0:2]' --velocity 'x[2:4]' --torque u"
    assert_is_read(read_with(path, options))


def test_the_columns_of_one_matrix_are_found(tmp_path):
    path = tmp_path / "log.mat"
    savemat(path, {"data": np.column_stack([TIME, Q, DQ, TAU])})
    clock = options_of(path)
    assert clock == "--time 'data[0:1]'"
    options = options_of(path, channels={"time": "data[0:1]"})
    assert options.startswith("--position 'data[1:3]' --velocity 'data[3:5]'")
    assert_is_read(read_with(path, f"{clock} {options}"))


def test_arrays_wider_than_the_robot_are_answered_with_the_part_that_moves(tmp_path):
    path = tmp_path / "log.npz"
    rest = np.zeros((len(TIME), 1))
    arrays = {"qpos": Q, "qvel": DQ, "tau": TAU}
    np.savez(path, time=TIME, **{n: np.hstack([v, rest]) for n, v in arrays.items()})
    options = options_of(path)
    parts = "--position 'qpos[0:2]' --velocity 'qvel[0:2]' --torque 'tau[0:2]'"
    assert options == parts
    assert_is_read(read_with(path, options))
    wide = {"position": np.hstack([rest, Q, rest])}
    assert joints_of_wide(wide, 3) == {"position": (1, 3)}
    assert joints_of_wide({"torque": np.hstack([Q, Q])}, 2) == {"torque": (0, 2)}


def test_a_free_body_before_the_arm_is_left_out_of_each_array(tmp_path):
    """MuJoCo's qpos has a column more for it than its qvel; no drive moves it."""
    path = tmp_path / "log.npz"
    moves, rest = np.outer(np.sin(TIME), np.ones(7)), np.zeros((len(TIME), 6))
    arrays = {"qpos": np.hstack([moves, Q]), "qvel": np.hstack([moves[:, :6], DQ])}
    np.savez(path, time=TIME, **arrays, qfrc_actuator=np.hstack([rest, TAU]))
    options = options_of(path)
    parts = "--position 'qpos[7:9]' --velocity 'qvel[6:8]'"
    assert options == f"{parts} --torque 'qfrc_actuator[6:8]'"
    assert_is_read(read_with(path, options))


def test_an_array_can_be_stated(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=TIME, one=Q, other=TAU)
    assert_is_read(read_with(path, "--position one --torque other"))


def test_the_first_of_several_runs_in_a_file_is_proposed(tmp_path):
    """As robomimic's data sets; two grippers were proposed as joints."""
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        for demo in ("demo_0", "demo_1", "demo_2"):
            group = file.create_group(f"data/{demo}/obs")
            group["robot0_joint_pos"], group["robot0_torques"] = Q, TAU
            group["robot0_joint_pos_cos"] = np.cos(Q)
            group["robot0_gripper_qpos"] = np.zeros((len(TIME), 3))
    options = options_of(path, channels={"time": "100Hz"})
    first = "data/demo_0/obs/robot0"
    assert options == f"--position {first}_joint_pos --torque {first}_torques"
    assert_is_read(read_with(path, f"--time 100Hz {options}"))


@pytest.mark.parametrize(("first", "rail"), [(0, False), (1, False), (0, True)])
def test_a_numbered_column_too_many_is_not_left_out_in_silence(tmp_path, first, rail):
    """Of q0, q1 and a gripper's q2, the last two were read as the two joints."""
    rest = np.zeros((len(TIME), 1))
    parts = [np.hstack([rest, v] if rail else [v, rest]) for v in (Q, DQ, TAU)]
    header = ["t"]
    header += [f"{w}{first + k}" for w in ("q", "dq", "tau") for k in range(3)]
    path = tmp_path / "log.csv"
    table = np.column_stack([TIME, *parts])
    np.savetxt(path, table, "%.17g", ",", header=",".join(header), comments="")
    options = options_of(path)
    ends = f"{{{first + rail}..{first + rail + 1}}}"
    channels = (("position", "q"), ("velocity", "dq"), ("torque", "tau"))
    assert options == " ".join(f"--{c} '{word}{ends}'" for c, word in channels)
    assert_is_read(read_with(path, options))


@pytest.mark.parametrize(
    ("q", "tau", "options"),
    [
        ((1, 2), (0, 3), "--torque 'tau{1..2}'"),
        ((0, 3), (1, 2), "--position 'q{1..2}'"),
        ((1, 2), (5, 8), ""),
    ],
)
def test_a_channel_with_a_column_for_each_joint_says_the_numbers(
    tmp_path, q, tau, options
):
    """The torque was proposed as the position."""
    names = [f"q{k}" for k in range(q[0], q[1] + 1)]
    names += [f"tau{k}" for k in range(tau[0], tau[1] + 1)]
    path = tmp_path / "log.csv"
    table = np.column_stack([TIME, *(np.sin(k + TIME) for k in range(len(names)))])
    np.savetxt(path, table, "%.9g", ",", header=",".join(["t", *names]), comments="")
    assert options_of(path) == options
    if options:
        log = read_with(path, options)
        first = [1 + names.index(name) for name in ("q1", "tau1")]
        np.testing.assert_allclose(log.position[:, 0], table[:, first[0]], atol=1e-8)
        np.testing.assert_allclose(log.torque[:, 0], table[:, first[1]], atol=1e-8)


def test_proposed_numbers_with_zeros_before_them_are_read(tmp_path):
    names = [f"{w}_{k:02d}" for w in ("q", "tau") for k in range(3)]
    rest = np.zeros(len(TIME))
    path = tmp_path / "log.csv"
    table = np.column_stack([TIME, Q, rest, TAU, rest])
    np.savetxt(path, table, "%.17g", ",", header=",".join(["t", *names]), comments="")
    options = options_of(path)
    assert options == "--position 'q_{00..01}' --torque 'tau_{00..01}'"
    assert_is_read(read_with(path, options))


GRIPPER = 0.1 * np.sin(5 * TIME)[:, None]
REST = np.zeros((len(TIME), 1))


@pytest.mark.parametrize("lying", [False, True])
@pytest.mark.parametrize(
    ("q", "dq", "first"),
    [
        ([Q, REST], [DQ], 0),  # the gripper rests
        ([REST, Q], [DQ], 1),
        ([Q, GRIPPER], [DQ], 0),  # it moves: its velocity is not in the log
        ([GRIPPER, Q], [DQ], 1),
    ],
)
def test_wide_positions_are_aligned_by_their_motion(tmp_path, q, dq, first, lying):
    path = tmp_path / "log.npz"
    arrays = {"q": np.hstack(q), "dq": np.hstack(dq), "tau": TAU}
    turned = {n: v.T if lying else v for n, v in arrays.items()}
    np.savez(path, time=TIME, **turned)
    options = options_of(path)
    assert options.startswith(f"--position 'q[{first}:{first + 2}]'")
    assert_is_read(read_with(path, options))


def test_columns_of_wide_arrays_that_nothing_aligns_are_left_to_the_user(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=TIME, q=np.hstack([Q, Q]), tau=TAU)
    with pytest.raises(RecordingError) as caught:
        guess_columns(path, KnownColumns(JOINTS))
    assert caught.value.options == ""
    assert "first of them: --position 'q[0:2]'" in str(caught.value)
    assert "last: --position 'q[2:4]'" in str(caught.value)


def test_one_matrix_with_samples_in_columns_is_found(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, log=np.column_stack([TIME, Q, DQ, TAU]).T)
    clock = options_of(path)
    assert clock == "--time 'log[0:1]'"
    options = options_of(path, channels={"time": "log[0:1]"})
    assert_is_read(read_with(path, f"{clock} {options}"))
    with_rate = options_of(path, channels={"time": "100Hz"})  # its clock is no joint
    assert with_rate == options


def test_a_table_is_read_once_for_a_message(tmp_path, monkeypatch):
    """Columns of each run were read from the whole file, for each number of joints."""
    header = ["t", *(f"{word}{k}" for word in "xyz" for k in (1, 2))]
    path = tmp_path / "log.csv"
    table = np.column_stack([TIME, Q, DQ, TAU])
    np.savetxt(path, table, "%.9g", ",", header=",".join(header), comments="")
    times, read_arrays = [], csv.read_arrays

    def counted(*args, **more):
        times.append(args)
        return read_arrays(*args, **more)

    monkeypatch.setattr(csv, "read_arrays", counted)
    assert options_of(path).startswith("--position 'x{number}'")
    assert len(times) == 1


def test_a_log_with_a_clock_alone_is_answered(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=TIME)
    assert options_of(path, channels={"time": "100Hz"}) == ""


def test_a_log_of_a_clock_alone_has_no_position(tmp_path):
    np.savez(tmp_path / "log.npz", time=TIME)
    with pytest.raises(RecordingError, match="no column that is the position"):
        guess_columns(tmp_path / "log.npz", KnownColumns(JOINTS, {"time": "100Hz"}))


def test_numbers_are_no_columns(tmp_path):
    np.savez(tmp_path / "log.npz", q=1.0, tau=2.0)
    stated = {"time": "100Hz", "position": "q", "torque": "tau"}
    with pytest.raises(RecordingError, match=r"'q' has shape \(\)"):
        read_recording(tmp_path / "log.npz", JOINTS[:1], Columns(**stated))


@pytest.mark.parametrize("clock", ["time", "t_q"])
def test_texts_beside_a_channel_are_not_read(tmp_path, clock):
    said = np.array(["ok"] * len(TIME))
    path = tmp_path / "log.npz"
    arrays = {"q": Q, "tau": TAU, "t_tau": said, "tau_raw": np.array([["a", "b"]])}
    np.savez(path, **{clock: TIME}, **arrays)
    assert_is_read(read_recording(path, JOINTS, columns_of(path)))


def columns_of(path):
    return guess_columns(path, KnownColumns(JOINTS, {})).columns


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.yaml", ""), ("a.json", "{}"), ("a.csv", "\n"), ("a.json", '{"x": [1, {}]}')],
)
def test_a_file_without_columns_is_no_log(tmp_path, name, text):
    """The message said, the log has ., with a rate to state."""
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match="no column or array of numbers"):
        columns_of(tmp_path / name)


def test_columns_with_names_of_numbered_joints_are_proposed_once():
    """They were two proposals, `brakejoint_{1..2}` and `brake{joint}`, so none."""
    joints = ("joint_1", "joint_2")
    names = ["t", *joints, "brakejoint_1_Nm", "brakejoint_2_Nm"]
    found = of_unit("torque", names, joints)
    option = "--torque 'brakejoint_{number}_Nm'"
    assert found == {"brakejoint_{1..2}_Nm": option}


def test_an_array_whose_first_joint_moves_evenly_is_no_table_with_a_clock(tmp_path):
    path = tmp_path / "log.npz"
    q, dq = Q.copy(), DQ.copy()
    q[:, 0], dq[:, 0] = 0.3 * TIME, 0.3
    np.savez(path, t=TIME, x=q, y=dq, z=TAU)
    assert options_of(path) == "--position x --velocity y --torque z"


@pytest.mark.parametrize("name", ["fan{}_rpm", "temp{}", "status{}", "motor{}_pos"])
def test_columns_of_another_thing_are_not_proposed_as_the_torque(tmp_path, name):
    """Columns with a unit of velocity, or with words of a position, were."""
    header = ["t", *(n.format(k) for n in ("q{}", "dq{}", name) for k in (1, 2))]
    path = tmp_path / "log.csv"
    table = np.column_stack([TIME, Q, DQ, TAU])
    np.savetxt(path, table, "%.17g", ",", header=",".join(header), comments="")
    assert "--torque" not in options_of(path)


def test_a_simulated_torque_beside_more_columns_is_not_proposed(tmp_path):
    names = ("q{}", "tau_sim{}")
    header = ["t", *(name.format(k) for name in names for k in (1, 2, 3))]
    path = tmp_path / "log.csv"
    wide = [np.column_stack([values, 0.0 * TIME]) for values in (Q, TAU)]
    table = np.column_stack([TIME, *wide])
    np.savetxt(path, table, "%.17g", ",", header=",".join(header), comments="")
    assert options_of(path) == "--position 'q{1..2}'"


def write_columns(path, **columns):
    rows = np.column_stack([TIME, *(c for each in columns.values() for c in each.T)])
    heads = ["time", *(f"{name}_{joint}" for name in columns for joint in JOINTS)]
    np.savetxt(path, rows, delimiter=",", header=",".join(heads), comments="")
    return path


@pytest.mark.parametrize("mark", ["ddq", "qdd", "qddot", "acc"])
def test_accelerations_are_not_proposed_as_torque(tmp_path, mark):
    file = write_columns(tmp_path / "log.csv", q=Q, dq=DQ, **{mark: TAU, "error": Q})
    assert options_of(file) == ""


def test_a_designed_motion_is_no_log(tmp_path):
    file = write_columns(tmp_path / "trajectory.csv", q=Q, dq=DQ, ddq=TAU)
    with pytest.raises(RecordingError, match="a motion as excite writes it, and no"):
        guess_columns(file, KnownColumns(JOINTS))
