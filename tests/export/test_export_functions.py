"""Functions of the identified robot: NumPy, CasADi and compiled C agree with Pinocchio.

Friction is that of `TorqueModel`, whose terms have tests of their own.
"""

import ctypes
import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from estimates import EVERY_TERM, coupling, estimate_of, random_estimate, rigid
from robots import random_robot, random_states
from some_fast import some_fast

from consistent_id import TorqueModel
from consistent_id.export import (
    robot_record,
    to_c,
    to_casadi,
    to_json,
    to_numpy,
    to_pinocchio,
)
from consistent_id.export.casadi_functions import casadi_file
from consistent_id.export.pinocchio_model import pinocchio_file
from consistent_id.regression import casadi_regressor

SEEDS = range(3)


def _estimate(seed):
    """A random tree with every drive term that there is, and coupled gears."""
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, len(EVERY_TERM), tree=True)
    return random_estimate(rng, robot, EVERY_TERM, (coupling(robot),))


def _expected(estimate, states):
    """Our torque, and from Pinocchio gravity torque and mass matrix."""
    model = to_pinocchio(estimate)
    data = model.createData()
    gravity, mass = [], []
    names, gears = estimate.model.robot.joint_names, estimate.model.couplings[0]
    first, second = names.index(gears.first), names.index(gears.second)
    shared = estimate[f"{gears.label}.coupling_rotor_inertia"]
    for q in states[0]:
        gravity.append(pin.computeGeneralizedGravity(model, data, q).copy())
        M = np.triu(pin.crba(model, data, q))
        M = M + np.triu(M, 1).T
        M[[first, second], [second, first]] += shared
        mass.append(M)
    return estimate.model.predict(estimate.parameters, *states), gravity, mass


def _plain(matrix):
    return np.array(matrix).ravel()


