"""Limits of joints, followers, datasheets and sizes of links, at both sides of each."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import (
    DHRow,
    InertialParameters,
    ModelError,
    RobotModel,
    from_modified_dh,
)
from consistent_id.robot import Datasheet, Joint, JointLimits, Link
from consistent_id.robot.model import (
    FixedFrame,
    Mimic,
    followers_at,
    limits_with_followers,
    transmissions,
)
from consistent_id.robot.scaling import (
    LinkScales,
    body_sizes,
    link_scales,
    placeholders,
    reference_bodies,
)
from consistent_id.robot.solids import DrawnDrive, DrawnParts


def joint(name="a", parent=-1, kind="revolute", **changes):
    place = {"rotation": np.eye(3), "translation": np.zeros(3), "axis": [0, 0, 1]}
    return Joint(name, kind, parent, **(place | changes))


def robot(*joints, gravity=(0.0, 0.0, -9.81)):
    links = tuple(Link(f"link_{each.name}") for each in joints)
    return RobotModel("robot", joints, links, gravity)


def test_limits_may_be_a_point_and_speeds_zero():
    limits = JointLimits(1.0, 1.0, 0.0, 0.0)
    assert (limits.lower, limits.velocity) == (1.0, 0.0)
    for wrong in ({"lower": 1.1, "upper": 1.0}, {"velocity": -1e-9}, {"effort": -1.0}):
        with pytest.raises(ModelError, match="joint limits"):
            JointLimits(**wrong)


def test_masses_of_datasheets_may_be_zero_and_boxes_flat():
    sheet = Datasheet(0.0, (0.0, 0.0), [0, 0, 0], [[0, 0, 0], [0, 1, 1]])
    assert sheet.mass == 0.0
    for wrong in (
        {"mass": -1e-9},
        {"mass_bounds": (-1e-9, 1.0)},
        {"mass_bounds": (1.1, 1.0)},
        {"com_box": [[0, 0, 1e-9], [1, 1, 0]]},
    ):
        with pytest.raises(ModelError, match="datasheet"):
            Datasheet(**wrong)


@pytest.mark.parametrize(("stretch", "refused"), [(4e-10, False), (6e-10, True)])
def test_rotations_are_orthonormal_to_nine_digits(stretch, refused):
    turned = (1.0 + stretch) * np.eye(3)  # R^T R - 1 is twice as much
    if refused:
        with pytest.raises(ModelError, match="not orthonormal"):
            FixedFrame("tool", turned, np.zeros(3))
    else:
        FixedFrame("tool", turned, np.zeros(3))


def test_only_the_first_joint_is_free_unless_all_are():
    free = [joint(name, kind="free") for name in "ab"]
    assert len(robot(joint())) == 1
    assert len(robot(free[0], joint("c", 0))) == 1
    assert len(robot(*free)) == 0
    with pytest.raises(ModelError, match="joint 'b' is free; only the first"):
        robot(joint(), free[1])
    with pytest.raises(ModelError, match="link 0 carries it"):
        joint("b", 0, "free")
    for parent in (1, 2, -2):
        with pytest.raises(ModelError, match=r"index 1.*comes before"):
            robot(joint(), joint("b", parent))
    assert robot(joint(), joint("b")).joints[1].parent == -1


def test_a_follower_is_at_a_multiple_of_its_leader_and_an_offset():
    follower = joint("b", mimic=Mimic("a", -2.0, 0.5))
    assert followers_at((joint(), follower), {"a": 1.0}) == {"b": -1.5}
    assert followers_at((joint(), follower), {"a": 1.0, "b": 3.0}) == {}
    assert followers_at((joint(), follower), {}) == {}
    free = joint("c", kind="free")
    found = transmissions((free, joint(), joint("d", 1), follower))
    assert found == ((-1, 0.0, 0.0), (0, 1.0, 0.0), (1, 1.0, 0.0), (0, -2.0, 0.5))
    assert str(Mimic("a", -2.0, 0.5)) == "-2 a +0.5"
    assert str(Mimic("a", 2.0, -1.5)) == "2 a -1.5"
    assert str(Mimic("a")) == "1 a"
    for wrong in ({"multiplier": 0.0}, {"multiplier": np.inf}, {"offset": np.nan}):
        with pytest.raises(ModelError, match="follows 'a'"):
            Mimic("a", **wrong)
    for leader in ("z", "b"):
        with pytest.raises(ModelError, match=f"by itself, not '{leader}'"):
            robot(joint(), follower, joint("d", mimic=Mimic(leader)))


@pytest.mark.parametrize(
    ("mimic", "range_", "expected"),
    [
        (Mimic("a", 2.0, 0.5), (-0.5, 1.5), (-0.5, 0.5)),
        (Mimic("a", -2.0, 0.5), (-0.5, 1.5), (-0.5, 0.5)),
        (Mimic("a", 0.5, 0.0), (-9.0, 9.0), (-1.0, 1.0)),
        (Mimic("a", 1.0, 1.0), (2.0, 3.0), (1.0, 1.0)),  # a single position
        (Mimic("a", 1.0, 1.0), (2.1, 3.0), None),
    ],
)
def test_a_leader_keeps_its_followers_within_their_limits(mimic, range_, expected):
    leader = joint(limits=JointLimits(-1.0, 1.0, 2.0, 7.0))
    follower = joint("b", mimic=mimic, limits=JointLimits(*range_, 3.0, 1.0))
    if expected is None:
        with pytest.raises(ModelError, match="no position; correct the limits"):
            limits_with_followers((leader, follower))
        return
    (found,) = limits_with_followers((leader, follower))
    assert (found.lower, found.upper) == expected
    assert found.velocity == min(2.0, 3.0 / abs(mimic.multiplier))
    assert found.effort == 7.0


def body(mass, extents=(0.1, 0.2, 0.3), com=(0.0, 0.0, 0.0)):
    """A body whose second moments are its mass times squared extents."""
    spread = mass * np.diag(np.square(extents))
    return InertialParameters.from_central(
        mass, com, np.trace(spread) * np.eye(3) - spread
    )


def arm(*bodies, lengths=(0.4, 0.4)):
    """Two links, whose joints are as far apart; each carries the next."""
    plain = from_modified_dh("arm", [DHRow(0, length) for length in lengths])
    links = [Link(f"link{k}", *one) for k, one in enumerate(bodies)]
    return replace(plain, links=tuple(links))


def test_a_links_mass_is_stated_nominal_or_the_mean_of_these():
    stated = Datasheet(mass=6.0)
    for bodies, masses in (
        ([(body(2.0),), (None,)], [2.0, 2.0]),
        ([(body(2.0), stated), (None,)], [6.0, 6.0]),
        ([(body(2.0),), (None, stated)], [2.0, 6.0]),
        # A link whose nominal mass is zero has a thousandth of it.
        ([(body(2.0),), (InertialParameters(np.zeros(10)),)], [2.0, 0.002]),
        ([(None,), (None,)], [1.0, 1.0]),
        # If none has a mass, the model says nothing of them.
        ([(InertialParameters(np.zeros(10)),)] * 2, [1.0, 1.0]),
    ):
        assert link_scales(arm(*bodies)).mass.tolist() == masses


@pytest.mark.parametrize(
    ("lengths", "expected"),
    [
        ((0.3, 0.4), [0.4, 0.4]),  # to the joint that it carries, else its own
        ((0.4, 0.0), [0.4, 0.04]),  # a tenth of the longest
        ((0.0, 0.4), [0.4, 0.4]),
    ],
)
def test_a_links_length_is_that_to_the_next_joint(lengths, expected):
    scales = link_scales(arm((None,), (None,), lengths=lengths))
    np.testing.assert_allclose(scales.length, expected)


def test_sizes_of_parameters_are_products_of_mass_and_length():
    scales = LinkScales([2.0, 3.0], [0.5, 0.1])
    assert scales.root[0].tolist() == [np.sqrt(2.0) * 0.5] * 3 + [np.sqrt(2.0)]
    first = [2.0, 1.0, 1.0, 1.0, *[0.5] * 6]
    assert scales.units[:10].tolist() == first
    widths = scales.widths([0.1, 0.2, 0.3])[:10]
    np.testing.assert_allclose(
        widths, np.multiply(first, [0.1] + [0.2] * 3 + [0.3] * 6)
    )


def test_a_body_is_as_large_as_its_length_or_its_spread():
    # sqrt(0.1^2 + 0.2^2 + 0.3^2) = 0.374, beyond a length of 0.3 and within 0.4
    for length, size in ((0.3, np.sqrt(0.14)), (0.4, 0.4)):
        long = arm((body(2.0),), (body(5.0),), lengths=(length, length))
        np.testing.assert_allclose(body_sizes(long), size)
    # About the joint, not the centre of mass:
    away = arm((body(2.0, com=(0.4, 0.0, 0.0)),), (body(5.0),), lengths=(0.3, 0.3))
    assert body_sizes(away)[0] == pytest.approx(np.sqrt(0.14 + 0.16))


def test_an_unknown_body_is_a_ball_about_its_stated_centre():
    sheet = Datasheet(mass=2.0, com=[0.1, 0.0, 0.0])
    reference = reference_bodies(arm((None, sheet), (None,)))
    ball = InertialParameters(reference[0])
    assert (ball.mass, ball.com.tolist()) == (2.0, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(ball.central_inertia, 0.1 * 2.0 * 0.16 * np.eye(3))
    assert not InertialParameters(reference[1]).com.any()


def test_bodies_that_are_all_the_same_are_placeholders():
    plain, moved = body(1.0), body(1.0, com=(0.3, 0.0, 0.0))
    empty = InertialParameters(np.zeros(10))
    thicker = body(1.0, (0.1, 0.2, 0.3 * (1.0 + 1e-8)))
    for bodies, alike in (
        ([plain, moved], True),  # wherever they are
        ([plain, body(1.0 + 1e-8)], False),
        ([plain, thicker], False),
        ([plain, None], False),
        ([empty, empty], True),
        ([plain, empty], False),
    ):
        assert placeholders(arm(*[(each,) for each in bodies])) is alike
    one = from_modified_dh("one", [DHRow(0, 0)])
    assert not placeholders(replace(one, links=(Link("link", plain),)))


@pytest.mark.parametrize(
    ("values", "known"),
    [
        ([0.12, 0.13, 0.14], True),
        ([0.12, 0.13, 0.13], False),  # three different ones
        ([0.1, 0.2, 0.3], False),  # with two digits
        ([0.12, 0.13, 0.3], True),
        ([0.12, 0.13, 0.3, 0.4], True),  # half of them
        ([0.12, 0.3, 0.4], False),
        ([0.12, 0.13, 0.0, 0.0], False),  # none is no value
        ([0.12, 0.13, 0.14, 0.0], True),
        ([120.0, 1.3, 14.0], True),
    ],
)
def test_nominal_drives_are_known_if_they_differ_and_are_not_round(values, known):
    def of(name):
        return {f"j{k}": DrawnDrive(**{name: v}) for k, v in enumerate(values)}

    for name in ("viscous", "coulomb"):
        parts = DrawnParts(drives=of(name))
        assert (parts.friction_known, parts.rotors_known) == (known, False)
    rotors = DrawnParts(drives=of("rotor_inertia"))
    assert (rotors.friction_known, rotors.rotors_known) == (False, known)
