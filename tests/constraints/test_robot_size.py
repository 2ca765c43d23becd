"""Delivered bodies beside the geometry: a wrong clock and an absurd centre show."""

from dataclasses import replace

import numpy as np
import pytest
from logged import FRICTION, URDF, moved

from consistent_id import (
    DHRow,
    DriveTerms,
    FixedMasses,
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    differentiated,
    from_modified_dh,
    low_passed,
)
from consistent_id.constraints.delivered_bodies import _axis, robot_size
from consistent_id.estimation.body_reasons import INERTIA_REFUSED
from consistent_id.robot import load_urdf
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import Link

DRIVE = DriveTerms(
    viscous=True,
    coulomb="tanh",
    velocity_scale=0.02,
    offset=True,
    rotor_inertia=True,
)


@pytest.fixture(name="model")
def _model(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    return TorqueModel(load_urdf(file), DRIVE)


def _parameters(model, bodies):
    rest = np.zeros(len(model.layout) - model.layout.inertial_size)
    return np.concatenate([*(body.vector for body in bodies), rest])


def _estimate(model, factor):
    """Fit a log of the nominal robot whose clock runs slower by a factor."""
    plain = TorqueModel(model.robot, replace(DRIVE, rotor_inertia=False))
    raw = moved(plain)
    slow = Recording(raw.joints, factor * raw.time, raw.position, torque=raw.torque)
    cut = 10.0 / factor
    log = differentiated(low_passed(slow, motion_cutoff=cut, torque_cutoff=cut))
    return constrained_least_squares(
        model,
        build_regression(model, log),
        constraints=[PhysicalConsistency(), FixedMasses({"upper": 4.0, "fore": 2.0})],
    )


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "found"), [(1.0, False), (2.0, True)])
def test_a_clock_at_half_speed_makes_bodies_larger_than_the_robot(model, factor, found):
    estimate = _estimate(model, factor)
    assert estimate.fit.misfit < 0.1  # no residual shows the clock
    kinds = [reason.kind for reason in estimate.verdict.reasons]
    assert ("robot's size" in kinds) == found
    assert (estimate.verdict.word == "use") == (not found)


def test_a_rod_along_its_link_has_a_third_of_the_most_inertia(model):
    # A rod of 0.4 m, as long as the link, turns about its end; the other is empty.
    rod = InertialParameters.from_central(
        4.0, [0.2, 0.0, 0.0], np.diag([0.0, 1.0, 1.0]) * 4.0 * 0.4**2 / 12.0
    )
    empty = InertialParameters(np.zeros(10))
    size = robot_size(model, _parameters(model, [rod, empty]))
    assert size.size[0] == pytest.approx(0.4)
    assert size.inertia[0] == pytest.approx(1.0 / 3.0)
    assert size.centre[0] == pytest.approx(0.2)
    assert size.radius[0] == pytest.approx(0.4 / np.sqrt(12.0))


def test_an_absurd_centre_of_mass_does_not_make_a_link_long(model):
    nominal = [link.nominal for link in model.robot.links]
    before = robot_size(model, _parameters(model, nominal))
    far = InertialParameters.from_central(
        4.0, [5.0, 0.0, 0.0], nominal[0].central_inertia
    )
    after = robot_size(model, _parameters(model, [far, nominal[1]]))
    np.testing.assert_array_equal(after.size, before.size)
    assert after.centre[0] == pytest.approx(5.0)
    assert after.inertia[0] > 10.0 > 1.0 > before.inertia.max()


def test_an_inertia_that_may_be_the_motors_is_not_judged(model):
    plain = TorqueModel(model.robot, replace(DRIVE, rotor_inertia=False))
    x = np.concatenate([model.robot.nominal, FRICTION])
    size = robot_size(plain, x)
    assert np.isnan(size.inertia).all() and np.isnan(size.radius).all()
    assert np.isfinite(size.centre).all()


def test_a_link_of_unknown_body_may_be_long(model):
    robot = model.robot
    links = (robot.links[0], replace(robot.links[1], nominal=None))
    unknown = replace(model, robot=replace(robot, links=links))
    nominal = [link.nominal for link in robot.links]
    size = robot_size(unknown, _parameters(unknown, nominal))
    assert size.size[1] == np.inf
    assert (size.inertia == 0.0).all()


def test_a_link_without_mass_and_of_unknown_size_adds_nothing(model):
    links = list(model.robot.links)
    links[-1] = replace(links[-1], nominal=None)
    bare = replace(model, robot=replace(model.robot, links=tuple(links)))
    parameters = np.zeros(len(bare.layout))
    size = robot_size(bare, parameters)
    assert np.isinf(size.size[-1])
    assert np.isnan(size.inertia).all() and np.isnan(size.radius).all()


def test_a_short_shape_does_not_shorten_the_nominal_body(model):
    """A file may draw a link without its tool."""
    links = list(model.robot.links)
    tool = InertialParameters.from_central(3.0, [1.2, 0.0, 0.0], 0.01 * np.eye(3))
    links[1] = replace(links[1], nominal=tool)
    tooled = replace(model, robot=replace(model.robot, links=tuple(links)))
    exact = _parameters(tooled, [link.nominal for link in links])
    drawn = {link.name: 0.1 for link in links}
    size, bare = robot_size(tooled, exact, drawn), robot_size(tooled, exact)
    np.testing.assert_array_equal(size.size, bare.size)
    assert size.size[1] > 1.2
    assert np.nanmax(size.inertia) <= 1.0
    # A body far beyond both the shape and the nominal body is still seen.
    long = InertialParameters.from_central(3.0, [6.0, 0.0, 0.0], 0.01 * np.eye(3))
    far = robot_size(tooled, _parameters(tooled, [links[0].nominal, long]), drawn)
    assert np.nanmax(far.inertia) > INERTIA_REFUSED


