"""Servos without torque: logs read, motion simulated, parameters found again."""

import json
from dataclasses import replace

import numpy as np
import pytest
from schemas import parsed

from consistent_id.cli import main
from consistent_id.errors import ModelError, NotExcitedError, RecordingError
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow, from_modified_dh
from consistent_id.robot.loaders.robot_file import load_robot
from consistent_id.rollout import ServoLog, identify_servos, read_servo_logs
from consistent_id.rollout import servo_fit as fitting
from consistent_id.rollout.servo_bounds import box_of, duty_law
from consistent_id.rollout.servo_columns import logged_joints
from consistent_id.rollout.servo_log import read_servo_sets
from consistent_id.rollout.servo_motion import (
    STEP,
    LoggedDrive,
    _friction_by_load,
    cut_pieces,
    finite_errors,
    position_errors,
    rigid_model,
    sampled_motion,
    simulated,
)
from consistent_id.rollout.servo_result import JointServo, ServoFit, ServoForm
from consistent_id.rollout.servo_search import (
    SearchDistribution,
    descended,
    evolved,
)

PENDULUM = """<robot name="pendulum"><link name="bench"/>
<link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
<joint name="servo" type="revolute"><origin rpy="0 1.5707963267948966 0"/>
<parent link="bench"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3.2" upper="3.2" effort="1" velocity="20"/></joint></robot>"""
TRUTH = {"stall": 0.7, "viscous": 0.03, "armature": 0.002, "coulomb": 0.02}
TRUTH |= {"delay": 0.005, "zero": 0.01}
GAIN = 1.5  # 1/rad


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("servo") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return path


@pytest.fixture(scope="module")
def pendulum(file):
    return load_robot(file)


def a_log(robot, seconds=3.0, frequency=0.7, name="log", **planted):
    """A log of the planted servo, by the simulation itself, of 12 bits a turn."""
    time = np.arange(0.0, seconds, 0.005)
    goal = 0.9 * np.sin(2 * np.pi * frequency * time) * np.sin(time) ** 2
    goal = goal[:, None]
    plain = ServoLog(name, robot.joint_names, time, 0.0 * goal, goal)
    pieces = cut_pieces(robot, [plain], 0, [LoggedDrive(GAIN, 0.0)])
    sets = {k: np.array([v]) for k, v in (TRUTH | planted).items()}
    q = simulated(sets, pieces)[:, 0, 0]
    q = np.interp(time, STEP * np.arange(len(q)), q)
    tick = 2 * np.pi / 4096
    q = (np.round(q / tick) * tick)[:, None]
    duty = np.clip(GAIN * (goal - q), -1.0, 1.0)
    return replace(plain, position=q, duty=duty)


def test_a_joint_of_an_arm_feels_all_its_torque_as_a_fourier_series():
    rows = [DHRow(np.pi / 2 * (k == 1), 0.3 * (k > 0)) for k in range(3)]
    robot = from_modified_dh("arm", rows, gravity=(0.0, -9.81, 1.0))
    body = np.array([1.0, 0.15, 0.02, 0.03, 0.05, 0.003, 0.06, 0.002, 0.001, 0.07])
    links = [replace(k, nominal=InertialParameters(body)) for k in robot.links]
    robot = replace(robot, links=tuple(links))
    time = np.arange(0.0, 0.5, 0.01)
    q = np.column_stack([np.sin(time + k) for k in range(3)])
    log = ServoLog("log", robot.joint_names, time, q, q)
    pieces = cut_pieces(robot, [log], 1, [LoggedDrive(1.0, 0.0)])
    at, place, speed, rate = 99, 0.4, -1.7, 2.3
    series = [1.0, np.cos(place), np.sin(place), np.cos(2 * place), np.sin(2 * place)]
    found = pieces.inertia[at, 0] * rate
    found += (pieces.still[at, 0] + speed * pieces.moving[at, 0]) @ series
    t = at * STEP
    state = [
        np.array([[f(t + k) * s for k in range(3)]])
        for f, s in ((np.sin, 1.0), (np.cos, 1.0), (np.sin, -1.0))
    ]
    state[0][0, 1], state[1][0, 1], state[2][0, 1] = place, speed, rate
    bodies = np.concatenate([k.nominal.vector for k in robot.links])
    expected = rigid_model(robot).rigid_torque(bodies, state)[0, 1]
    # the other joints' derivatives are smoothed
    assert found == pytest.approx(expected, rel=2e-3)


