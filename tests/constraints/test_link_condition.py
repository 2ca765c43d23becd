"""Edges of what a body can be, in words, from bodies made of point masses."""

import numpy as np
import pytest
from experiments import pendulum

from consistent_id import InertialParameters
from consistent_id.constraints.delivered_bodies import _edge, link_conditions


def body(*places, mass=2.0):
    """A body of equal point masses, and a friction coefficient."""
    J = sum(np.outer([*r, 1.0], [*r, 1.0]) for r in np.array(places, dtype=float))
    J = mass / len(places) * J
    return np.append(InertialParameters.from_pseudo_inertia(J).vector, 0.4)


def condition(x):
    (link,) = link_conditions(pendulum()[0], x)
    return link


CORNERS = ([0, 0, 0], [1, 0, 0], [0, 1, 0])


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ([*CORNERS, [0, 0, 1]], ""),
        (CORNERS, "flat: no extent along [0.00 0.00 1.00] (triangle inequality"),
        ([[0, 1, 5], [0, -1, 5]], "a rod along [0.00 1.00 0.00] (two triangle"),
        ([[0.1, 0.2, 0.3]], "a point mass"),
    ],
)
def test_each_edge_has_its_word(places, words):
    link = condition(body(*places))
    assert link.link == "link1"
    assert link.consistent
    assert link.edge.startswith(words)
    assert bool(link.edge) == bool(words)


def test_a_link_without_mass_is_called_so():
    link = condition(body(*CORNERS, [0, 0, 1], mass=1e-6))
    assert link.edge == "no mass"
    assert condition(np.zeros(11)).edge == "no mass"


def test_what_is_no_body_touches_no_edge():
    x = body(*CORNERS, [0, 0, 1])
    x[4] += 10.0  # Ixx far beyond the sum of the others
    link = condition(x)
    assert not link.consistent
    assert link.edge == ""


def test_the_words_follow_the_body_when_it_turns():
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    rod = InertialParameters(body([1, 0, 0], [-1, 0, 0])[:10])
    turned = rod.transformed(turn, np.array([0.1, 0.2, 0.3]))
    edge = condition(np.append(turned.vector, 0.0)).edge
    assert edge.startswith("a rod along [0.60 0.80 0.00]")


def test_the_least_eigenvalue_is_per_typical_mass_and_length():
    # Typical are the datasheet's 2 kg and, for a robot without lengths, 0.1 m.  Second
    # moments of the ball are half its inertia.
    ball = InertialParameters.from_central(2.0, [0, 0, 0], 0.004 * np.eye(3))
    link = condition(np.append(ball.vector, 0.0))
    assert link.least_eigenvalue == pytest.approx(0.002 / (2.0 * 0.1**2))


@pytest.mark.parametrize("typical", [0.02, 50.0])
@pytest.mark.parametrize(("share", "edge"), [(9e-6, "no mass"), (1.1e-5, "")])
def test_a_link_has_no_mass_below_a_hundred_thousandth_of_the_typical(
    typical, share, edge
):
    solid = InertialParameters(body(*CORNERS, [0, 0, 1], mass=share * typical)[:10])
    assert _edge(solid, typical, 1e-3 * share * typical) == edge
