"""Logs of servos: columns, units, clocks and values that are missing."""

from dataclasses import replace

import numpy as np
import pytest
from servo_pendulum import (
    a_log,
    written,
)

from consistent_id.cli import main
from consistent_id.errors import RecordingError
from consistent_id.rollout import read_servo_logs
from consistent_id.rollout.servo_bounds import duty_law
from consistent_id.rollout.servo_columns import logged_joints
from consistent_id.rollout.servo_log import read_servo_sets


@pytest.mark.slow
def test_columns_units_gaps_and_full_duty_are_found(pendulum, tmp_path):
    log = a_log(pendulum)
    (read,) = read_servo_logs([written(tmp_path / "a.csv", log)], ("servo",))
    assert np.allclose(read.position, log.position)
    assert np.allclose(read.duty, log.duty)
    names = "timestamp,present_position,cmd,pwm"
    ticks = written(tmp_path / "t.csv", log, names, 2 * np.pi / 4096)
    with pytest.raises(RecordingError, match="--angles ticks"):
        read_servo_logs([ticks], ("servo",))
    (read,) = read_servo_logs([ticks], ("servo",), units="ticks", full_duty=885)
    assert np.allclose(read.goal, log.goal)
    broken = replace(log, time=log.time + (log.time > 1.0))
    parts = read_servo_logs([written(tmp_path / "g.csv", broken)], ("servo",))
    assert [part.name for part in parts] == ["g.csv, part 1", "g.csv, part 2"]
    with pytest.raises(RecordingError, match=r"goal of servo.*--columns goal=COLUMN"):
        read_servo_logs([written(tmp_path / "n.csv", log, "t,q,x,y")], ("servo",))


def test_ticks_that_are_all_positive_need_their_zero(pendulum, tmp_path):
    """With the zero at half a turn, the weight of the arm had the wrong sign."""
    log = a_log(pendulum)
    turn = np.pi  # of 2048 ticks
    shifted = replace(log, position=log.position + turn, goal=log.goal + turn)
    unit = 2 * np.pi / 4096
    file = written(tmp_path / "t.csv", shifted, unit=unit)
    with pytest.raises(RecordingError, match="none is negative") as caught:
        read_servo_logs([file], ("servo",), units="ticks")
    assert caught.value.options == "--zero 2048"
    (read,) = read_servo_logs([file], ("servo",), units="ticks", zero=[2048])
    assert np.allclose(read.position, log.position)
    assert np.allclose(read.goal, log.goal)
    (read,) = read_servo_logs([file], ("servo",), units="ticks", zero=[0])
    assert np.allclose(read.position, shifted.position)
    with pytest.raises(RecordingError, match="zero has 2 numbers"):
        read_servo_logs([file], ("servo",), units="ticks", zero=[0, 1])


def test_whole_numbers_are_answered_with_ticks_and_their_zero(pendulum, tmp_path):
    log = a_log(pendulum)
    counts = replace(log, position=np.round(2048 + 2000 * log.position), goal=log.goal)
    with pytest.raises(RecordingError, match="whole numbers are ticks") as caught:
        read_servo_logs([written(tmp_path / "t.csv", counts)], ("servo",))
    assert caught.value.options == "--angles ticks --zero 2048"


@pytest.mark.parametrize("name", ["time", "time_ms"])
def test_times_of_a_servo_are_in_the_unit_of_their_name_or_as_stated(
    pendulum, tmp_path, name
):
    log = a_log(pendulum)
    names = f"{name},position,goal_position,load"
    file = written(tmp_path / "t.csv", replace(log, time=log.time), names)
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[:, 0] *= 1e3
    np.savetxt(file, table, delimiter=",", header=names, comments="")
    if name == "time":
        with pytest.raises(RecordingError, match="or --times ms") as caught:
            read_servo_logs([file], ("servo",))
        assert caught.value.options == "--times ms"
    times = "ms" if name == "time" else None
    (read,) = read_servo_logs([file], ("servo",), times=times)
    assert np.allclose(read.time, log.time)