def test_a_pendulum_without_a_motor_has_its_period(pendulum):
    time = np.arange(0.0, 4.0, 0.005)
    length = (0.5 * 0.01 + 1e-5 + 0.002) / (0.5 * 0.1)  # of the equal simple pendulum
    q = 0.05 * np.cos(np.sqrt(9.81 / length) * time)[:, None]
    log = ServoLog("swing", ("servo",), time, q, 0.0 * q)
    pieces = cut_pieces(pendulum, [log], 0, [LoggedDrive(0.0, 0.0)])
    errors = position_errors(
        {"stall": np.array([1.0, 1.0]), "armature": np.array([0.002, 0.004])}, pieces
    )[:, 0]
    assert errors[0] < 2e-3 < 2e-2 < errors[1]


def test_friction_that_depends_on_load_holds_what_coulomb_friction_does_not(pendulum):
    time = np.arange(0.0, 1.0, 0.005)
    q = np.full((len(time), 1), 0.5)
    pieces = cut_pieces(
        pendulum, [ServoLog("held", ("servo",), time, q, q)], 0, [LoggedDrive(0.0, 0.0)]
    )
    torque = 0.5 * 9.81 * 0.1 * np.sin(0.5)
    some = {"stribeck": 0.0, "stribeck_velocity": 0.2, "motor_load": 0.0}
    some |= {"motor_load_stribeck": 0.0, "outer_load_stribeck": 0.4}
    sets = {k: np.full(2, v) for k, v in some.items()}
    sets |= {"stall": np.ones(2), "coulomb": np.full(2, 0.45 * torque)}
    moved = simulated(sets | {"outer_load": np.array([0.0, 0.2])}, pieces)[-1, :, 0]
    assert moved[1] == pytest.approx(0.5)
    assert moved[0] < 0.4


def test_the_firmwares_gain_and_deadband_are_read_from_the_duty(pendulum):
    log = a_log(pendulum)
    assert duty_law(log, 0).gain == pytest.approx(GAIN, rel=1e-6)
    assert duty_law(log, 0).deadband == 0.0
    error = log.goal - log.position
    dead = np.sign(error) * np.maximum(abs(error) - 0.0144, 0.0)
    law = duty_law(replace(log, duty=np.clip(2.0 * dead, -1, 1)), 0)
    assert law.deadband == pytest.approx(0.0144, rel=0.3)
    assert law.gain == pytest.approx(2.0, rel=0.05)
    with pytest.raises(RecordingError, match="does not follow goal less position"):
        duty_law(replace(log, duty=-log.duty), 0)


@pytest.mark.parametrize("late", [0.0, 0.004, 0.012])
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_the_firmwares_gain_is_right_though_it_has_the_goal_late(late, share):
    """Of one sinusoid, a late position would explain the duty with another gain."""
    time = np.arange(0.0, 3.0, 0.005)

    def wave(at, size, lag):
        return size * (np.sin(8.0 * at - lag) + share * np.sin(3.0 * at))

    goal, q = wave(time, 0.9, 0.0), wave(time, 0.5, 0.4)
    had = wave(np.maximum(time - late, 0.0), 0.9, 0.0)
    columns = [values[:, None] for values in (q, goal, GAIN * (had - q))]
    law = duty_law(ServoLog("late", ("servo",), time, *columns), 0)
    assert law.gain == pytest.approx(GAIN, rel=5e-3)
    assert law.deadband == 0.0


def test_a_step_of_the_simulation_has_no_error_of_first_order(pendulum):
    """A free pendulum with damping, against a solver of high order."""
    from scipy.integrate import solve_ivp

    time = np.arange(0.0, 2.0, 0.005)
    inertia, viscous = 0.5 * 0.01 + 1e-5 + 0.002, 0.03

    def rate(_, state):
        torque = -0.5 * 9.81 * 0.1 * np.sin(state[0]) - viscous * state[1]
        return [state[1], torque / inertia]

    begin = [1.2, 0.0]
    exact = solve_ivp(rate, (0.0, 2.0), begin, t_eval=time, rtol=1e-9).y[0]
    log = ServoLog("swing", ("servo",), time, exact[:, None], 0.0 * exact[:, None])
    pieces = cut_pieces(pendulum, [log], 0, [LoggedDrive(0.0, 0.0)])
    pieces = replace(pieces, start=np.array(begin[:1]), speed=np.zeros(1))
    found = {"stall": 1.0, "armature": 0.002, "viscous": viscous}
    sets = {name: np.array([value]) for name, value in found.items()}
    assert position_errors(sets, pieces)[0, 0] < 5e-4


