"""Claims of the built-in laws, each checked against the columns themselves."""

import numpy as np
import pytest

from consistent_id import DriveTerms, ProblemError
from consistent_id.regression.drive.drive_terms import LAWS
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive.laws import (
    AsymmetricCoulomb,
    Coulomb,
    Drag,
    FrictionSlope,
    LoadFriction,
    Offset,
    RotorInertia,
    Spring,
    Stribeck,
    Viscous,
)
from consistent_id.regression.drive.term import JointSamples

# With a jump at standstill, or a slope of its own.
EVERY = [
    Viscous(),
    Coulomb(),
    Coulomb(0.1),
    AsymmetricCoulomb(),
    AsymmetricCoulomb(0.1),
    FrictionSlope(),
    FrictionSlope(0.1),
    Stribeck(0.2),
    LoadFriction(),
    LoadFriction(0.1),
    Drag(),
    Offset(),
    RotorInertia(),
    Spring(),
]


def columns(term, q=0.3, dq=0.5, ddq=0.7):
    """The columns along one joint's motion, of which some may be given as arrays."""
    q, dq, ddq = np.broadcast_arrays(q, dq, ddq)
    found = term.columns(JointSamples(q, dq, ddq, 2.0 + 0.0 * q))
    return [np.broadcast_to(column, q.shape) for column in found]


def named(term):
    return f"{type(term).__name__}-{getattr(term, 'velocity_scale', '')}"


def test_every_law_is_here():
    assert {type(term) for term in EVERY} == set(LAWS.values())


@pytest.mark.parametrize("term", EVERY, ids=named)
def test_laws_jump_at_standstill_unless_they_are_smooth_or_have_a_scale(term):
    step = 1e-6
    jumps, bends = [], []
    for name in ("q", "dq", "ddq"):
        at = np.array([-2.0, -1.0, 1.0, 2.0]) * step
        for column in columns(term, **{name: at}):
            jumps.append(abs(column[2] - column[1]))
            bends.append(abs(column[0] - column[1] - column[2] + column[3]) / step)
    scaled = "velocity_scale" in term.shapes
    assert bool(max(jumps) < 1e-4) is (term.smooth or scaled)
    if term.smooth:
        assert max(bends) < 1e-4  # of the slope, too
    # Those that jump have something without a jump in their place.
    stand_in = term.smoothed(0.05)
    if term.smooth or scaled:
        assert stand_in is term
    else:
        assert stand_in.velocity_scale == 0.05


@pytest.mark.parametrize("term", EVERY, ids=named)
def test_laws_that_are_called_polynomials_are_and_no_others(term):
    """Third differences of a line, a square or a product of two vanish."""
    t = np.linspace(-1.0, 1.0, 9)
    thirds = [np.diff(column, 3) for column in columns(term, t, 0.3 + 2.0 * t, t)]
    assert term.polynomial is bool(np.max(np.abs(thirds)) < 1e-12)


@pytest.mark.parametrize("term", EVERY, ids=named)
def test_coefficients_of_energy_must_not_be_negative_and_others_may(term):
    """Friction opposes motion; a spring and an inertia store energy."""
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 200))
    found = columns(term, q, dq, ddq)
    along = {"RotorInertia": ddq, "Spring": q}.get(type(term).__name__, dq)
    works = all((column * along >= 0.0).all() for column in found)
    assert term.nonnegative is works
    assert term.friction is (type(term) not in (RotorInertia, Spring))
    assert term.needs_load is isinstance(term, LoadFriction)
    if term.friction and term.nonnegative:
        assert all(not c.any() for c in columns(term, 0.3, 0.0 * dq, 0.7))


def test_shapes_are_sought_within_what_drives_have():
    """Slopes of millimetres to a metre a second; exponents around the usual two."""
    scale = Coulomb.shape_parameters["velocity_scale"]
    assert (scale.low, scale.high) == (1e-3, 1.0)
    for term in (AsymmetricCoulomb, FrictionSlope, Stribeck, LoadFriction):
        assert term.shape_parameters["velocity_scale"] == scale
    shapes = Stribeck.shape_parameters
    fading = shapes["stribeck_velocity"]
    assert fading.low < 0.01 < 1.0 < fading.high < 3.0
    assert (
        shapes["stribeck_exponent"].low < 0.5 < 2.0 < shapes["stribeck_exponent"].high
    )
    assert Stribeck(0.2).stribeck_exponent == 2.0
    assert Stribeck(0.2).fading_velocity == 0.2
    assert Coulomb().fading_velocity is None


def test_a_coupling_has_the_terms_that_are_chosen_and_a_slope_for_its_jump():
    plain = GearCoupling("a", "b", viscous=True, coulomb="sign")
    assert plain.names == ("coupling_viscous", "coupling_coulomb")
    assert plain.shapes == {}
    assert plain.label == "a+b"
    smooth = plain.smoothed(0.05)
    assert smooth.shapes == {"velocity_scale": 0.05}
    assert smooth.smoothed(0.2) is smooth
    inertia = GearCoupling("a", "b", rotor_inertia=True)
    assert inertia.names == ("coupling_rotor_inertia",)
    assert inertia.smoothed(0.05) is inertia
    with pytest.raises(ProblemError, match="has no term"):
        GearCoupling("a", "b")


def test_terms_that_are_not_chosen_are_not_there():
    assert DriveTerms().names == ()
