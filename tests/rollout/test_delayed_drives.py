"""Drives with a delay in an exported MJCF file, against replays with the delay."""

import json
import re
from dataclasses import fields, replace
from textwrap import dedent

import numpy as np
import pytest
from estimates import estimate_of

from consistent_id import (
    DriveTerms,
    ModelError,
    Recording,
    TorqueModel,
    load_problem,
    to_mjcf,
)
from consistent_id.cli import main
from consistent_id.estimation.fit import _PER_JOINT, Fit
from consistent_id.export.actuator_config import readme
from consistent_id.export.export_formats import exported
from consistent_id.problems.study import Study
from consistent_id.robot import load_mjcf
from consistent_id.signals import PDGains

mujoco = pytest.importorskip("mujoco")

from commanded_leg import PROBLEM, write_leg  # noqa: E402

from consistent_id.rollout import replay, replay_model  # noqa: E402
from consistent_id.rollout.commanded_motion import (  # noqa: E402
    file_error,
)
from consistent_id.rollout.drives_replay import drives_error  # noqa: E402
from consistent_id.rollout.replay_model import RobotFile  # noqa: E402

DELAY = 0.0134
GAINS = PDGains(40.0, 2.0)
JOINTS = ("hip", "knee")
DRIVE = DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.02, rotor_inertia=True
)
TRUTH = [0.4, 0.3, 0.2, 0.3, 0.05, 0.04]  # viscous, Coulomb, rotor, of each joint
LEG = """<mujoco model="leg">
  <compiler angle="radian"/>
  <option timestep="0.004"/>
  <default>
    <general delay="0.5" nsample="3" ctrllimited="true" ctrlrange="-1 1"/>
    <default class="strong"><motor ctrlrange="-60 60"/></default>
  </default>
  <worldbody>
    <body name="thigh">
      <joint name="hip" axis="0 1 0" range="-3 3"/>
      <inertial pos="0 0 -0.1" mass="1" diaginertia="0.005 0.005 0.001"/>
      <body name="shank" pos="0 0 -0.2">
        <joint name="knee" axis="0 1 0" range="-3 3"/>
        <inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.0002"/>
      </body>
    </body>
    <body name="lid">
      <joint name="lid" axis="0 1 0"/>
      <inertial pos="0 0 0.1" mass="0.1" diaginertia="0.001 0.001 0.001"/>
    </body>
  </worldbody>
{more}</mujoco>
"""
ACTUATORS = """  <actuator>
    <motor name="M1" class="strong" joint="hip" gear="0.5"/>
    <motor name="lid" joint="lid" delay="0" nsample="0"/>
    <motor name="M2" class="strong" joint="knee"></motor>
  </actuator>
  <sensor><actuatorfrc actuator="M2"/></sensor>
  <keyframe><key name="bent" qpos="0.3 -0.6 0.1" ctrl="9 0.7 9"/></keyframe>
"""


@pytest.fixture(params=["", ACTUATORS], ids=["bare", "motors"])
def leg(request, tmp_path):
    """A leg's file, without actuators and with its own."""
    file = tmp_path / "leg.xml"
    file.write_text(LEG.format(more=request.param))
    return file


def estimate(file, truth=TRUTH):
    model = TorqueModel(load_mjcf(file, joints=JOINTS), DRIVE)
    bodies = [link.nominal for link in model.robot.links]
    return estimate_of(model, bodies, np.array(truth))


def commands(further=()):
    """Commands at 200 Hz, of a robot that has not moved yet."""
    time = np.arange(800) / 200.0
    phase = time[:, None] * np.array([2.0, 3.0]) + 1.2 * time[:, None] ** 2
    log = Recording(
        JOINTS, time, np.full((800, 2), 0.3), np.zeros((800, 2)),
        position_command=0.3 + 0.4 * np.sin(phase),
    )  # fmt: skip
    if "velocity" in further:
        log = replace(log, velocity_command=np.cos(phase))
    if "torque" in further:
        log = replace(log, torque_command=2.0 * np.sin(3.0 * phase))
    return log


