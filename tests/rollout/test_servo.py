"""Servos without torque: parameters found again, intervals, verdicts."""

import json
from dataclasses import replace

import numpy as np
import pytest
from schemas import parsed
from servo_pendulum import (
    GAIN,
    TRUTH,
    a_log,
    hand_made,
    quick,
    two_joints,
    written,
)

from consistent_id.cli import main
from consistent_id.errors import ModelError, NotExcitedError, RecordingError
from consistent_id.robot.loaders.robot_file import load_robot
from consistent_id.rollout import ServoLog, identify_servos
from consistent_id.rollout import servo_fit as fitting
from consistent_id.rollout.servo_bounds import box_of
from consistent_id.rollout.servo_motion import (
    LoggedDrive,
    _friction_by_load,
    cut_pieces,
    finite_errors,
)
from consistent_id.rollout.servo_result import JointServo, ServoFit, ServoForm
from consistent_id.rollout.servo_search import (
    SearchDistribution,
    descended,
    evolved,
)


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_samples_that_a_first_speed_is_smoothed_over_do_not_count(pendulum):
    log = a_log(pendulum, 6.0)
    cut = {k: getattr(log, k)[::6] for k in ("time", "position", "goal", "duty")}
    slow = replace(log, **cut)  # 31 Hz: the speed is that of five samples
    first, *later = cut_pieces(pendulum, [slow], 0, [LoggedDrive(GAIN, 0.0)], 1.0).times
    assert first[0] == 0.0
    assert all(times[0] >= 4 * slow.period - 1e-9 for times in later)
    assert all(times[-1] > 0.9 for times in later[:-1])


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


def test_a_default_delay_of_a_file_does_not_delay_servos_without_one(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    from consistent_id.rollout.servo_export import servo_mjcf

    file = tmp_path / "late.xml"
    file.write_text(
        '<mujoco><default><general delay="0.5" nsample="3"/></default><worldbody>'
        '<body name="arm"><joint name="a" axis="0 1 0"/>'
        '<inertial pos="0.1 0 0" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/></body>'
        "</worldbody></mujoco>"
    )
    servo = replace(hand_made().joints[0], joint="a")
    at_once = [
        replace(form, values={**form.values, "delay": 0.0}) for form in servo.forms
    ]
    fit = ServoFit("late", (replace(servo, forms=tuple(at_once)),), None)
    model = mujoco.MjModel.from_xml_string(servo_mjcf(file, fit, [GAIN]))
    assert model.actuator_delay.tolist() == [0.0]
    assert model.actuator_history[0, 0] == 0


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


@pytest.mark.slow
def test_the_error_of_the_goals_is_their_mean_distance(pendulum, monkeypatch):
    quick(monkeypatch)
    log = a_log(pendulum, 1.5)
    servo = identify_servos(pendulum, [log], forms=["plain"]).joints[0]
    assert servo.goal_error == {
        "log": pytest.approx(abs(log.goal - log.position).mean())
    }
