"""What soles bear: a linear programme over their corners says whether they can."""

import numpy as np
import pytest
from scipy.optimize import linprog

from consistent_id.standing.forces_and_limits import sole_shares

HALF, FRICTION = np.array([0.1, 0.04]), 0.5


def can_bear(wrench):
    """Whether four corners, each with a pyramid of friction, make a wrench."""
    corners = [(x, y, 0.0) for x in (-0.1, 0.1) for y in (-0.04, 0.04)]
    balance = np.hstack([np.vstack([np.eye(3), _cross(np.array(r))]) for r in corners])
    mu = FRICTION
    one = [[1, 0, -mu], [-1, 0, -mu], [0, 1, -mu], [0, -1, -mu]]
    cone = np.kron(np.eye(4), one)
    bounds = [(None, None), (None, None), (0, None)] * 4
    found = linprog(
        np.zeros(12), cone, np.zeros(16), balance, wrench, bounds, method="highs"
    )
    return found.status == 0


def _cross(r):
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


@pytest.mark.slow
def test_a_sole_bears_what_its_corners_can():
    rng = np.random.default_rng(0)
    scale = [0.4, 0.4, 0.0, 0.03, 0.07, 0.05]
    wrenches = rng.normal(size=(400, 6)) * scale + [0, 0, 1, 0, 0, 0]
    shares = sole_shares(wrenches, HALF, FRICTION)
    largest = np.max(list(shares.values()), axis=0)
    clear = abs(largest - 1.0) > 1e-6  # the programme itself is exact to 1e-7
    said = largest <= 1.0
    bears = np.array([can_bear(w) for w in wrenches])
    assert np.array_equal(said[clear], bears[clear])
    assert 0.1 < said.mean() < 0.9  # both happen
    decide = [np.argmax(list(shares.values()), axis=0) == k for k in range(3)]
    assert all(one.any() for one in decide)


def test_a_sole_pressed_at_its_edge_uses_all_of_it():
    at_edge = [0.0, 0.0, 10.0, 0.4, 0.0, 0.0]  # 0.04 m to the side
    shares = sole_shares(np.array([at_edge]), HALF, FRICTION)
    assert shares["centre of pressure"] == pytest.approx([1.0])


def test_a_sole_that_is_pulled_bears_nothing():
    shares = sole_shares(np.array([[0.1, 0.0, -5.0, 0, 0, 0]]), HALF, FRICTION)
    assert shares["friction cone"][0] > 1e3
