"""Robots on their feet: contact Jacobians, rows free of contact forces, recovery."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FILES
from quadrupeds import FEET, FOOT, quadruped_text, standing

from consistent_id import (
    NotExcitedError,
    ProblemError,
    RecordingError,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    least_squares,
)
from consistent_id.recordings import ContactFlags
from consistent_id.regression import (
    BASE_ROWS,
    base_parameters,
    contact_force_left,
    contact_free_base,
    contact_free_model,
    contact_free_regression,
    contact_jacobian,
    row_levels,
)
from consistent_id.regression.row_structure import row_structure
from consistent_id.robot import load_mjcf, load_urdf

EVERY = [[True] * 4]
THREE = [[i != j for j in range(4)] for i in range(4)]  # one foot is always lifted


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    return load_mjcf(path, base="floating")


def flags(patterns):
    closed = np.array(patterns)
    return [ContactFlags(foot, closed[:, i], FOOT) for i, foot in enumerate(FEET)]


@pytest.mark.skipif(not FILES, reason="example-robot-data is missing")
@pytest.mark.parametrize("name", ["solo", "talos_reduced", "icub"])
def test_contact_jacobians_are_pinocchios(name):
    path = next(path for path in FILES if path.stem == name)
    robot = load_urdf(path, base="floating")
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    data, rng = model.createData(), np.random.default_rng(0)
    q, link = rng.uniform(-1.0, 1.0, len(robot)), robot.link_names[-1]
    positions = robot.joint_positions(q[None])[0, 1:]
    parts = [
        [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
        for x, joint in zip(positions, list(model.joints)[2:], strict=True)
    ]
    whole = np.concatenate([np.zeros(6), [1.0], *parts])
    frame = model.getFrameId(link)
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J = pin.computeFrameJacobian(model, data, whole, frame, aligned)
    expected = np.hstack([J[:, :6], J[:, 6:] @ robot.joint_rates[1:]])
    found = contact_jacobian(robot, q[None], frame=link)[0]
    assert np.allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "patterns, lost", [(EVERY, 4), (THREE, 0), (EVERY + THREE[:1], 3)]
)
def test_a_foot_that_is_never_lifted_hides_its_mass(robot, patterns, lost):
    """A mass at a contact pushes as a contact force does, however the robot moves."""
    model = TorqueModel(robot)
    base = contact_free_base(contact_free_model(model), flags(patterns * 2))
    assert len(base) == len(base_parameters(model)) - lost


@pytest.mark.slow
@pytest.mark.parametrize("patterns", [EVERY, THREE])
def test_bodies_are_recovered_without_force_sensors(robot, patterns):
    log = standing(robot, np.array(patterns * (400 // len(patterns))))
    model = contact_free_model(TorqueModel(robot))
    base = contact_free_base(model, log.contacts)
    found = least_squares(model, contact_free_regression(model, log), base=base)
    expected = base.projection @ robot.nominal
    assert np.allclose(found.base_values, expected, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_bodies_are_recovered_with_force_sensors(robot):
    """Measured wrenches belong to the other side of the same equations."""
    log = standing(robot, np.array(EVERY * 100))
    for rows in ((), BASE_ROWS, robot.joint_names):
        model = TorqueModel(robot, torque_joints=rows)
        found = least_squares(model, build_regression(model, log))
        expected = found.base.projection @ robot.nominal
        assert np.allclose(found.base_values, expected, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_the_base_wrench_alone_needs_no_torque(robot):
    log = replace(standing(robot, np.array(EVERY * 300)), torque=None)
    model = TorqueModel(robot, torque_joints=BASE_ROWS)
    assert len(least_squares(model, build_regression(model, log)).base) == len(
        base_parameters(TorqueModel(robot))
    )


def test_the_structure_of_rows_is_found_once_for_each_model(robot):
    model = contact_free_model(TorqueModel(robot))
    log = standing(robot, np.array(THREE))
    contact_free_regression(model, log)
    before = row_structure.cache_info()
    contact_free_regression(model, log)
    after = row_structure.cache_info()
    assert (after.hits, after.misses) == (before.hits + 1, before.misses)


@pytest.mark.slow
def test_noise_levels_weigh_rows_before_they_are_mixed(robot):
    """With right levels the regression is that of white noise of level one."""
    log = standing(robot, np.array(THREE * 200), noise=0.3, seed=1)
    model = contact_free_model(TorqueModel(robot))
    levels = row_levels(robot, force=1e-3, moment=1e-3, joints=0.3)
    base = contact_free_base(model, log.contacts)
    regression = contact_free_regression(model, log, sigma=levels)
    found = least_squares(model, regression, base=base)
    # Nine rows are left of 18; those without noise bring their own.
    assert regression.counts == (800 * 9,)
    off = (found.base_values - base.projection @ robot.nominal) / found.standard_errors
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_a_constrained_estimate_of_a_standing_robot_is_certified(robot):
    log = standing(robot, np.array(THREE * 100), noise=0.1)
    model = contact_free_model(TorqueModel(robot))
    base = contact_free_base(model, log.contacts)
    regression = contact_free_regression(model, log)
    found = constrained_least_squares(model, regression, base=base)
    assert found.certificate.verdict == "certified"
    assert found.verdict.word != "do not use"


def test_forces_tell_whether_the_contacts_are_where_they_are_said_to_be(robot):
    log = standing(robot, np.array(THREE * 50))
    model = TorqueModel(robot)
    assert contact_force_left(model, log) < 1e-9
    swapped = [
        ContactFlags(foot, log.contacts[3 - i].closed, FOOT)
        for i, foot in enumerate(FEET)
    ]
    assert contact_force_left(model, replace(log, contacts=tuple(swapped))) > 0.1
    higher = [ContactFlags(c.frame, c.closed, (0, 0, -0.1)) for c in log.contacts]
    assert contact_force_left(model, replace(log, contacts=tuple(higher))) > 0.01
    with pytest.raises(RecordingError, match="no wrench was measured"):
        contact_force_left(model, replace(log, wrenches=()))


@pytest.mark.slow
def test_doubtful_samples_have_no_rows(robot):
    log = standing(robot, np.array(THREE * 50))
    model = contact_free_model(TorqueModel(robot))
    certain = np.arange(200) >= 50
    doubtful = [replace(flag, certain=certain) for flag in log.contacts]
    kept = contact_free_regression(model, replace(log, contacts=tuple(doubtful)))
    later = contact_free_regression(model, log.samples(slice(50, None)))
    assert kept.counts == later.counts
    assert np.allclose(abs(kept.factors[0]), abs(later.factors[0]), atol=1e-9)
    never = [replace(f, certain=np.zeros(200, dtype=bool)) for f in log.contacts]
    with pytest.raises(NotExcitedError, match="uncertain contact"):
        contact_free_regression(model, replace(log, contacts=tuple(never)))


@pytest.mark.slow
def test_two_contacts_at_one_point_are_one(robot):
    log = standing(robot, np.array(EVERY * 100))
    model = contact_free_model(TorqueModel(robot))
    twice = replace(log, contacts=(*log.contacts, log.contacts[0]))
    once, doubled = (contact_free_regression(model, x) for x in (log, twice))
    assert once.counts == doubled.counts
    # Factors of deficient rank are not unique, what they say is.
    squares = [r.factors[0].T @ r.factors[0] for r in (once, doubled)]
    assert np.allclose(*squares, rtol=0, atol=1e-9 * abs(squares[0]).max())


def test_a_fixed_base_has_no_rows_free_of_contact_forces(robot):
    with pytest.raises(ProblemError, match="contact_free_model"):
        contact_free_regression(TorqueModel(robot), [])


def test_the_largest_torque_of_mixed_rows_is_kept_however_small(robot):
    log = standing(robot, np.array(THREE * 5))
    model = contact_free_model(TorqueModel(robot))
    whole, small = (
        contact_free_regression(model, replace(log, torque=size * log.torque))
        for size in (1.0, 1e-6)
    )
    np.testing.assert_allclose(small.peaks, 1e-6 * whole.peaks)
    assert small.peaks.max() < 1e-3
