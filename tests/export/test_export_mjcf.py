"""MJCF: MuJoCo's inverse dynamics of what was written is ours."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from estimates import coupling, estimate_of, random_estimate, rigid
from mujoco_torques import SPRUNG, inverse_dynamics
from robots import random_robot, random_states

from consistent_id import (
    DriveTerms,
    InertialParameters,
    ModelError,
    TorqueModel,
    to_mjcf,
)
from consistent_id.export import mujoco_spec
from consistent_id.robot import load_mjcf

mujoco = pytest.importorskip("mujoco")

SOURCE = """
<mujoco model="arm">
  <compiler angle="degree"/>
  <option gravity="0.5 -0.3 -9.7"/>
  <default><joint damping="3" armature="0.2" stiffness="5" springref="7"/></default>
  <worldbody>
    <body name="upper" pos="0.1 0.2 0.3333333333333" euler="10 20 30">
      <joint name="turn" axis="0.6 0 0.8" pos="0.05 0 0.1" range="-120 90" ref="25"/>
      <inertial pos="0.1 0.02 0.3" mass="2" diaginertia="0.02 0.03 0.025"/>
      <body name="plate" pos="0 0.1 0" euler="0 45 0">
        <geom type="box" size="0.1 0.2 0.02" density="800" pos="0.02 0 0"/>
      </body>
      <body name="slider" pos="0.2 0 0" euler="0 90 0">
        <joint name="slide" type="slide" axis="0 -1 0" pos="0.3 0 0" range="0 0.4"/>
        <geom type="capsule" size="0.04" fromto="0 0 0 0.1 0.2 0.3" density="900"/>
        <body pos="0.1 0 0">
          <joint axis="0 1 0" pos="0 0 0.2"/><geom size="0.1" mass="0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
NAMED = '<joint name="joint2" axis'


def _expected(estimate, states):
    """Torque of bodies, rotors, dampers and springs; Coulomb friction is looked at."""
    q, dq, ddq = states
    tau = rigid(estimate, states)
    for j, name in enumerate(estimate.model.robot.joint_names):
        if estimate.model.terms[j].names:
            tau[:, j] += estimate[f"{name}.viscous"] * dq[:, j]
            tau[:, j] += estimate[f"{name}.rotor_inertia"] * ddq[:, j]
            tau[:, j] += estimate[f"{name}.spring"] * q[:, j]
            tau[:, j] += estimate[f"{name}.drag"] * dq[:, j] * abs(dq[:, j])
            tau[:, j] += estimate[f"{name}.offset"]
    return tau


def _assert_same_torque(content, estimate):
    model = mujoco.MjModel.from_xml_string(content.decode())
    names = estimate.model.robot.joint_names
    states = random_states(np.random.default_rng(0), len(names), 5)
    expected = _expected(estimate, states)
    found = inverse_dynamics(model, names, states)
    assert np.allclose(found, expected, rtol=0, atol=1e-10 * abs(expected).max())
    for name, terms in zip(names, estimate.model.terms, strict=True):
        loss = model.dof_frictionloss[int(model.joint(name).dofadr[0])]
        assert loss == (estimate[f"{name}.coulomb"] if terms.names else 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_built_anew_has_the_identified_torque(seed):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 5, tree=True)
    estimate = random_estimate(rng, robot, SPRUNG)
    export = to_mjcf(estimate)
    assert export.notes == ()
    _assert_same_torque(export.content, estimate)


def _edges():
    """Bodies at the edge of what can be: a plate, a rod, a point, and none."""
    rod = np.array([[0.3, 0.1, 0.2, 1.0], [0.1, 0.5, -0.4, 1.0]])
    plate = np.vstack([rod, [[0.7, 0.2, 0.1, 1.0]]])
    for points in (plate, rod, rod[:1]):
        yield InertialParameters.from_pseudo_inertia(points.T @ points)
    yield InertialParameters(np.zeros(10))