def _assert_near(found, expected):
    expected = np.asarray(expected)
    assert np.allclose(found, expected, rtol=0, atol=1e-10 * abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_numpy_module_stands_alone_and_agrees(seed, tmp_path):
    estimate = _estimate(seed)
    states = random_states(np.random.default_rng(seed), len(EVERY_TERM), 6)
    names: dict = {}
    exec(compile(str(to_numpy(estimate)), "robot.py", "exec"), names)
    tau, gravity, mass = _expected(estimate, states)
    _assert_near(names["inverse_dynamics"](*states), tau)
    _assert_near(names["gravity"](states[0]), gravity)
    _assert_near(names["mass_matrix"](states[0]), mass)
    one = names["inverse_dynamics"](*(x[0].tolist() for x in states))
    _assert_near(one, tau[0])
    assert "consistent_id" not in str(to_numpy(estimate)).replace('"""', "")


@pytest.mark.slow
def test_the_numpy_module_imports_numpy_alone(tmp_path):
    to_numpy(_estimate(0)).save(tmp_path / "arm.py")
    code = (
        "import sys, arm; arm.gravity([0.0] * 5);"
        "sys.exit(any(m.startswith(('consistent', 'pinocchio', 'casadi')) "
        "for m in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False)
    assert run.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(SEEDS, 2))
def test_casadi_functions_agree(seed):
    estimate = _estimate(seed)
    states = random_states(np.random.default_rng(seed), len(EVERY_TERM), 4)
    functions = to_casadi(estimate)
    tau, gravity, mass = _expected(estimate, states)
    for k, state in enumerate(zip(*states, strict=True)):
        _assert_near(_plain(functions.inverse_dynamics(*state)), tau[k])
        _assert_near(_plain(functions.gravity(state[0])), gravity[k])
        _assert_near(np.array(functions.mass_matrix(state[0])), mass[k])
        _assert_near(_plain(functions.rigid_body(*state)), rigid(estimate, states)[k])


@pytest.mark.slow
def test_a_casadi_file_is_loaded_and_agrees(tmp_path):
    import casadi as ca

    estimate = _estimate(0)
    path = casadi_file(estimate).save(tmp_path / "arm.casadi")
    dynamics = ca.Function.load(str(path))
    states = random_states(np.random.default_rng(0), len(EVERY_TERM), 1)
    found = dynamics(*(x[0] for x in states))
    for part, expected in zip(found, _expected(estimate, states), strict=True):
        _assert_near(_plain(part).reshape(np.shape(expected[0])), expected[0])


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")
@pytest.mark.parametrize("seed", some_fast(SEEDS))
def test_compiled_c_agrees(seed, tmp_path):
    estimate = _estimate(seed)
    source = to_c(estimate, name="my-arm").save(tmp_path / "arm.c")
    library = tmp_path / "arm.so"
    command = ["cc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror"]
    options = ["-Wno-unused-parameter", "-shared", "-fPIC"]
    subprocess.run([*command, *options, "-o", library, source, "-lm"], check=True)
    arm = ctypes.CDLL(str(library))
    n = len(EVERY_TERM)

    def call(function, size, *arguments):
        out = (ctypes.c_double * size)()
        vectors = [(ctypes.c_double * n)(*x) for x in arguments]
        getattr(arm, f"my_arm_{function}")(*vectors, out)
        return np.array(out)

    states = random_states(np.random.default_rng(seed), n, 4)
    tau, gravity, mass = _expected(estimate, states)
    for k, state in enumerate(zip(*states, strict=True)):
        _assert_near(call("inverse_dynamics", n, *state), tau[k])
        _assert_near(call("gravity", n, state[0]), gravity[k])
        _assert_near(call("mass_matrix", n * n, state[0]).reshape(n, n), mass[k])


def test_c_of_a_long_name_has_a_short_one_that_is_its_own_and_says_so():
    _, robot = random_robot(np.random.default_rng(0), 1)
    names = ["arm" * 100 + last for last in "ab"]
    found = []
    for name in names:
        estimate = random_estimate(np.random.default_rng(0), replace(robot, name=name))
        export = to_c(estimate)
        (note,) = [note for note in export.notes if "301 characters" in note]
        short = note.rpartition(" ")[2]
        assert len(short) == 100 and short.startswith("arm" * 30)
        assert f"void {short}_torque(" in export.content.decode()
        assert f"void {short}_torque(" in export.side.content.decode()
        found.append(short)
    assert len(set(found)) == 2
    plain = to_c(random_estimate(np.random.default_rng(0), robot))
    assert not any("characters" in note for note in plain.notes)


@pytest.mark.parametrize("seed", SEEDS)
def test_pinocchios_model_has_bodies_rotors_and_friction(seed):
    estimate = _estimate(seed)
    states = random_states(np.random.default_rng(seed), len(EVERY_TERM), 4)
    model = to_pinocchio(estimate)
    rotors = np.array(
        [
            estimate[f"{joint}.rotor_inertia"] if terms.rotor_inertia else 0.0
            for joint, terms in zip(
                estimate.model.robot.joint_names, EVERY_TERM, strict=True
            )
        ]
    )
    found = [pin.rnea(model, model.createData(), *s) for s in zip(*states, strict=True)]
    _assert_near(found, rigid(estimate, states) + rotors * states[2])
    joint = estimate.model.robot.joint_names[0]
    assert model.damping[0] == estimate[f"{joint}.viscous"]
    assert model.upperDryFrictionLimit[0] == estimate[f"{joint}.coulomb"]


@pytest.mark.parametrize("axis", [(0.0, 0.0, -1.0), (0.6, 0.0, 0.8)])
def test_pinocchios_model_has_continuous_joints_about_any_axis(axis):
    _, robot = random_robot(np.random.default_rng(3), 1)
    joint = replace(robot.joints[0], kind="continuous", axis=np.array(axis))
    estimate = random_estimate(
        np.random.default_rng(4), replace(robot, joints=(joint,))
    )
    q, dq, ddq = (np.array([[x]]) for x in (0.7, -1.2, 0.4))
    model = pin.Model()
    model.loadFromString(str(pinocchio_file(estimate)))
    at = np.array([np.cos(0.7), np.sin(0.7)])
    found = pin.rnea(model, model.createData(), at, dq[0], ddq[0])
    _assert_near([found], rigid(estimate, (q, dq, ddq)))


def test_pinocchios_file_is_read_back():
    estimate = _estimate(0)
    model = pin.Model()
    model.loadFromString(str(pinocchio_file(estimate)))
    assert model == to_pinocchio(estimate)


@pytest.mark.slow
def test_a_record_is_enough_to_build_the_robot_from():
    yaml = pytest.importorskip("ruamel.yaml")
    estimate = _estimate(1)
    export = to_json(estimate)
    record = json.loads(export.content)
    assert yaml.YAML(typ="safe").load(str(export)) == record
    assert record == robot_record(estimate)
    model = pin.Model()
    model.gravity.linear = np.array(record["gravity"])
    places = {None: 0}
    for joint, link in zip(record["joints"], record["links"], strict=True):
        kind = "Prismatic" if joint["kind"] == "prismatic" else "Revolute"
        made = getattr(pin, f"JointModel{kind}Unaligned")(np.array(joint["axis"]))
        place = pin.SE3(np.array(joint["rotation"]), np.array(joint["translation"]))
        k = model.addJoint(places[joint["parent"]], made, place, joint["name"])
        body = (link["mass"], np.array(link["com"]), np.array(link["inertia"]))
        model.appendBodyToJoint(k, pin.Inertia(*body), pin.SE3.Identity())
        places[link["name"]] = k
    states = random_states(np.random.default_rng(0), len(model.joints) - 1, 4)
    found = [pin.rnea(model, model.createData(), *s) for s in zip(*states, strict=True)]
    _assert_near(found, rigid(estimate, states))
    drive = record["drives"][record["joints"][0]["name"]]
    assert drive["terms"]["viscous"]["value"] == estimate.parameters[50]
    assert record["verdict"] == "use with care"  # its fit is not known


@pytest.mark.slow
def test_joints_without_a_measured_torque_have_one_in_the_functions():
    estimate = _estimate(0)
    names = estimate.model.robot.joint_names
    measured = replace(estimate.model, torque_joints=names[:2])
    part = replace(estimate, model=measured, sigma=np.zeros(2))
    states = random_states(np.random.default_rng(0), len(names), 2)
    expected = estimate.model.predict(estimate.parameters, *states)
    found = to_casadi(part).inverse_dynamics(*(x[0] for x in states))
    _assert_near(_plain(found), expected[0])
    assert casadi_regressor(measured).size1_out(0) == 2


def test_the_rigid_part_is_pinocchios_for_a_robot_from_pinocchio():
    rng = np.random.default_rng(5)
    reference, robot = random_robot(rng, 6, tree=True)
    estimate = estimate_of(TorqueModel(robot), [link.nominal for link in robot.links])
    states = random_states(rng, 6, 3)
    names: dict = {}
    exec(str(to_numpy(estimate)), names)
    data = reference.createData()
    expected = [pin.rnea(reference, data, *s).copy() for s in zip(*states, strict=True)]
    _assert_near(names["inverse_dynamics"](*states), expected)
