"""Robots with followers, exported: URDF by Pinocchio's own rules, NumPy, MJCF, JSON."""

import json
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from estimates import estimate_of
from robots import URDF, random_body, random_robot, random_states, with_followers

from consistent_id import DriveTerms, ProblemError, TorqueModel, to_mjcf, to_urdf
from consistent_id.export import to_casadi, to_json, to_numpy, to_pinocchio
from consistent_id.regression.mass_matrix import mass_matrices
from consistent_id.robot import Mimic, load_mjcf, load_urdf

RULES = {"j2": Mimic("j0", -0.5, 0.3), "j3": Mimic("j1", 2.0)}


@pytest.fixture(scope="module")
def estimate():
    """Random bodies on a chain of five joints, of which two follow others."""
    rng = np.random.default_rng(4)
    _, robot = random_robot(rng, 5)
    model = TorqueModel(with_followers(robot, RULES), DriveTerms(viscous=True))
    return estimate_of(model, [random_body(rng) for _ in range(5)], 0.7)


def _states(estimate):
    return random_states(np.random.default_rng(1), len(estimate.model.robot), 4)


def test_a_new_urdf_has_the_followers_for_pinocchio(estimate):
    text = to_urdf(estimate).content.decode()
    model = pin.buildModelFromXML(text, mimic=True)
    assert model.nv == len(estimate.model.robot) == 3
    names = estimate.model.robot.joint_names
    leaders = [model.joints[model.getJointId(name)] for name in names]
    torques = estimate.model.predict(estimate.parameters, *_states(estimate))
    for tau, q, dq, ddq in zip(torques, *_states(estimate), strict=True):
        parts = [
            [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            for x, joint in zip(q, leaders, strict=True)
        ]
        state = np.concatenate(parts), dq, ddq
        expected = pin.rnea(model, model.createData(), *state) + 0.7 * dq
        assert np.allclose(tau, expected, rtol=0, atol=1e-9 * abs(expected).max())


def test_a_urdf_of_ones_own_keeps_its_mimics(tmp_path):
    path, rule = tmp_path / "robot.urdf", '<mimic joint="turn" multiplier="-2"/>'
    path.write_text(URDF.replace('<axis xyz="0 1 0"/>', rule))
    model = TorqueModel(load_urdf(path), DriveTerms(viscous=True))
    bodies = [random_body(np.random.default_rng(0)) for _ in range(3)]
    export = to_urdf(estimate_of(model, bodies, 0.7), path, allow_refused=True)
    assert rule.encode() in export.content
    path.write_bytes(export.content)
    again = load_urdf(path)
    assert again.joints[2].mimic == Mimic("turn", -2.0)
    assert np.allclose(again.nominal, np.concatenate([b.vector for b in bodies]))


def test_a_follower_resists_through_its_leader_alone(tmp_path):
    own = '<dynamics damping="0.2" friction="0.4"/>'
    rule = f'<mimic joint="turn" multiplier="-2"/> {own}'
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.replace('<axis xyz="0 1 0"/>', rule))
    model = TorqueModel(load_urdf(path), DriveTerms(viscous=True))
    bodies = [random_body(np.random.default_rng(0)) for _ in range(3)]
    export = to_urdf(estimate_of(model, bodies, 0.7), path, allow_refused=True)
    assert any("spin" in note and "follows" in note for note in export.notes)
    # A damper at the leader's rate, one at the follower's twice as large and reversed.
    joints = ElementTree.fromstring(export.content).iter("joint")
    stated = {j.get("name"): j.find("dynamics") for j in joints}
    damping = {n: float(d.get("damping")) for n, d in stated.items() if d is not None}
    felt = damping["turn"] + (-2.0) ** 2 * damping["spin"]
    assert felt == pytest.approx(0.7, abs=1e-12)
    assert float(stated["spin"].get("friction")) == 0.0
    # Without drive terms nothing is known, and it keeps its own.
    bare = estimate_of(TorqueModel(load_urdf(path)), bodies, 0.7)
    assert own.encode() in to_urdf(bare, path, allow_refused=True).content


def test_energy_lost_in_mujoco_is_that_of_the_leader(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><compiler angle="radian"/><worldbody>
      <body name="a"><joint name="lead" axis="0 0 1" damping="5" frictionloss="1"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body name="b" pos="1 0 0">
          <joint name="follow" axis="0 0 1" damping="0.3" armature="0.2"
                 frictionloss="0.1" stiffness="2"/>
          <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
      </worldbody><equality><joint joint1="follow" joint2="lead"
        polycoef="0 -2 0 0 0"/></equality></mujoco>"""
    path = tmp_path / "robot.xml"
    path.write_text(text)
    model = TorqueModel(load_mjcf(path), DriveTerms(viscous=True))
    bodies = [random_body(np.random.default_rng(k)) for k in range(2)]
    export = to_mjcf(estimate_of(model, bodies, 0.7), path, allow_refused=True)
    assert any("follow" in note and "contain" in note for note in export.notes)
    found = mujoco.MjModel.from_xml_string(export.content.decode())
    data = mujoco.MjData(found)
    data.qvel[:] = 1.0, -2.0
    mujoco.mj_forward(found, data)
    assert data.qfrc_passive @ data.qvel == pytest.approx(-0.7, abs=1e-9)
    assert np.array_equal(found.dof_armature, [0.0, 0.0])
    assert np.array_equal(found.dof_frictionloss, [0.0, 0.0])


@pytest.mark.slow
def test_functions_are_of_the_coordinates(estimate):
    space = {}
    exec(to_numpy(estimate).content.decode(), space)
    functions, states = to_casadi(estimate), _states(estimate)
    expected = estimate.model.predict(estimate.parameters, *states)
    found = space["inverse_dynamics"](*states)
    assert np.allclose(found, expected, rtol=0, atol=1e-12 * abs(expected).max())
    M = mass_matrices(estimate.model, estimate.parameters, states[0])
    found = space["mass_matrix"](states[0])
    assert np.allclose(found, M, rtol=0, atol=1e-12 * abs(M).max())
    for tau, matrix, q, dq, ddq in zip(expected, M, *states, strict=True):
        found = functions.inverse_dynamics(q, dq, ddq).full().ravel()
        assert np.allclose(found, tau, rtol=0, atol=1e-12 * abs(expected).max())
        found = functions.mass_matrix(q).full()
        assert np.allclose(found, matrix, rtol=0, atol=1e-12 * abs(M).max())


def test_mjcf_comes_back_with_its_followers(estimate, tmp_path):
    pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_bytes(to_mjcf(estimate).content)
    again = load_mjcf(path)
    assert {j.name: j.mimic for j in again.joints if j.mimic} == RULES
    rigid = estimate.links.ravel()
    states = _states(estimate)
    expected = TorqueModel(estimate.model.robot).predict(rigid, *states)
    found = TorqueModel(again).predict(again.nominal, *states)
    assert np.allclose(found, expected, rtol=0, atol=1e-8 * abs(expected).max())


def test_a_record_says_what_follows_what(estimate):
    joints = json.loads(to_json(estimate).content)["joints"]
    rule = {"joint": "j0", "multiplier": -0.5, "offset": 0.3}
    assert joints[2]["mimic"] == rule
    assert "mimic" not in joints[0]


def test_a_pinocchio_model_is_refused_with_the_way_round(estimate):
    with pytest.raises(ProblemError, match=r"j2, j3 follow other joints.*mimic=True"):
        to_pinocchio(estimate)