def written(path, log, names="time,position,goal_position,load", unit=1.0):
    table = np.column_stack(
        [log.time, log.position / unit, log.goal / unit, 885 * log.duty]
    )
    np.savetxt(path, table, delimiter=",", header=names, comments="")
    return path


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


def hand_made(**values):
    form = ServoForm("plain", TRUTH | values, dict.fromkeys(TRUTH, 0.0), 0.0, 0.0)
    return ServoFit("pendulum", (JointServo("servo", (form,), {}, 0.0),), None)


@pytest.mark.slow
def test_mujoco_moves_like_the_simulation(pendulum, file):
    pytest.importorskip("mujoco")
    from consistent_id.rollout.servo_export import replayed_in_mujoco

    log = a_log(pendulum)
    tick = 2 * np.pi / 4096
    assert replayed_in_mujoco(file, hand_made(), log, [GAIN])[0] < 2.0 * tick
    off = replayed_in_mujoco(file, hand_made(stall=0.6), log, [GAIN])[0]
    assert off > 5.0 * tick
    with pytest.raises(ModelError, match="MuJoCo refuses the robot with identified"):
        replayed_in_mujoco(file, hand_made(stall=-1.0), log, [GAIN])
    rough = ServoFit("pendulum", (JointServo("servo", (), {}, 0.0),), None)
    with pytest.raises(ModelError, match="'plain'"):
        replayed_in_mujoco(file, rough, log, [GAIN])


def test_the_file_holds_the_delay_and_pulls_as_supply_and_temperature_let_it(
    pendulum, file
):
    pytest.importorskip("mujoco")
    from consistent_id.rollout.servo_export import replayed_file, servo_mjcf

    tick = 2 * np.pi / 4096
    log = replace(a_log(pendulum), volts=6.0, temperature=np.array([50.0]))
    fit = hand_made(stall=TRUTH["stall"] / (0.8 * 0.9), heat=0.005)
    fit = replace(fit, volts=7.5)  # 6 V are 0.8 of it, and 50 degrees cost 0.1
    text = servo_mjcf(file, fit, [GAIN], log=log)
    assert replayed_file(text, fit, log)[0] < 2.0 * tick
    nominal = servo_mjcf(file, fit, [GAIN])
    assert replayed_file(nominal, fit, log)[0] > 5.0 * tick
    late = a_log(pendulum, delay=0.03)
    for delay, right in ((0.03, True), (0.005, False)):
        fit = hand_made(delay=delay)
        text = servo_mjcf(file, fit, [GAIN])
        assert f'delay="{delay:g}"' in text
        assert (replayed_file(text, fit, late)[0] < 2.0 * tick) == right


def test_the_evolution_strategy_finds_a_narrow_valley():
    def valley(x):
        return (x[:, 0] - 0.7) ** 2 + 100.0 * (x[:, 1] - x[:, 0] ** 2) ** 2

    first = SearchDistribution(np.full(2, 0.25), 0.25)
    found = evolved(valley, first, 120, np.random.default_rng(0)).best
    assert np.allclose(found, [0.7, 0.49], atol=2e-3)


def test_a_descent_comes_to_the_least_sum_of_absolute_residuals_of_each_problem():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(60, 3)) @ np.diag([1.0, 0.1, 0.01])  # a narrow valley
    truth = np.array([0.3, 0.8, 0.5])
    measured = A @ truth
    measured[:10] += rng.normal(size=10)  # outliers, which a median leaves aside
    weights = np.full((2, 60), 1.0 / 60.0)
    weights[1, 10:20] = 0.0
    weights[1] /= weights[1].sum()
    first = np.array([[0.9, 0.1, 0.9], [0.1, 0.9, 0.1]])
    found = descended(lambda x: x @ A.T - measured, first, weights, 60)
    assert np.allclose(found.points, truth, atol=[1e-3, 1e-2, 1e-1])
    off = abs(found.points @ A.T - measured)
    assert found.errors == pytest.approx((weights * off).sum(axis=1))
    least = (weights * abs(A @ truth - measured)).sum(axis=1)
    assert (found.errors < 1.001 * least).all()


