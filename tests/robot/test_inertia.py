"""Inertial parameters: point masses, Pinocchio, round trips, impossible bodies."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import random_body

from consistent_id import InertialParameters, ModelError
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=50, deadline=None)
@given(seed=seeds, points=st.integers(1, 8))
def test_clouds_of_point_masses_are_consistent_and_add_up(seed, points):
    rng = np.random.default_rng(seed)
    m, r = rng.uniform(0.1, 3.0, points), rng.normal(size=(points, 3))
    inertia = sum(
        mk * (rk @ rk * np.eye(3) - np.outer(rk, rk))
        for mk, rk in zip(m, r, strict=True)
    )
    entries = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    body = InertialParameters(np.concatenate([[m.sum()], m @ r, entries]))
    rt = np.column_stack([r, np.ones(points)])
    # The pseudo-inertia is the second moment of (r, 1).
    assert np.allclose(body.pseudo_inertia, (m[:, None] * rt).T @ rt, atol=1e-12)
    assert np.allclose(body.inertia, inertia)
    # Fewer than four points make a flat body: eigenvalues of zero, up to rounding.
    assert body.is_consistent(tolerance=1e-12)


@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_every_view_leads_back_to_the_same_vector(seed):
    body = random_body(np.random.default_rng(seed))
    size = abs(body.vector).max()
    again = InertialParameters.from_pseudo_inertia(body.pseudo_inertia)
    assert np.allclose(again.vector, body.vector, rtol=0, atol=1e-14 * size)
    central = InertialParameters.from_central(body.mass, body.com, body.central_inertia)
    assert np.allclose(central.vector, body.vector, rtol=0, atol=1e-13 * size)
    J = np.tensordot(body.vector, PSEUDO_INERTIA_BASIS, axes=1)
    assert np.array_equal(J, pseudo_inertia(body.vector))


def test_views_and_changes_of_frame_are_those_of_pinocchio():
    rng = np.random.default_rng(3)
    pin.seed(3)
    for _ in range(20):
        body, move = random_body(rng), pin.SE3.Random()
        reference = pin.Inertia(body.mass, body.com, body.central_inertia)
        assert np.allclose(body.vector, reference.toDynamicParameters(), atol=1e-12)
        moved = body.transformed(move.rotation, move.translation)
        expected = reference.se3Action(move).toDynamicParameters()
        assert np.allclose(moved.vector, expected, atol=1e-11)


def test_composition_is_that_of_pinocchio():
    rng = np.random.default_rng(4)
    a, b = random_body(rng), random_body(rng)
    both = pin.Inertia(a.mass, a.com, a.central_inertia)
    both += pin.Inertia(b.mass, b.com, b.central_inertia)
    assert np.allclose((a + b).vector, both.toDynamicParameters(), atol=1e-11)


@pytest.mark.parametrize(
    ("mass", "moments", "consistent"),
    [
        (1.0, (1.0, 1.0, 1.0), True),
        (1.0, (1.0, 1.0, 2.0), True),  # flat, at the edge
        (1.0, (1.0, 1.0, 2.1), False),  # triangle inequality
        (1.0, (-0.1, 1.0, 1.0), False),
        (-1.0, (1.0, 1.0, 1.0), False),
    ],
)
def test_consistency_is_mass_and_the_triangle_inequality(mass, moments, consistent):
    body = InertialParameters(
        [mass, 0, 0, 0, moments[0], 0, moments[1], 0, 0, moments[2]]
    )
    assert body.is_consistent() == consistent


def test_a_centre_of_mass_too_far_out_is_inconsistent():
    # Inertia about the origin must hold at least the parallel-axis share.
    assert not InertialParameters([1, 2.0, 0, 0, 1, 0, 1, 0, 0, 1]).is_consistent()


def test_bad_numbers_and_massless_centres_are_refused():
    with pytest.raises(ModelError, match="shape"):
        InertialParameters(np.ones(9))
    with pytest.raises(ModelError, match=r"entry \(2,\) is nan"):
        InertialParameters([1, 0, np.nan, *[0] * 7])
    with pytest.raises(ModelError, match="centre of mass"):
        _ = InertialParameters(np.zeros(10)).com


def test_the_vector_is_a_copy_and_cannot_be_written():
    source = np.ones(10)
    body = InertialParameters(source)
    source[0] = 5.0
    assert body.mass == 1.0
    with pytest.raises(ValueError, match="read-only"):
        body.vector[0] = 2.0
