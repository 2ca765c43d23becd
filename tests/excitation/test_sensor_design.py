"""Motions for what hangs on a wrench sensor: errors that come true, within limits."""

import json
from dataclasses import replace

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.excitation.aims import base_for
from consistent_id.excitation.playable import what_moves, with_load
from consistent_id.excitation.search_problem import search_problem

NOISE = [0.2] * 3 + [0.02] * 3
TOOL = ci.InertialParameters.from_central(1.3, [0.02, 0, 0.08], 4e-3 * np.eye(3))
BIAS = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])
FORM = ci.PathForm(duration=6.0, harmonics=3)
AIM = ci.Aim(noise=NOISE, interest=["gripper"], correlation_time=0.0, rate=50.0)


def arm():
    within = ci.robot.JointLimits(lower=-2.0, upper=2.0, velocity=3.0, effort=150.0)
    link = ci.InertialParameters.from_central(3, [0.2, 0, 0], 0.03 * np.eye(3))
    rows = [(-np.pi / 2, 0, 0), (0, 0.4, 0), (-np.pi / 2, 0.3, 0), (np.pi / 2, 0, 0.1)]
    found = ci.from_modified_dh("arm", [ci.DHRow(*r, limits=within) for r in rows])
    return replace(found, links=tuple(replace(x, nominal=link) for x in found.links))


@pytest.fixture(scope="module")
def rows():
    return ci.regression.SensorRows(ci.regression.tool_model("gripper"), arm(), "link4")


@pytest.fixture(scope="module")
def design(rows):
    limits = ci.motion_limits(rows.arm, acceleration=8.0)
    return ci.design_trajectory(
        rows.arm,
        FORM,
        AIM,
        limits=limits,
        sensor=rows,
        starts=1,
        workers=1,
        time_limit=3.0,
    )


def test_gradients_of_the_objective_are_differences(rows):
    limits = ci.motion_limits(rows.arm, acceleration=8.0)
    base = base_for(rows, AIM.interest)
    problem = search_problem(rows, base, FORM, AIM, limits)
    x, step = problem.random(0), 1e-6
    criterion = problem.criterion("D")
    gradient = problem.value(criterion, x).gradient
    rng = np.random.default_rng(0)
    for _ in range(4):
        way = rng.normal(size=x.shape)
        ahead, back = (problem.value(criterion, x + s * way) for s in (step, -step))
        slope = (ahead.value - back.value) / (2 * step)
        assert np.sum(gradient * way) == pytest.approx(slope, rel=1e-4, abs=1e-6)


@pytest.mark.slow
def test_a_design_for_the_tool_keeps_its_limits_and_beats_a_random_path(design):
    assert design.proof.holds
    assert {m.quantity for m in design.proof.margins.margins} >= {"torque", "velocity"}
    places = list(design.accuracy.interest)
    assert [design.base.names[k] for k in places] == [
        f"gripper.{name}"
        for name in ("m", "hx", "hy", "hz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    ]
    gain = design.unoptimised.standard_errors() / design.accuracy.standard_errors()
    assert np.exp(np.mean(np.log(gain[places]))) > 1.5
    assert design.measured is design.sensor


@pytest.mark.slow
def test_predicted_errors_of_the_tool_come_true(design, rows):
    """Fits of a played motion with the sensor's noise scatter as was said."""
    path, tool = design.trajectory, rows.tool
    log = path.recording(rate=AIM.rate)
    none = np.zeros((len(log), 0))
    moved = ci.regression.sensor_motion(rows.arm, log, rows.frame)
    clean = tool.predict(np.append(TOOL.vector, BIAS), none, none, none, base=moved)
    rng, off = np.random.default_rng(0), []
    for _ in range(60):
        shown = clean + rng.normal(size=clean.shape) * NOISE
        one = replace(log, wrenches=(ci.recordings.Wrench(rows.frame, shown),))
        fit = ci.regression.sensor_regression(tool, rows.arm, one, frame=rows.frame)
        off.append(
            ci.estimation.weighted_least_squares(tool, fit).parameters[:10]
            - TOOL.vector
        )
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    said = design.accuracy.standard_errors()[list(design.accuracy.interest)]
    # Sixty draws know a spread to 9 %; ten of them together to 3 %.
    assert spread / said == pytest.approx(np.ones(10), abs=0.3)
    assert np.mean(np.log(spread / said)) == pytest.approx(0.0, abs=0.1)


def test_a_sensor_of_another_arm_is_refused(rows):
    other = ci.from_modified_dh("other", [ci.DHRow(0, 0), ci.DHRow(1, 0)])
    with pytest.raises(ci.ProblemError, match="sensor's arm has joints"):
        ci.design_trajectory(other, FORM, AIM, sensor=rows)


def test_a_load_on_a_link_is_one_body_with_it():
    """In Pinocchio's words: inertia of the link plus that of the tool, moved there."""
    loaded = with_load(arm(), "link4", TOOL)
    both = loaded.links[3].nominal
    assert both.vector == pytest.approx((arm().links[3].nominal + TOOL).vector)
    assert loaded.links[2] is not None and loaded.links[2].nominal.mass == 3.0


PROBLEM = """
name = "wrist"
[model]
modified_dh = [
  { alpha_deg = -90, a = 0.0, lower = -2, upper = 2, velocity = 3, effort = 80 },
  { alpha_deg = 0, a = 0.4, lower = -2, upper = 2, velocity = 3, effort = 80 },
  { alpha_deg = -90, a = 0.3, lower = -2, upper = 2, velocity = 3, effort = 80 },
]
[wrist_sensor]
frame = "link3"
tool = "gripper"
[links.gripper]
mass_bounds = [0.5, 2.0]
[excitation]
duration = 5.0
harmonics = 3
[excitation.limits]
acceleration = 8.0
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "problem.toml").write_text(PROBLEM)
    return tmp_path


@pytest.mark.slow
def test_in_the_shell_a_motion_for_the_tool_of_a_problem(folder, capsys):
    words = ["excite", str(folder), "--for", "payload", "--time-limit", "1"]
    words += ["--starts", "1", "--workers", "1", "--output", str(folder / "out")]
    words += ["--verbose"]
    assert main(words) == 0
    assert "gripper.Izz" in capsys.readouterr().out
    record = json.loads((folder / "out" / "excitation.json").read_text())
    assert record["sensor"] == "link3" and record["aim"]["interest"] == ["gripper.*"]
    assert record["stages"][-1]["proven"] and record["aim"]["noise"] == NOISE
    assert (folder / "out" / "trajectory.csv").exists()


def test_without_a_word_a_sensors_problem_is_for_its_tool(folder, capsys):
    assert main(["excite", str(folder), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "16, by the wrench sensor at link3" in shown and "gripper" in shown


def test_torque_limits_allow_for_the_tool(folder):
    moved = what_moves(ci.load_problem(folder))
    assert "carries 2 kg at link3" in moved.notes[0]
    tools = np.zeros((2, 16))
    tools[:, 0] = 0.7, 0.9
    moved = what_moves(ci.load_problem(folder), tools)
    assert "carries 0.9 kg" in moved.notes[0]
    text = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(text.replace("mass_bounds = [0.5, 2.0]", ""))
    assert "without its tool" in what_moves(ci.load_problem(folder)).notes[0]