def written(own, source, out, gains=GAINS, further=(), delay=DELAY):
    """Export beside a folder; return the file of drives."""
    made = to_mjcf(
        own, source, folder=out.parent, gains=gains, delay=delay, commands=further,
        allow_refused=True,
    )  # fmt: skip
    made.save(out)
    return out.with_suffix(made.side.suffix)


def size(errors):
    return float(np.sqrt((errors**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("further", [(), ("velocity", "torque")], ids=["q", "q dq tau"])
@pytest.mark.parametrize("delay", [0.0018, DELAY])
def test_the_file_moves_as_the_estimate_does_with_the_delay(
    leg, tmp_path, delay, further
):
    own, log = estimate(leg), commands(further)
    drives = written(own, leg, tmp_path / "out.xml", further=further, delay=delay)
    model = replay_model(own, JOINTS, GAINS.of(2), period=0.005)
    late, early = (replay(model, log, delay=d).position for d in (delay, 0.0))
    robot = RobotFile(drives, JOINTS, {})
    apart = drives_error(robot, [replace(log, position=late, velocity=None)])
    price = size(early - late)
    assert price > 1e-3
    assert apart < price * 2.75e-4 / delay  # about half a step: steps are first order
    # Without the delay in the file, it is as wrong as it was.
    without, count = re.subn(
        rb'(<general.*) delay="[^"]*"', rb"\1", drives.read_bytes()
    )
    assert count == 2 * (1 + len(further)) + 1  # and that of the default
    drives.write_bytes(without)
    apart = drives_error(robot, [replace(log, position=late, velocity=None)])
    assert apart == pytest.approx(price, rel=0.1)


@pytest.mark.slow
def test_its_error_is_that_of_the_estimate(leg, tmp_path):
    own, log = estimate(leg, [1.3 * value for value in TRUTH]), commands()
    true = replay_model(estimate(leg), JOINTS, GAINS.of(2), period=0.005)
    moved = replay(true, log, delay=DELAY).position
    log = replace(log, position=moved, velocity=None)
    out = tmp_path / "out.xml"
    drives = written(own, leg, out)
    robot = RobotFile(out, JOINTS, {})
    found = file_error(robot, [log], GAINS.of(2), delay=DELAY, drives=drives)
    assert found.of_drives == pytest.approx(found.delayed, rel=0.03)
    assert abs(found.plain - found.delayed) > 0.3 * found.delayed
    first, second = found.lines()
    assert "with commands 13.40 ms late" in first
    assert "out.drives.xml, read back, with its own drives and delay: " in second
    assert f"{1e3 * found.of_drives:.2f} mrad" in second
    assert "first command, contacts and joint limits off" in second


def test_feedback_is_not_late(leg, tmp_path):
    drives = written(estimate(leg), leg, tmp_path / "out.xml")
    model = mujoco.MjModel.from_xml_path(str(drives))
    data = mujoco.MjData(model)
    data.joint("hip").qpos, data.joint("hip").qvel = 0.1, 0.2
    mujoco.mj_forward(model, data)
    (k,) = [k for k in range(model.nu) if model.actuator_trnid[k][0] == 0]
    assert data.actuator_force[k] == pytest.approx(-40.0 * 0.1 - 2.0 * 0.2)


@pytest.mark.slow
def test_the_buffer_holds_the_delay_at_the_step_of_the_file(leg, tmp_path):
    for delay in (1e-4, 5e-4, DELAY):
        out = tmp_path / f"{delay:g}.xml"
        drives = written(estimate(leg), leg, out, delay=delay)
        model = mujoco.MjModel.from_xml_path(str(drives))
        late = np.flatnonzero(model.actuator_delay)
        assert len(late) == 2
        held = model.actuator_history[late, 0] * model.opt.timestep
        assert (held >= delay + model.opt.timestep).all()
        assert model.opt.timestep == 5e-4
    made = to_mjcf(estimate(leg), leg, gains=GAINS, delay=1e-4, allow_refused=True)
    assert "0.5 ms late, which is one step" in made.notes[-1]


@pytest.mark.slow
def test_the_robots_file_itself_stays_as_it_is(leg):
    own = estimate(leg)
    plain = to_mjcf(own, leg, allow_refused=True)
    assert plain.side is None
    given = to_mjcf(own, leg, gains=GAINS, delay=DELAY, allow_refused=True)
    assert given.content == plain.content
    for delay, gains in ((0.0, GAINS), (DELAY, None)):
        same = exported(
            own, "mjcf", source=leg, gains=gains, delay=delay, allow_refused=True
        )
        assert same.side is None and same.content == plain.content


def test_a_robot_that_is_built_anew_has_them_too(tmp_path):
    file = tmp_path / "leg.xml"
    file.write_text(LEG.format(more=""))
    out = tmp_path / "new.xml"
    drives = written(estimate(file), None, out)
    model = mujoco.MjModel.from_xml_path(str(drives))
    assert model.nu == 2 and model.actuator_delay.tolist() == [DELAY, DELAY]


def test_own_actuators_keep_names_limits_and_places(tmp_path):
    file = tmp_path / "leg.xml"
    file.write_text(LEG.format(more=ACTUATORS))
    drives = written(estimate(file), file, tmp_path / "out.xml")
    made = to_mjcf(estimate(file), file, gains=GAINS, delay=DELAY, allow_refused=True)
    assert not any("limits for" in note for note in made.notes)
    model = mujoco.MjModel.from_xml_path(str(drives))
    assert [model.actuator(k).name for k in range(3)] == ["M1", "lid", "M2"]
    assert model.actuator_forcerange[[0, 2]].tolist() == [[-30, 30], [-60, 60]]
    assert model.actuator_delay.tolist() == [DELAY, 0.0, DELAY]
    assert model.key_ctrl.tolist() == [[0.3, 0.7, -0.6]]
    stated = PDGains(40.0, 2.0, 12.0)
    drives = written(estimate(file), file, tmp_path / "two.xml", gains=stated)
    model = mujoco.MjModel.from_xml_path(str(drives))
    assert model.actuator_forcerange[[0, 2]].tolist() == [[-12, 12], [-12, 12]]


def exceeding(own, efforts):
    """Return an estimate from data whose torque was that much over the limits."""
    values = {one.name: np.nan for one in fields(Fit)}
    values |= {name: np.full(2, np.nan) for name in _PER_JOINT}
    fit = Fit(**{**values, "joints": JOINTS, "efforts": np.array(efforts)})
    return replace(own, fit=fit)


@pytest.mark.parametrize("further", [(), ("torque",)])
def test_a_limit_that_the_torque_exceeded_is_no_drives_limit(tmp_path, further):
    file = tmp_path / "leg.xml"
    weak = LEG.replace('range="-3 3"', 'range="-3 3" actuatorfrcrange="-9 9"')
    file.write_text(weak.format(more=ACTUATORS))
    own = exceeding(estimate(file), [1.06, 1.04])
    out, more = tmp_path / "out.xml", {"gains": GAINS, "delay": DELAY}
    made = to_mjcf(
        own, file, folder=tmp_path, commands=further, allow_refused=True, **more
    )
    assert any("file's limits for hip, whose torque" in note for note in made.notes)
    made.save(out)
    drives = mujoco.MjModel.from_xml_path(str(out.with_suffix(made.side.suffix)))
    hip, knee = (drives.joint(joint).id for joint in JOINTS)
    assert not drives.jnt_actfrclimited[hip] and drives.jnt_actfrclimited[knee]
    limited = dict(
        zip(("hip", "lid", "knee"), drives.actuator_forcelimited[:3], strict=True)
    )
    assert not limited["hip"] and limited["knee"] == (not further)
    assert mujoco.MjModel.from_xml_path(str(out)).jnt_actfrclimited[[hip, knee]].all()
    stated = PDGains(40.0, 2.0, 12.0)
    drives = written(own, file, tmp_path / "two.xml", gains=stated, further=further)
    model = mujoco.MjModel.from_xml_path(str(drives))
    most = model.jnt_actfrcrange if further else model.actuator_forcerange
    assert most[hip if further else 0].tolist() == [-12.0, 12.0]


def test_limits_that_another_log_exceeded_are_left_out_and_positions_noted(tmp_path):
    """A validation log may be faster than the training data."""
    file = tmp_path / "leg.xml"
    weak = LEG.replace('range="-3 3"', 'range="-1 0.45" actuatorfrcrange="-9 9"')
    file.write_text(weak.format(more=""))
    own, log = exceeding(estimate(file), [0.5, 0.5]), commands()
    q = np.zeros(log.position.shape)
    q[3, 0] = 0.466  # 16 mrad beyond the hip's limit
    tau = np.tile([9.4, -9.5], (len(q), 1))
    logs = [replace(log, position=q), replace(log, position=0.0 * q, torque=tau)]
    drives = {"gains": GAINS, "delay": DELAY, "allow_refused": True}
    made = to_mjcf(own, file, logs=logs, **drives)
    assert "file's limits for knee, whose torque" in made.notes[-2]
    assert "joint limits, by [mrad or mm]: hip 16;" in made.notes[-1]
    known = np.zeros(q.shape, dtype=bool)
    logs = [replace(log, position=0.0 * q, torque=tau, torque_known=known)]
    made = to_mjcf(own, file, logs=logs, **drives)
    assert "limits" not in made.notes[-1]


def test_the_file_says_how_to_begin_with_the_first_command(leg, tmp_path):
    drives = written(estimate(leg), leg, tmp_path / "out.xml")
    recipe = drives.read_text().partition("mj_resetData:\n")[2].partition("-->")[0]
    model = mujoco.MjModel.from_xml_path(str(drives))
    data = mujoco.MjData(model)
    given = {"np": np, "mujoco": mujoco, "model": model, "data": data}
    command = np.linspace(0.4, -0.3, model.nu)
    exec(dedent(recipe), given | {"command": command})
    mujoco.mj_step(model, data)
    late = np.flatnonzero(model.actuator_delay)
    assert len(late) == 2
    assert data.actuator_force[late] == pytest.approx(GAINS.kp * command[late])


def test_of_several_commands_the_sum_is_limited(leg, tmp_path):
    drives = written(
        estimate(leg), leg, tmp_path / "out.xml", PDGains(40.0, 2.0, 12.0), ("torque",)
    )
    model = mujoco.MjModel.from_xml_path(str(drives))
    for joint in JOINTS:
        j = model.joint(joint).id
        assert model.jnt_actfrclimited[j]
        assert model.jnt_actfrcrange[j].tolist() == [-12.0, 12.0]
        k = model.actuator(f"{joint} torque").id
        assert model.actuator_delay[k] == DELAY
        assert model.actuator_gainprm[k][0] == 1.0
        assert not model.actuator_biasprm[k].any()


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"delay": -1e-3}, r"delay of commands is -0.001 s, expected 0 or more"),
        ({"delay": np.nan}, "delay of commands is nan"),
        ({"commands": ("effort",)}, "are effort, expected some of velocity, torque"),
    ],
)
def test_what_is_no_delay_and_no_command_is_refused(tmp_path, given, why):
    file = tmp_path / "leg.xml"
    file.write_text(LEG.format(more=""))
    stated = {"gains": GAINS, "delay": DELAY, **given}
    with pytest.raises(ModelError, match=why):
        to_mjcf(estimate(file), file, allow_refused=True, **stated)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('gear="0.5"', 'armature="0.01"', "actuators of the file have armature"),
        ("</actuator>", "</actuator>", "springs behind motors"),
    ],
)
def test_where_none_can_be_written_a_note_says_why(tmp_path, old, new, why):
    file = tmp_path / "leg.xml"
    file.write_text(LEG.format(more=ACTUATORS.replace(old, new)))
    elastic = replace(GAINS, stiffness=np.array(900.0))
    gains = GAINS if old != new else elastic
    made = to_mjcf(estimate(file), file, gains=gains, delay=DELAY, allow_refused=True)
    assert made.side is None and why in made.notes[-1]