@pytest.mark.parametrize(("unit", "period"), [("day", 1e-2 / 86400), ("100ns", 1e5)])
def test_the_unit_of_the_time_that_a_message_proposes_is_accepted(
    file, tmp_path, unit, period, capsys
):
    """``--times day`` was proposed, and refused."""
    rows = 6.0e17 / period if unit == "100ns" else 45000.0 / period
    path = table_log(tmp_path / "a.csv", {"q": 0.0, "cmd": 0.0}, period=period)
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table[:, 0] += period * np.round(rows)
    np.savetxt(path, table, "%.18g", delimiter=",", header="t,q,cmd", comments="")
    with pytest.raises(RecordingError, match="median time between") as caught:
        read_servo_logs([path], ("servo",))
    assert caught.value.options == f"--times {unit}"
    (log,) = read_servo_logs([path], ("servo",), times=unit)
    assert log.period == pytest.approx(1e-2, rel=1e-3)
    words = ["servo", str(file), str(path), "--times", unit, "--dry-run"]
    main(words)
    said = capsys.readouterr().err
    assert "--times" not in said
    assert main([*words[:4], "fortnight"]) != 0
    assert "no unit 'fortnight' of time" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ({"times": "millis"}, "no unit 'millis' of time"),
        ({"units": "counts"}, "units: no unit 'counts'"),
        ({"zero": "middle"}, "zero: expected numbers"),
        ({"zero": [[0.0, 1.0]]}, r"zero: expected shape \(any\)"),
        ({"zero": np.nan}, "zero: entry"),
        ({"full_duty": 0.0}, "full_duty is 0.0, expected a positive number"),
        ({"full_duty": "all"}, "full_duty: expected numbers"),
        ({"columns": {"torque": "q"}}, "columns: no role 'torque'"),
        ({"columns": {"position": "angle"}}, "angle"),
    ],
)
def test_options_with_other_values_are_refused(tmp_path, option, said):
    """Times in ``millis`` were read as seconds, in silence."""
    path = table_log(tmp_path / "a.csv", {"q": 0.0, "cmd": 0.0})
    with pytest.raises(RecordingError, match=said):
        read_servo_logs([path], ("j",), **option)


def test_one_zero_may_be_a_number(tmp_path):
    path = table_log(tmp_path / "a.csv", {"q": 2048.0, "cmd": 2048.0})
    (log,) = read_servo_logs([path], ("j",), units="ticks", zero=2048)
    assert not log.position.any()


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("q", np.array(["a"] * 30), "q: expected numbers"),
        ("q", np.zeros(29), r"q: expected shape \(30\)"),
        ("q", np.zeros((30, 2)), r"q: expected shape \(30\)"),
        ("pwm", np.zeros(1), r"pwm: expected shape \(30\)"),
    ],
)
def test_arrays_that_are_no_columns_are_refused(tmp_path, name, values, said):
    arrays = {"t": 0.01 * np.arange(30), "q": np.zeros(30), "cmd": np.zeros(30)}
    np.savez(tmp_path / "a.npz", **(arrays | {name: values}))
    with pytest.raises(RecordingError, match=said):
        read_servo_logs([tmp_path / "a.npz"], ("j",))


def test_each_joint_of_an_arm_has_its_own_columns(tmp_path):
    path = tmp_path / "arm.csv"
    names = "t,action.b,action.a,state.b,state.a,voltage"
    rows = np.column_stack(
        [np.arange(30) / 30.0, *(k + np.zeros(30) for k in range(5))]
    )
    np.savetxt(path, rows, delimiter=",", header=names, comments="")
    (log,) = read_servo_logs([path], ("a", "b"))
    assert log.goal[0].tolist() == [1.0, 0.0]
    assert log.position[0].tolist() == [3.0, 2.0]
    assert log.volts == 4.0
    assert log.duty is None
    assert logged_joints([path], ("a", "finger", "b")) == ("a", "b")
    assert logged_joints([path], ("x", "y")) == ("x", "y")


def table_log(path, columns, rows=30, period=1 / 30):
    """Write columns, shape (rows,) or constant, beside time."""
    values = [np.broadcast_to(v, rows) for v in columns.values()]
    table = np.column_stack([period * np.arange(rows), *values])
    names = ",".join(["t", *columns])
    np.savetxt(path, table, delimiter=",", header=names, comments="")
    return path


def test_missing_values_are_neither_zero_duty_nor_a_motor_that_is_off(tmp_path):
    ramp = np.linspace(0.0, 0.5, 30)
    missing = np.arange(30) % 3 == 1
    columns = {"q": 0.0, "cmd": ramp, "pwm": np.where(missing, np.nan, ramp)}
    columns |= {"torque_enable": np.where(missing, np.nan, np.arange(30) < 20)}
    columns |= {"volts": np.nan, "temp": np.nan}
    path = table_log(tmp_path / "a.csv", columns)
    (log,) = read_servo_logs([path], ("j",), full_duty=1.0)
    assert np.isnan(log.duty[missing]).all()
    law = duty_law(log, 0)
    assert law.gain == pytest.approx(1.0)
    assert law.misfit < 1e-12
    assert log.enabled[:, 0].tolist() == [1.0] * 20 + [0.0] * 10
    assert log.volts is None
    assert log.temperature is None
    columns["pwm"] = np.nan
    path = table_log(tmp_path / "b.csv", columns)
    assert read_servo_logs([path], ("j",))[0].duty is None


