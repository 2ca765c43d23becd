"""Quadratic drag: closed form, fit, design, proof, exports, problem file."""

import ctypes
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from estimates import random_estimate
from paths import one_sine, random_path
from robots import random_robot, random_states

from consistent_id import (
    DHRow,
    DriveTerms,
    MotionLimits,
    NonNegativeDrive,
    PathForm,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    design_trajectory,
    from_modified_dh,
    load_problem,
    simulate_torque,
    to_urdf,
)
from consistent_id.export import to_c, to_casadi, to_numpy
from consistent_id.motion.proofs.torque_bounds import torque_bounds

DRAG = DriveTerms(viscous=True, drag=True)
ARM = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0.3)])
MASSES = np.array([[1.0, 0.1, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1]] * 2)


def test_the_torque_is_the_rate_times_its_size():
    dq = np.array([-2.0, -0.5, 0.0, 3.0])
    _, drag = DRAG.columns(0 * dq, dq, 0 * dq)
    assert np.array_equal(drag, [-4.0, -0.25, 0.0, 9.0])
    slide = from_modified_dh("slide", [DHRow(0, 0, kind="prismatic")])
    assert TorqueModel(slide, DRAG).layout.units[-1] == "N s^2/m^2"
    assert TorqueModel(ARM, DRAG).layout.units[-1] == "N m s^2/rad^2"


def test_the_coefficient_is_recovered_and_cannot_be_negative():
    model = TorqueModel(ARM, DRAG)
    x = np.concatenate([MASSES.ravel(), [0.7, 0.3, 0.5, 0.9]])
    motion = random_path(1, ARM.joint_names).recording(100.0)
    regression = build_regression(model, simulate_torque(model, x, motion))
    found = constrained_least_squares(
        model, regression, constraints=[NonNegativeDrive()]
    )
    assert found["joint1.drag"] == pytest.approx(0.3, rel=1e-4)
    assert found["joint2.drag"] == pytest.approx(0.9, rel=1e-4)
    assert "joint1.drag >= 0" in NonNegativeDrive().lower(model).in_labels


def test_the_proven_torque_is_that_of_the_fastest_instant():
    # without mass, torque is 2 w |w| with w = 2 pi cos(2 pi t): largest at both ends
    robot = from_modified_dh("rod", [DHRow(0, 0)])
    model = TorqueModel(robot, DriveTerms(drag=True))
    x = np.append(np.zeros(10), 2.0)
    bounds = torque_bounds(one_sine(robot.joint_names), model, x)
    most = 2.0 * (2.0 * np.pi) ** 2
    assert most <= bounds.highest[0] <= most * 1.001
    assert -most * 1.001 <= bounds.lowest[0] <= -most


@pytest.mark.slow
def test_a_motion_is_designed_with_drag_and_its_torque_is_proven():
    one = np.ones(2)
    limits = MotionLimits(
        ARM.joint_names, -2 * one, 2 * one, 3 * one, 10 * one, 200 * one, 40 * one
    )
    model = TorqueModel(ARM, DRAG)
    x = np.concatenate([MASSES.ravel(), [0.7, 0.3, 0.5, 0.9]])
    design = design_trajectory(
        model, PathForm(5.0, 2), limits=limits, parameters=x, starts=1, workers=1
    )
    design.proof.require()
    samples = design.trajectory.evaluate(np.linspace(0.0, 5.0, 2001))
    torque = abs(model.predict(x, *samples)).max(axis=0)
    margins = {(m.joint, m.quantity): m for m in design.proof.margins.margins}
    for name, most in zip(ARM.joint_names, torque, strict=True):
        bounds = [m.bound for (j, q), m in margins.items() if j == name and "torq" in q]
        assert most <= max(abs(b) for b in bounds) <= 40.0


@pytest.mark.slow
def test_exported_functions_have_the_same_torque_and_urdf_says_that_it_lacks_it():
    rng = np.random.default_rng(3)
    _, robot = random_robot(rng, 3)
    estimate = random_estimate(rng, robot, DRAG)
    states = random_states(rng, 3, 5)
    expected = estimate.model.predict(estimate.parameters, *states)
    names: dict = {}
    exec(compile(str(to_numpy(estimate)), "robot.py", "exec"), names)
    assert np.allclose(names["inverse_dynamics"](*states), expected, rtol=1e-12)
    function = to_casadi(estimate).inverse_dynamics
    for tau, *state in zip(expected, *states, strict=True):
        assert np.allclose(function(*state).full().ravel(), tau, rtol=1e-12)
    (note,) = [note for note in to_urdf(estimate).notes if "drag" in note]
    assert note.startswith("URDF has no drag: j0 ")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")
def test_compiled_c_has_the_same_torque(tmp_path):
    rng = np.random.default_rng(4)
    _, robot = random_robot(rng, 3)
    estimate = random_estimate(rng, robot, DRAG)
    source = to_c(estimate, name="arm").save(tmp_path / "arm.c")
    library = tmp_path / "arm.so"
    command = ["cc", "-std=c99", "-shared", "-fPIC", "-o", library, source, "-lm"]
    subprocess.run(command, check=True)
    out, states = (ctypes.c_double * 3)(), random_states(rng, 3, 1)
    arguments = [(ctypes.c_double * 3)(*x[0]) for x in states]
    ctypes.CDLL(str(library)).arm_inverse_dynamics(*arguments, out)
    expected = estimate.model.predict(estimate.parameters, *states)[0]
    assert np.allclose(out, expected, rtol=1e-12)


def test_a_problem_file_chooses_it_by_its_key(tmp_path):
    (tmp_path / "problem.toml").write_text(
        'name = "arm"\n[model]\nmodified_dh = [{ alpha_deg = 0, a = 0 }]\n'
        '[constraints]\nmasses = "free"\n[drive]\ndrag = true\n'
    )
    (terms,) = load_problem(tmp_path).model.terms
    assert terms == DriveTerms(drag=True)
    assert replace(terms, viscous=True) == DRAG