@pytest.mark.parametrize("body", list(_edges()), ids=["plate", "rod", "point", "none"])
def test_mujoco_loads_bodies_at_the_edge_of_what_can_be(body):
    rng = np.random.default_rng(0)
    _, robot = random_robot(rng, 3)
    estimate = estimate_of(TorqueModel(robot), [robot.links[0].nominal, body, body])
    export = to_mjcf(estimate, allow_refused=not body.mass)
    assert "thinner than MuJoCo accepts" in export.notes[0]
    _assert_same_torque(export.content, estimate)


@pytest.mark.slow
def test_mujoco_loads_the_constrained_estimate_of_a_study():
    from consistent_id import build_regression, constrained_least_squares, load_problem
    from consistent_id.problems.problem_estimates import recordings_of

    problem = load_problem("problems/rx60")
    training, _ = recordings_of(problem)
    estimate = constrained_least_squares(
        problem.model,
        build_regression(problem.model, training),
        constraints=problem.constraints,
    )
    _assert_same_torque(to_mjcf(estimate).content, estimate)


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(SOURCE)
    return path


@pytest.mark.parametrize("heavy", [False, True])
def test_a_file_of_ones_own_gets_the_identified_robot(source, heavy):
    robot = load_mjcf(source)
    rng = np.random.default_rng(3)
    estimate = random_estimate(rng, robot, (SPRUNG, SPRUNG, DriveTerms()))
    if heavy:  # what remains of the upper arm without its plate is a body
        links = [link.nominal + link.nominal for link in robot.links]
        drive = estimate.parameters[estimate.model.layout.inertial_size :]
        estimate = estimate_of(estimate.model, links, drive)
    export = to_mjcf(estimate, source)
    word = "the remainder without plate" if heavy else "in proportion to the masses"
    assert word in "\n".join(export.notes)
    text = export.content.decode()
    # The last joint has no drive terms, and keeps what its class says.
    model = mujoco.MjModel.from_xml_string(text)
    assert model.dof_damping[2] == 3.0
    undriven = text.replace('damping="3"', "").replace('armature="0.2"', "")
    undriven = undriven.replace('stiffness="5"', "")
    _assert_same_torque(undriven.encode(), estimate)
    assert model.ngeom == 3


def test_locked_joints_count_where_they_are_locked(source):
    locked = {"slide": 0.3, "joint2": -0.4}
    robot = load_mjcf(source, locked=locked)
    estimate = random_estimate(np.random.default_rng(5), robot)
    text = to_mjcf(estimate, source).content.decode()
    model = mujoco.MjModel.from_xml_string(text)
    # What the file's joints have besides; these bodies alone were identified.
    for own in (model.dof_armature, model.dof_damping, model.jnt_stiffness):
        own[:] = 0.0
    states = random_states(np.random.default_rng(0), 1, 5)
    expected = rigid(estimate, states)
    found = inverse_dynamics(model, robot.joint_names, states, locked)
    assert np.allclose(found, expected, rtol=0, atol=1e-10 * abs(expected).max())


@pytest.mark.slow
def test_what_stays_keeps_all_its_digits(source):
    robot = load_mjcf(source)
    estimate = estimate_of(TorqueModel(robot), [link.nominal for link in robot.links])
    states = random_states(np.random.default_rng(0), 3, 5)
    found, expected = (
        inverse_dynamics(model, robot.joint_names, states)
        for model in (
            mujoco.MjModel.from_xml_string(to_mjcf(estimate, source).content.decode()),
            mujoco.MjModel.from_xml_string(SOURCE.replace("<joint axis", NAMED)),
        )
    )
    assert np.allclose(found, expected, rtol=0, atol=1e-12 * abs(expected).max())


