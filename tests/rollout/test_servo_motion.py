"""Motion of servos: simulated, and as MuJoCo simulates the written file."""

from dataclasses import replace

import numpy as np
import pytest
from servo_pendulum import (
    GAIN,
    TRUTH,
    a_log,
    hand_made,
)

from consistent_id.errors import ModelError, RecordingError
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow, from_modified_dh
from consistent_id.rollout import ServoLog
from consistent_id.rollout.servo_bounds import duty_law
from consistent_id.rollout.servo_motion import (
    STEP,
    LoggedDrive,
    cut_pieces,
    position_errors,
    rigid_model,
    sampled_motion,
    simulated,
)
from consistent_id.rollout.servo_result import JointServo, ServoFit


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