def test_the_page_says_how_to_begin_and_not_how_to_delay(leg):
    page = readme(estimate(leg), "mjcf", "a.xml", delay=DELAY, drives="a.drives.xml")
    text = page.content.decode()
    assert "`a.drives.xml` is the same robot" in text and "deque" not in text
    assert "mj_initCtrlHistory" in text and "Isaac Lab" in text
    bare = readme(estimate(leg), "urdf", "a.urdf", delay=DELAY).content.decode()
    assert "deque" in bare and "Isaac Lab" in bare and "drives.xml" not in bare


def test_a_default_delay_of_a_file_does_not_delay_replays(tmp_path):
    files = [tmp_path / "late.xml", tmp_path / "plain.xml"]
    text = LEG.format(more="")
    files[0].write_text(text)
    files[1].write_text(text.replace('delay="0.5" nsample="3"', ""))
    log = commands()
    late, plain = (
        replay(replay_model(file, JOINTS, GAINS.of(2), period=0.005), log).position
        for file in files
    )
    np.testing.assert_array_equal(late, plain)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [DELAY, 0.0])
def test_the_shell_writes_them_and_their_error(tmp_path, capsys, delay):
    write_leg(tmp_path, delay=DELAY)
    stated = PROBLEM.replace("kd = 1.0", f"kd = 1.0\ndelay = {delay}")
    (tmp_path / "problem.toml").write_text(stated)
    out = tmp_path / "out.xml"
    options = ["export", str(tmp_path), "--format", "mjcf", "--output", str(out)]
    kinds = ("misfit", "held-out error", "hidden factor", "lag")
    accepted = [word for kind in kinds for word in ("--accept", kind)]
    assert main([*options, *accepted, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    drives, page = tmp_path / "out.drives.xml", (tmp_path / "out.xml.README.md")
    assert drives.exists() == (delay > 0.0) == (str(drives) in record["files"])
    notes = [note for note in record["notes"] if note.startswith("rollout error of")]
    assert all(note in page.read_text() for note in notes)
    if delay > 0.0:
        plain, late = (
            float(number)
            for number in re.findall(r"(\d+\.\d\d)(?: mrad| with)", notes[0])
        )
        own = float(re.search(r"(\d+\.\d\d) mrad", notes[1])[1])
        assert abs(own - late) < 0.03 * (plain - late)
        assert "deque" not in page.read_text()
    else:
        assert len(notes) == 1


@pytest.mark.slow
def test_the_shell_compares_limits_with_validation_logs_too(tmp_path):
    write_leg(tmp_path, delay=DELAY)
    stated = PROBLEM.replace("kd = 1.0", f"kd = 1.0\ndelay = {DELAY}")
    (tmp_path / "problem.toml").write_text(stated)
    study = Study(load_problem(tmp_path))
    slow, fast = (
        max(abs(log.torque[:, 0]).max() for log in logs)
        for logs in (study.training, study.validation)
    )
    assert fast > 1.2 * slow  # the commands are a chirp
    leg, limit = tmp_path / "leg.xml", 1.05 * slow
    weak = f'name="hip" actuatorfrcrange="{-limit} {limit}"'
    leg.write_text(leg.read_text().replace('name="hip"', weak, 1))
    out, file = tmp_path / "out.xml", tmp_path / "of_training.json"
    Study(load_problem(tmp_path)).recommended.with_verdict.save(file)
    options = ["export", str(tmp_path), "--format", "mjcf", "--output", str(out)]
    options += ["--estimate", str(file)]
    kinds = ("misfit", "held-out error", "hidden factor", "lag", "limit")
    accepted = [word for kind in kinds for word in ("--accept", kind)]
    assert main([*options, *accepted]) == 0
    drives = mujoco.MjModel.from_xml_path(str(tmp_path / "out.drives.xml"))
    assert not drives.jnt_actfrclimited[drives.joint("hip").id]
