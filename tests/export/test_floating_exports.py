"""Robots whose base floats, exported with the base's body and read again."""

import numpy as np
import pinocchio as pin
import pytest
from quadrupeds import quadruped_text, standing

from consistent_id import (
    DriveTerms,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    TorqueModel,
    constrained_least_squares,
    to_mjcf,
    to_urdf,
)
from consistent_id.export import to_casadi, to_json, to_numpy, to_pinocchio
from consistent_id.export.export_formats import exported
from consistent_id.recordings import BaseMotion
from consistent_id.regression import (
    contact_free_base,
    contact_free_model,
    contact_free_regression,
)
from consistent_id.robot import load_mjcf, load_urdf

THREE = [[i != j for j in range(4)] for i in range(4)]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    head = '<body name="head"><geom size="0.1" mass="1"/></body>'
    path.write_text(quadruped_text(f"<freejoint/>{head}"))
    return path


@pytest.fixture(scope="module")
def estimate(source):
    robot = load_mjcf(source, base="floating")
    drive = DriveTerms(rotor_inertia=True, viscous=True)
    model = contact_free_model(TorqueModel(robot, drive))
    log = standing(robot, np.array(THREE * 150), noise=0.05)
    return constrained_least_squares(
        model,
        contact_free_regression(model, log),
        base=contact_free_base(model, log.contacts),
        constraints=[PhysicalConsistency(), NonNegativeDrive()],
    )


def assert_same_bodies(robot, estimate):
    assert robot.floating
    assert robot.link_names == estimate.model.robot.link_names
    inertial = estimate.parameters[: estimate.model.layout.inertial_size]
    assert np.allclose(robot.nominal, inertial, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("in_place", [True, False])
def test_mjcf_has_the_bases_body(estimate, source, tmp_path, in_place):
    path = tmp_path / "found.xml"
    given = {"source": source} if in_place else {}
    path.write_bytes(to_mjcf(estimate, allow_refused=True, **given).content)
    assert_same_bodies(load_mjcf(path, base="floating"), estimate)


@pytest.mark.slow
def test_the_free_joint_of_the_base_is_not_counted_as_one_that_moves(estimate):
    notes = exported(estimate, "mjcf", allow_refused=True).notes
    assert any("only the 12 joints that move" in note for note in notes)


@pytest.mark.slow
def test_urdf_has_the_bases_body_as_its_root(estimate, tmp_path):
    path = tmp_path / "found.urdf"
    path.write_bytes(to_urdf(estimate, allow_refused=True).content)
    assert_same_bodies(load_urdf(path, base="floating"), estimate)
    again = tmp_path / "again.urdf"
    again.write_bytes(to_urdf(estimate, source=path, allow_refused=True).content)
    assert_same_bodies(load_urdf(again, base="floating"), estimate)


@pytest.mark.slow
def test_pinocchios_model_has_a_free_flyer(estimate):
    model = to_pinocchio(estimate, allow_refused=True)
    robot = estimate.model.robot
    assert model.nv == 6 + len(robot)
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, len(robot)))
    parts = [
        [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
        for x, joint in zip(q, list(model.joints)[2:], strict=True)
    ]
    whole = np.concatenate([np.zeros(6), [1.0], *parts])
    v, a = np.append(np.zeros(6), dq), np.append(np.zeros(6), ddq)
    torque = pin.rnea(model, model.createData(), whole, v, a)
    torque += model.damping * v  # of armatures RNEA knows
    every = TorqueModel(robot, estimate.model.drive)
    expected = every.predict(
        estimate.parameters,
        *(x[None] for x in (q, dq, ddq)),
        base=BaseMotion.at_rest(1),
    )
    assert np.allclose(torque, expected[0], rtol=0, atol=1e-9)


def test_json_names_the_free_joint(estimate):
    assert b'"free"' in to_json(estimate, allow_refused=True).content


@pytest.mark.parametrize("export", [to_numpy, to_casadi])
def test_functions_of_joints_alone_are_refused(estimate, export):
    with pytest.raises(ProblemError, match="base of 'quadruped' floats"):
        export(estimate, allow_refused=True)