def test_a_descent_moves_along_the_border_behind_which_the_least_error_is():
    A = np.array([[1.0, 1.0], [1.0, 1.1], [1.0, 0.9], [1.0, 1.05]])
    measured = A @ np.array([-0.2, 0.9])  # on the border, the best is near 0.7
    weights = np.full((1, 4), 0.25)
    found = descended(
        lambda x: x @ A.T - measured, np.array([[0.0, 0.1]]), weights, 8
    ).points[0]
    line = np.linspace(0.0, 1.0, 1001)
    errors = abs(np.outer(line, A[:, 1]) - measured).mean(axis=1)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(line[errors.argmin()], abs=5e-3)  # it is flat


def test_a_descent_stays_where_every_step_makes_the_error_larger():
    def residuals(x):
        near = abs(x - 0.5) < 0.003
        return np.where(near, 0.1 + (x - 0.5), 1.0)

    found = descended(residuals, np.array([[0.5]]), np.ones((1, 1)), 5)
    assert found.points[0, 0] == 0.5 and found.errors[0] == pytest.approx(0.1)


def test_a_firmware_that_answers_late_takes_damping_away(pendulum):
    drives = [LoggedDrive(GAIN, 0.0)]
    pieces = cut_pieces(pendulum, [a_log(pendulum)], 0, drives, step=STEP / 5)
    late, sets = np.array([1e-3, 0.0]), {n: np.full(2, v) for n, v in TRUTH.items()}
    damping = {"viscous": TRUTH["viscous"] - np.array([0.0, 1e-3]) * 0.7 * GAIN}
    out = simulated(sets | damping | {"latency": late}, pieces)
    plain = simulated(sets, pieces)
    effect = abs(out[:, 0] - plain[:, 0]).max()
    assert effect > 1e-3
    assert abs(out[:, 0] - out[:, 1]).max() < 0.02 * effect


def test_positions_that_are_old_are_those_of_earlier_times(pendulum):
    drives = [LoggedDrive(GAIN, 0.0)]
    pieces = cut_pieces(pendulum, [a_log(pendulum)], 0, drives)
    sets = {name: np.full(2, value) for name, value in TRUTH.items()}
    ((new, old),) = sampled_motion(sets, pieces, np.array([0.0, 0.005]))
    assert np.allclose(old[1:], new[:-1], atol=1e-9)  # samples are 5 ms apart
    assert abs(new - pieces.measured[0]).mean() < 1e-3


def test_bodies_have_to_be_known(pendulum):
    links = tuple(replace(link, nominal=None) for link in pendulum.links)
    with pytest.raises(ModelError, match="measured by known bodies"):
        identify_servos(replace(pendulum, links=links), [a_log(pendulum)])
    with pytest.raises(RecordingError, match="no log of servos"):
        identify_servos(pendulum, [])
    with pytest.raises(RecordingError, match="state the firmware's gain"):
        identify_servos(pendulum, [replace(a_log(pendulum), duty=None)])


@pytest.mark.slow
def test_one_command_writes_the_servo_and_its_simulator(
    pendulum, file, tmp_path, capsys, monkeypatch
):
    mujoco = pytest.importorskip("mujoco")
    for name in ("_GENERATIONS", "_DESCENT", "_AGAIN"):
        monkeypatch.setattr(fitting, name, 3)
    a = written(tmp_path / "a.csv", a_log(pendulum, 1.5))
    b = written(tmp_path / "b.csv", a_log(pendulum, 1.5, 0.9))
    words = ["servo", str(file), str(a), "--validate", str(b), "--full-duty", "885"]
    words += ["--friction", "plain"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "Error of simulated position, logs not used" in out
    assert out.splitlines()[0].startswith(("use", "use with care"))
    record = parsed((tmp_path / "out" / "servo.json").read_text())
    assert record["format"] == "consistent_id servo 1"
    servo = record["joints"]["servo"]
    assert servo["gains"]["b.csv"] == pytest.approx(GAIN, rel=1e-3)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "servo.xml"))
    values = servo["forms"]["plain"]["values"]
    assert model.dof_frictionloss[0] == pytest.approx(values["coulomb"], rel=1e-4)
    stiffness = values["stall"] * servo["gains"]["b.csv"]
    assert model.actuator_gainprm[0, 0] == pytest.approx(stiffness, rel=1e-4)
    with pytest.raises(SystemExit):
        main([*words, "--columns", "torque=x"])
    assert "is not ROLE=COLUMN" in capsys.readouterr().err