@pytest.mark.parametrize("nothing", ["", "nan", "NA"])
def test_empty_cells_of_a_text_are_values_that_are_not_known(tmp_path, nothing):
    """The message proposed `--missing omit`, which the command does not have."""
    rows = [
        f"{0.02 * k:.2f},{np.sin(k / 9):.4f},{np.sin(k / 9):.4f},7" for k in range(90)
    ]
    rows[4:40] = [row.removesuffix("7") + nothing for row in rows[4:40]]
    rows[50] = f"1.0,{nothing},0.2,7"
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["time,position,goal,voltage", *rows]))
    (log,) = read_servo_logs([file], ("servo",))
    assert len(log.time) == 89  # without the row that has no position
    assert log.volts == 7.0


def test_the_time_of_a_servo_is_the_column_that_is_named_so(tmp_path):
    """The first column with the word was taken, such as a limit."""
    ramp = np.linspace(0.0, 0.5, 30)
    columns = {"time_limit": 9.0 + 0.0 * ramp, "q": ramp, "cmd": ramp}
    path = table_log(tmp_path / "a.csv", columns)
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines]
    path.write_text("\n".join(",".join([*row[1:], row[0]]) for row in rows))
    (log,) = read_servo_logs([path], ("j",))
    assert np.ptp(log.time) > 0.0


def test_a_column_is_of_the_longest_joint_that_it_names_and_of_no_other(tmp_path):
    columns = {"wrist_roll.pos": 1.0, "wrist_roll.cmd": 2.0}
    columns |= {"wrist.pos": 3.0, "wrist.cmd": 4.0}
    path = table_log(tmp_path / "a.csv", columns)
    (log,) = read_servo_logs([path], ("wrist", "wrist_roll"))
    assert log.position[0].tolist() == [3.0, 1.0]
    assert log.goal[0].tolist() == [4.0, 2.0]
    (log,) = read_servo_logs([path], ("wrist",))
    assert log.position[0, 0] == 3.0
    assert logged_joints([path], ("wrist", "wrist_roll")) == ("wrist", "wrist_roll")
    few = table_log(tmp_path / "b.csv", dict(list(columns.items())[:2]))
    assert logged_joints([few], ("wrist", "wrist_roll")) == ("wrist_roll",)
    with pytest.raises(RecordingError, match="no column is the position of wrist"):
        read_servo_logs([few], ("wrist", "wrist_roll"))
    with pytest.raises(RecordingError, match=r"column 'wrist\.pos' would be"):
        read_servo_logs(
            [path], ("wrist", "wrist_roll"), columns={"position": "wrist.pos"}
        )
    with pytest.raises(RecordingError, match="position and goal"):
        read_servo_logs([path], ("wrist",), columns={"goal": "wrist.pos"})


def test_times_in_milliseconds_or_nanoseconds_are_refused(tmp_path):
    for period in (5.0, 5e6, 1e-5):
        path = table_log(tmp_path / "a.csv", {"q": 0.0, "cmd": 0.0}, period=period)
        with pytest.raises(
            RecordingError, match=r"expected 0\.0005 to 0\.5 s; are the"
        ):
            read_servo_logs([path], ("j",))


def test_a_held_load_is_not_full_duty_but_a_duty_that_stays_while_the_error_grows(
    tmp_path,
):
    ramp = np.linspace(0.0, 1.0, 30)
    for limit, full in ((np.inf, 885.0), (300.0, 300.0)):
        error = np.minimum(ramp, 0.5) if np.isinf(limit) else ramp
        duty = np.minimum(800.0 * error, limit)
        path = table_log(tmp_path / "a.csv", {"q": 0.0, "cmd": error, "pwm": duty})
        (log,) = read_servo_logs([path], ("j",))
        assert np.allclose(log.duty[:, 0], duty / full)


def test_logs_of_the_same_name_in_two_folders_are_two_logs(tmp_path):
    files = []
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        columns = {"q": 0.0, "cmd": float(folder == "y")}
        files.append(table_log(tmp_path / folder / "a.csv", columns))
    other = table_log(tmp_path / "x" / "c.csv", {"q": 0.0, "cmd": 2.0})
    sets = read_servo_sets([files[0], other], [files[1]], ("j",))
    assert [log.goal[0, 0] for log in sets.training] == [0.0, 2.0]
    assert [log.goal[0, 0] for log in sets.validation] == [1.0]
    names = [log.name for logs in sets for log in logs]
    assert names == [files[0].as_posix(), "c.csv", files[1].as_posix()]
    with pytest.raises(RecordingError, match="given twice"):
        read_servo_sets([other], [tmp_path / "y" / ".." / "x" / "c.csv"], ("j",))
