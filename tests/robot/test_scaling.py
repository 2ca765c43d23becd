"""Typical sizes of links, where the model says little."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import DHRow, InertialParameters, from_modified_dh
from consistent_id.robot.inertia import second_moments
from consistent_id.robot.model import Link
from consistent_id.robot.scaling import (
    USUAL_WIDTHS,
    LinkScales,
    link_scales,
    placeholders,
    reference_bodies,
)


def test_a_robot_whose_joints_are_all_in_one_place_is_a_metre_long():
    table = [DHRow(0, 0), DHRow(-np.pi / 2, 0)]
    scales = link_scales(from_modified_dh("wrist", table))
    assert scales.length.tolist() == [0.1, 0.1]  # a tenth of it, at the least
    assert scales.mass.tolist() == [1.0, 1.0]


def test_sizes_scale_with_the_units_of_length_as_their_dimensions_say():
    metres, feet = (
        link_scales(from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4 * unit)]))
        for unit in (1.0, 1.0 / 0.3048)
    )
    ratio = (feet.units / metres.units).reshape(2, 10)
    powers = [0, 1, 1, 1, 2, 2, 2, 2, 2, 2]  # mass, first moments, inertia
    np.testing.assert_allclose(ratio, (1.0 / 0.3048) ** np.array([powers] * 2))
    np.testing.assert_allclose(metres.units[14:], 0.4**2)  # 1 kg, 0.4 m


@pytest.mark.parametrize("mass", [0.02, 30.0])
def test_a_nominal_body_is_the_reference_however_light(mass):
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4)])
    inertia = mass * np.diag([0.02, 0.03, 0.025])
    body = InertialParameters.from_central(mass, [0.1, 0.0, 0.02], inertia)
    links = (Link("link1", None), Link("link2", body))
    robot = replace(arm, links=links)
    assert link_scales(robot).mass[1] == mass
    np.testing.assert_allclose(reference_bodies(robot)[1], body.vector, rtol=1e-12)


@pytest.mark.parametrize(("thickness", "raised"), [(2e-3, False), (5e-4, True)])
def test_a_body_thinner_than_a_thousandth_of_its_link_is_made_thicker(
    thickness, raised
):
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4)])
    spread = 3.0 * np.diag([0.1, 0.2, 0.4 * thickness]) ** 2
    plate = InertialParameters.from_central(
        3.0, [0.1, 0.0, 0.0], np.trace(spread) * np.eye(3) - spread
    )
    robot = replace(arm, links=(Link("link1", None), Link("link2", plate)))
    reference = InertialParameters(reference_bodies(robot)[1])
    least = np.linalg.eigvalsh(second_moments(reference.central_inertia))[0]
    wanted = 0.1 if raised else thickness
    assert least == pytest.approx(3.0 * (0.4 * wanted) ** 2, rel=1e-6)


@pytest.mark.parametrize(("second", "alike"), [(1.0, True), (1.1, False)])
def test_equal_point_masses_are_placeholders(second, alike):
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4)])
    bodies = [
        InertialParameters.from_central(m, np.zeros(3), np.zeros((3, 3)))
        for m in (1.0, second)
    ]
    links = (Link("link1", bodies[0]), Link("link2", bodies[1]))
    assert placeholders(replace(arm, links=links)) == alike


def test_usual_errors_of_a_body_are_shares_of_its_mass_and_length():
    scales = LinkScales(np.array([2.0, 3.0]), np.array([0.5, 4.0]))
    errors = scales.widths(USUAL_WIDTHS).reshape(2, 10)
    assert errors[0] == pytest.approx([0.1, *[0.15] * 3, *[0.15] * 6])
    assert errors[1] == pytest.approx([0.15, *[1.8] * 3, *[14.4] * 6])