def quick(monkeypatch, generations=2):
    for name in ("_GENERATIONS", "_DESCENT", "_AGAIN"):
        monkeypatch.setattr(fitting, name, generations)


@pytest.mark.slow
def test_a_log_for_validation_changes_nothing_that_is_learnt(pendulum, monkeypatch):
    quick(monkeypatch)
    log, other = a_log(pendulum, 1.5), a_log(pendulum, 1.5, name="other")
    error = other.goal - other.position
    dead = np.sign(error) * np.maximum(abs(error) - 0.0144, 0.0)
    other = replace(other, duty=np.clip(2.0 * dead, -1, 1))
    alone = identify_servos(pendulum, [log], forms=["plain"]).joints[0]
    judged = identify_servos(pendulum, [log], [other], forms=["plain"]).joints[0]
    assert judged.forms == alone.forms
    assert judged.deadband == 0.0
    assert judged.gains["other"] == pytest.approx(2.0, rel=0.05)
    with pytest.raises(RecordingError, match="two logs are named log"):
        identify_servos(pendulum, [log], [log])


def test_short_pieces_do_not_shorten_windows(pendulum):
    long, short = a_log(pendulum, 6.0), a_log(pendulum, 0.2)
    assert fitting._window([long, short]) == fitting.WINDOW
    assert fitting._window([short]) == pytest.approx(short.time[-1] / 3)
    hole = abs(long.time - 2.5) > 0.6
    cut = {k: getattr(long, k)[hole] for k in ("time", "position", "goal", "duty")}
    drives = [LoggedDrive(GAIN, 0.0)]
    pieces = cut_pieces(pendulum, [replace(long, **cut)], 0, drives, 1.0)
    assert len(pieces.times) == 5  # of 6: none is in the hole
    assert all(len(time) for time in pieces.times)


def test_samples_that_a_first_speed_is_smoothed_over_do_not_count(pendulum):
    log = a_log(pendulum, 6.0)
    cut = {k: getattr(log, k)[::6] for k in ("time", "position", "goal", "duty")}
    slow = replace(log, **cut)  # 31 Hz: the speed is that of five samples
    first, *later = cut_pieces(pendulum, [slow], 0, [LoggedDrive(GAIN, 0.0)], 1.0).times
    assert first[0] == 0.0
    assert all(times[0] >= 4 * slow.period - 1e-9 for times in later)
    assert all(times[-1] > 0.9 for times in later[:-1])


def two_joints(tmp_path):
    joint = """<joint name="{}" type="revolute"><origin rpy="0 {} 0" xyz="{} 0 0"/>
<parent link="{}"/><child link="{}"/><axis xyz="0 1 0"/>{}
<limit lower="-3.2" upper="3.2" effort="1" velocity="20"/></joint>"""
    arm = PENDULUM[PENDULUM.index('<link name="arm">') : PENDULUM.index("<joint")]
    path = tmp_path / "two.urdf"
    path.write_text(
        '<robot name="two"><link name="bench"/>'
        + arm
        + arm.replace('"arm"', '"hand"')
        + joint.format("a", np.pi / 2, 0, "bench", "arm", "")
        + joint.format("b", 0.3, 0.1, "arm", "hand", "{}")
        + "</robot>"
    )
    return path


@pytest.mark.slow
def test_a_joint_that_does_not_move_is_named_and_others_are_identified(
    tmp_path, monkeypatch
):
    quick(monkeypatch)
    file = two_joints(tmp_path)
    file.write_text(file.read_text().replace("{}", ""))
    robot = load_robot(file)
    time = np.arange(0.0, 1.5, 0.005)
    q = np.column_stack([0.3 * np.sin(4.0 * time), np.full(len(time), 0.4)])
    goal = q + 0.1 * np.column_stack([np.cos(4.0 * time), 0.0 * time])
    log = ServoLog("log", ("a", "b"), time, q, goal, GAIN * (goal - q))
    fit = identify_servos(robot, [log], forms=["plain"])
    assert [servo.joint for servo in fit.joints] == ["a"]
    assert fit.not_moved == {"b": pytest.approx(0.4)}
    assert any("b does not move" in note for note in fit.tables()[0].notes)
    still = replace(log, position=0.0 * q + 0.4, goal=0.0 * q + 0.4)
    with pytest.raises(NotExcitedError, match="joint a, b of two moves by less than 5"):
        identify_servos(robot, [still])