def test_a_long_shape_widens_the_nominal_body(model):
    nominal = [link.nominal for link in model.robot.links]
    x = _parameters(model, nominal)
    name = model.robot.link_names[1]
    assert robot_size(model, x, {name: 0.9}).size[1] == pytest.approx(0.9)


@pytest.mark.parametrize("mass", [0.05, 40.0])
def test_a_link_is_as_large_as_a_thin_ball_of_its_mass(mass):
    bodies = [Link(f"link{k}", None) for k in (1, 2)]
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.01)])
    robot = replace(arm, links=tuple(bodies))
    body = InertialParameters.from_central(mass, [0, 0, 0], mass * np.eye(3))
    model = TorqueModel(robot)
    size = robot_size(
        model, _parameters(model, [body, body]), reach={"link1": 0.0, "link2": 0.0}
    )
    radius = (3.0 * mass / (4.0 * np.pi * 100.0)) ** (1.0 / 3.0)
    np.testing.assert_allclose(size.size, max(radius, 0.01), rtol=1e-12)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_small_link_at_the_end_is_judged_only_if_it_slides(kind):
    large, small = (
        InertialParameters.from_central(m, [0.1, 0.0, 0.0], 0.01 * m * np.eye(3))
        for m in (20.0, 0.01)
    )
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.02, kind=kind)])
    robot = replace(arm, links=(Link("link1", large), Link("link2", small)))
    model = TorqueModel(robot, DriveTerms(rotor_inertia=True))
    size = robot_size(model, _parameters(model, [large, small]))
    assert np.isfinite([size.radius[0], size.centre[0]]).all()
    slides = kind == "prismatic"
    assert np.isfinite([size.radius[1], size.centre[1]]).tolist() == 2 * [slides]


def balls(*masses, lengths=(0.4, 0.4)):
    """A flat arm with a ball of 5 cm at the end of each link, and its parameters."""
    plain = from_modified_dh("arm", [DHRow(0, 0), *[DHRow(0, x) for x in lengths[:-1]]])
    bodies = [
        InertialParameters.from_central(m, [x, 0, 0], m * 0.05**2 * np.eye(3))
        for m, x in zip(masses, lengths, strict=True)
    ]
    links = tuple(Link(f"l{k}", body) for k, body in enumerate(bodies))
    model = TorqueModel(replace(plain, links=links), DriveTerms(rotor_inertia=True))
    return model, _parameters(model, bodies)


def test_inertias_are_those_of_bodies_over_the_most_about_each_joint():
    """The most: all mass at its distance from the joint, and its size beyond that."""
    model, x = balls(2.0, 3.0)
    spread = 0.05 * np.sqrt(1.5)  # of trace 3 * 0.05^2 over two
    found = robot_size(model, x)
    np.testing.assert_allclose(found.size, 0.4 + spread)
    np.testing.assert_allclose(found.radius, spread)
    most = 3.0 * (0.4 + spread) ** 2
    assert found.inertia[1] == pytest.approx(3.0 * (0.16 + 0.05**2) / most)
    assert found.carried_by == found.joints == model.robot.joint_names


@pytest.mark.parametrize(("mass", "judged"), [(0.13, True), (0.115, False)])
def test_joints_of_little_inertia_are_not_judged(mass, judged):
    """Below a twentieth of the largest: about m 0.46^2 over 2 * 0.46^2 + m 0.86^2."""
    model, x = balls(2.0, mass)
    found = robot_size(model, x)
    ratio = 0.4612**2 * mass / (2.0 * 0.4612**2 + mass * 0.8612**2)
    assert (ratio > 0.05) is judged
    assert bool(np.isfinite(found.inertia[1])) is judged
    assert bool(np.isfinite(found.centre[1])) is judged
    assert bool(np.isfinite(found.radius[1])) is judged
    assert np.isfinite(found.inertia[0])


def test_a_link_is_as_long_as_its_shapes_its_joints_or_a_thin_ball_of_its_mass():
    model, x = balls(2.0, 3.0)
    spread = 0.05 * np.sqrt(1.5)
    assert robot_size(model, x, {"l1": 1.5}).size[1] == 1.5
    assert robot_size(model, x, {"l1": 0.1}).size[1] == pytest.approx(0.4 + spread)
    far, y = balls(2.0, 3.0, lengths=(0.9, 0.1))
    assert robot_size(far, y).size.tolist() == pytest.approx([0.9 + spread, 0.9])
    heavy = x.copy()
    heavy[10] = 1e4  # kg: a ball of 100 kg/m^3 has a radius of 2.88 m
    radius = (3.0 * 1e4 / (4.0 * np.pi * 100.0)) ** (1.0 / 3.0)
    assert robot_size(model, heavy).size[1] == pytest.approx(radius)


def test_a_direction_is_written_without_a_minus_zero_and_its_largest_part_is_positive():
    assert _axis(np.array([-0.999, 0.002, 0.04])) == "[1.00 0.00 -0.04]"