def test_coupled_gears_are_a_tendon():
    rng = np.random.default_rng(7)
    _, robot = random_robot(rng, 5)
    drive = DriveTerms(viscous=True, rotor_inertia=True)
    estimate = random_estimate(rng, robot, drive, (coupling(robot),))
    x = estimate.parameters.copy()
    x[50:60] += 3.0  # a joint's own is more than what it shares
    x[-2] = 0.0  # Coulomb friction is looked at, not computed
    estimate = replace(estimate, parameters=x)
    export = to_mjcf(estimate)
    model = mujoco.MjModel.from_xml_string(export.content.decode())
    if not hasattr(model, "tendon_armature"):
        assert "no coupling_rotor_inertia" in export.notes[0]
        pytest.skip("this MuJoCo has no inertia of tendons")
    assert export.notes == ()
    data = mujoco.MjData(model)
    states = random_states(rng, 5, 4)
    torques = estimate.model.predict(estimate.parameters, *states)
    for q, dq, ddq, tau in zip(*states, torques, strict=True):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, dq, tau
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        mujoco.mj_forward(model, data)
        assert np.allclose(data.qacc, ddq, rtol=0, atol=1e-10 * abs(ddq).max())


@pytest.mark.slow
def test_gears_that_share_more_than_they_have_are_said_not_to_be_expressed():
    rng = np.random.default_rng(7)
    _, robot = random_robot(rng, 5)
    estimate = random_estimate(rng, robot, DriveTerms(), (coupling(robot),))
    notes = "\n".join(to_mjcf(estimate).notes)
    assert "no coupling_viscous" in notes
    assert "no coupling_rotor_inertia" in notes
    model = mujoco.MjModel.from_xml_string(to_mjcf(estimate).content.decode())
    assert model.tendon_frictionloss[0] == estimate.parameters[-2]


def test_the_specification_can_be_built_upon():
    rng = np.random.default_rng(1)
    _, robot = random_robot(rng, 3)
    spec, _ = mujoco_spec(random_estimate(rng, robot))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    assert spec.compile().ngeom == 1


def test_what_mujoco_cannot_say_is_said():
    rng = np.random.default_rng(2)
    _, robot = random_robot(rng, 6)
    terms = DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.1, offset=True, asymmetric=False
    )
    estimate = random_estimate(rng, robot, terms, (coupling(robot),))
    notes = "\n".join(to_mjcf(estimate).notes)
    for words in (
        "offset; those of j0",
        "coupling_rotor_inertia",
        "tanh(velocity / scale)",
    ):
        assert words in notes


def test_another_file_is_refused(source):
    estimate = random_estimate(np.random.default_rng(4), load_mjcf(source))
    source.write_text(SOURCE.replace('name="slider"', 'name="sledge"'))
    with pytest.raises(ModelError, match=r"arm\.xml: no body 'slider' that joint"):
        to_mjcf(estimate, source)
    source.write_text("<mujoco>")
    with pytest.raises(ModelError, match="MuJoCo refuses it"):
        to_mjcf(estimate, source)


def test_a_urdf_of_another_robot_is_refused(source, tmp_path):
    estimate = random_estimate(np.random.default_rng(4), load_mjcf(source))
    urdf = tmp_path / "arm.urdf"
    urdf.write_text('<robot name="arm"><link name="base"/></robot>')
    with pytest.raises(ModelError, match=r"arm\.urdf"):
        to_mjcf(estimate, urdf)


def test_without_mujoco_the_message_says_how_to_install_it(monkeypatch):
    _, robot = random_robot(np.random.default_rng(1), 3)
    estimate = random_estimate(np.random.default_rng(1), robot)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModelError, match=r"pip install 'consistent-id\[mjcf\]'"):
        to_mjcf(estimate)


def test_levels_of_friction_are_the_least_squares_that_are_not_negative():
    from scipy.optimize import nnls

    from consistent_id.export.mjcf_export import _nonnegative

    rng = np.random.default_rng(0)
    for _ in range(200):
        shapes = np.column_stack([np.ones(65), abs(rng.normal(size=65))])
        wanted = rng.normal(size=65) + shapes @ rng.normal(size=2)
        np.testing.assert_allclose(
            _nonnegative(shapes, wanted), nnls(shapes, wanted)[0], atol=1e-12
        )