@pytest.mark.parametrize("held", ["a", "b"])
def test_joints_without_a_servo_are_held_in_mujoco(tmp_path, held):
    mujoco = pytest.importorskip("mujoco")
    from consistent_id.rollout.servo_export import replayed_in_mujoco, servo_spec

    file = two_joints(tmp_path)
    file.write_text(file.read_text().replace("{}", ""))
    (free,) = {"a", "b"} - {held}
    servo = replace(hand_made().joints[0], joint=free)
    fit = ServoFit("two", (servo,), None, {held: 0.4})
    whole = mujoco.MjModel.from_xml_path(str(file))
    model = servo_spec(file, fit, [GAIN]).compile()
    assert model.nq == 1
    loads = []
    for of, places in ((whole, {held: 0.4, free: 0.7}), (model, {free: 0.7})):
        data = mujoco.MjData(of)
        for name, place in places.items():
            data.joint(name).qpos[0] = place
        mujoco.mj_forward(of, data)
        moved = data.subtree_com[of.joint(free).bodyid[0]]
        loads.append([*moved, *data.joint(free).qfrc_bias])
    assert np.allclose(*loads, atol=1e-12)
    time = np.arange(0.0, 0.5, 0.005)
    q = np.zeros((len(time), 2)) + 0.1
    log = ServoLog("log", ("a", "b"), time, q, q)
    assert replayed_in_mujoco(file, fit, log, [GAIN]).shape == (1,)


@pytest.mark.slow
def test_a_joint_without_columns_is_not_in_the_written_robot(
    tmp_path, monkeypatch, capsys
):
    mujoco = pytest.importorskip("mujoco")
    quick(monkeypatch)
    file = two_joints(tmp_path)
    file.write_text(file.read_text().replace("{}", ""))
    log = a_log(load_robot(file, locked={"b": 0.0}), 1.5)
    names = "time,a_position,a_goal_position,a_load"
    words = ["servo", str(file), str(written(tmp_path / "a.csv", log, names))]
    words += ["--friction", "plain", "--full-duty", "885"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 0
    assert "b: held at 0" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "servo.xml"))
    assert [model.joint(k).name for k in range(model.njnt)] == ["a"]


def test_a_joint_that_follows_another_one_is_refused(tmp_path):
    file = two_joints(tmp_path)
    file.write_text(file.read_text().replace("{}", '<mimic joint="a"/>'))
    time = np.arange(0.0, 1.0, 0.01)[:, None]
    log = ServoLog("log", ("a",), time[:, 0], time, time)
    with pytest.raises(ModelError, match=r"b of two follow another joint \(mimic\)"):
        identify_servos(load_robot(file), [log], gain=1.0)


@pytest.mark.slow
def test_at_a_border_the_other_intervals_are_conditional(pendulum, monkeypatch):
    quick(monkeypatch, 12)
    limits = {"stall": (2.0, 4.0), "viscous": (0.0, 0.1), "coulomb": (0.0, 0.1)}

    def narrow(*known):
        return replace(box := box_of(*known), limits=box.limits | limits)

    monkeypatch.setattr(fitting, "box_of", narrow)
    servo = identify_servos(pendulum, [a_log(pendulum, 1.5)], forms=["plain"]).joints[0]
    assert "stall" in servo.chosen.at_border  # the true one is 0.7
    half = servo.chosen.half_intervals
    unknown = {n for n, h in half.items() if np.isinf(h)}
    assert unknown >= set(servo.chosen.at_border)
    assert unknown >= {"stall", "viscous", "armature", "coulomb"}  # in proportion
    assert 0 < len(unknown) < len(half)
    assert any("what is known are ratios" in note for note in servo.table().notes)
    assert any("hold only if this value" in note for note in servo.table().notes)
    assert any("ended at the border for" in note for note in servo.table().notes)


@pytest.mark.parametrize(
    ("motor", "outer", "square"),
    [(3.0, -2.0, 0.5 * 4.0), (-1.0, 2.0, 0.25 * 1.0), (3.0, 2.0, 0.0)],
)
def test_squares_count_where_motor_and_bodies_pull_against_each_other(
    motor, outer, square
):
    known = {
        "stribeck": 0.1,
        "stribeck_velocity": 0.2,
        "stribeck_power": 2.0,
        "motor_load": 0.3,
        "outer_load": 0.4,
        "motor_load_stribeck": 0.05,
        "outer_load_stribeck": 0.06,
        "motor_square": 0.25,
        "outer_square": 0.5,
    }
    law = _friction_by_load({name: np.array(value) for name, value in known.items()})
    slow = np.exp(-((0.1 / 0.2) ** 2))
    expected = abs(0.3 * motor - 0.4 * outer)
    expected += slow * (0.1 + abs(0.05 * motor - 0.06 * outer) + square)
    found = law(np.array(motor), np.array(outer), np.array(0.1))
    assert float(found) == pytest.approx(expected, rel=1e-12)


def test_a_motion_that_is_not_finite_is_refused_not_hidden(pendulum):
    log = a_log(pendulum, 0.5)
    pieces = cut_pieces(pendulum, [log], 0, [LoggedDrive(GAIN, 0.0)])
    with pytest.raises(RecordingError, match="is not finite"):
        finite_errors({"stall": np.array([np.nan])}, pieces)
    with pytest.raises(RecordingError, match="the supply is nan V"):
        replace(log, volts=float("nan"))


@pytest.mark.slow
def test_a_planted_servo_is_found_again_within_its_intervals(pendulum):
    planted = {"coulomb": 0.03}
    logs = [a_log(pendulum, 3.0, f, f"log {f}", **planted) for f in (0.5, 0.8, 1.1)]
    unseen = a_log(pendulum, 3.0, 0.95, "unseen", **planted)
    fit = identify_servos(pendulum, logs, [unseen], forms=("plain",))
    assert fit.validation_error() < 3e-3
    form = fit.joints[0].chosen
    assert form.at_border == ()
    for name, value in (TRUTH | planted).items():
        assert abs(form.values[name] - value) <= form.half_intervals[name]
    for name in ("stall", "coulomb", "viscous", "armature"):
        assert form.half_intervals[name] < 0.2 * form.values[name]
        assert form.values[name] == pytest.approx((TRUTH | planted)[name], rel=0.02)


@pytest.mark.parametrize(
    "change, word, kinds",
    [
        ({}, "use", []),
        ({"validation": 0.21}, "do not use", ["position error", "generalisation"]),
        ({"validation": 0.07}, "use with care", ["generalisation"]),
        ({"at_border": ("stall",)}, "use with care", ["undetermined"]),
        ({"not_moved": {"other": 0.0}}, "use with care", ["not moved"]),
        ({"validation": None}, "use", []),
    ],
)
def test_the_verdict_on_a_servo_is_that_of_its_worst_reason(change, word, kinds):
    """Training 0.02 rad, goals 0.2 rad off: nearer than the goals is the least."""
    form = ServoForm(
        "plain", {"stall": 0.7}, {"stall": 0.1}, 0.02, 0.03, change.get("at_border", ())
    )
    error = change.get("validation", 0.05)
    judged = {} if error is None else {"plain": {"b": error}}
    goals = {"a": 0.3, "b": 0.2}
    servo = JointServo("servo", (form,), {"a": GAIN}, 0.0, judged, goals)
    fit = ServoFit("arm", (servo,), None, change.get("not_moved", {}))
    assert fit.verdict.word == word
    assert [reason.kind for reason in fit.verdict.grounds] == kinds
    if servo.chosen.at_border:  # the table prints the other intervals
        assert "the others hold only if" in fit.verdict.grounds[0].statement
    assert fit.tables()[0].title.startswith(f"{word}: servo")
    assert fit.verdict.recordings == (() if error is None else ("b",))
    assert parsed(json.dumps(fit.to_dict()))["verdict"] == word


def test_the_error_of_the_goals_is_their_mean_distance(pendulum, monkeypatch):
    quick(monkeypatch)
    log = a_log(pendulum, 1.5)
    servo = identify_servos(pendulum, [log], forms=["plain"]).joints[0]
    assert servo.goal_error == {
        "log": pytest.approx(abs(log.goal - log.position).mean())
    }
