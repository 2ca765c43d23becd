"""Interior points, proofs that there are none, and blame: closed forms, thresholds."""

import numpy as np
import pytest

from consistent_id.constraints.cones import interior
from consistent_id.constraints.cones.interior import (
    Interior,
    _blame,
    _bound,
    _contradiction,
    find_interior,
    irreducible_conflict,
)
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.errors import SolverError


def rows(kind, A, b):
    A, b = np.array(A, float), np.array(b, float)
    name = "value" if kind == ConicSet.equal else "row"
    return kind(A, b, [f"{name} {i}" for i in range(len(b))])


def blocks(*names):
    """Blocks of one entry each, on one variable."""
    one = np.ones((1, 1, 1))
    made = [SemidefiniteBlock(n, one, np.zeros((1, 1)), np.ones(1)) for n in names]
    return ConicSet.semidefinite(made, 1)


def names(domain):
    return [block.description for block in domain.blocks]


@pytest.mark.parametrize(("share", "named"), [(0.011, True), (0.009, False)])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_a_hundredth_of_the_largest_share_is_named_whatever_its_size(
    share, named, size
):
    domain = blocks("light", "heavy") & rows(
        ConicSet.at_most, [[1], [1], [1]], [0, 0, 0]
    )
    Z = (np.array([[share * size]]), np.array([[0.5 * size]]))
    # The largest is a row: shares of blocks and rows are compared with one another.
    y = size * np.array([share, 1.0, 0.7])
    light, heavy = names(domain)
    expected = ["row 1", "row 2", heavy]
    blame = _blame(domain, Z, y, np.zeros(0))
    assert list(blame[:3]) == expected
    assert set(blame[3:]) == ({"row 0", light} if named else set())


@pytest.mark.parametrize(("share", "named"), [(0.011, True), (0.009, False)])
def test_values_are_blamed_after_rows_heaviest_first_of_either_sign(share, named):
    domain = rows(ConicSet.at_most, [[1]], [0]) & rows(
        ConicSet.equal, [[1], [1], [1]], [0, 0, 0]
    )
    taken = 0.1 * np.array([share, 0.3, -1.0])
    blame = _blame(domain, (), np.ones(1), taken)
    assert blame == ("row 0", "value 2", "value 1", *(["value 0"] if named else []))
    # Taken alike from all, three are enough to say.
    many = rows(ConicSet.equal, np.ones((5, 1)), np.zeros(5))
    assert _blame(many, (), np.zeros(0), np.arange(1.0, 6.0)) == (
        "value 4",
        "value 3",
        "value 2",
    )


@pytest.mark.parametrize(("share", "named"), [(0.011, True), (0.009, False)])
def test_of_values_that_exclude_each_other_those_with_a_hundredth_are_named(
    share, named
):
    # x is 0 and 20, and y is -y and y: each misses its mean by 10 and by y.
    y = 10.0 * share
    A = [[0, 1], [1, 0], [1, 0], [0, 1]]
    found = find_interior(rows(ConicSet.equal, A, [-y, 0, 20, y]))
    assert set(found.to_blame[:2]) == {"value 1", "value 2"}  # the heaviest first
    assert set(found.to_blame[2:]) == ({"value 0", "value 3"} if named else set())
    assert found.margin == pytest.approx(-np.sqrt(200.0 + 2.0 * y**2))
    assert found.bound == pytest.approx(found.margin)
    assert found.proves_empty


@pytest.mark.parametrize(
    ("value", "apart", "empty"),
    [
        (0.0, 2.1e-9, True),
        (0.0, 1e-9, False),
        (1e3, 1e-2, True),
        (1e3, 1e-6, False),
    ],
)
def test_values_contradict_each_other_beyond_rounding(value, apart, empty):
    # They miss their mean by apart / sqrt(2); a contradiction begins at 1e-9, times
    # one plus the size of both values, which is sqrt(2) value.
    found = find_interior(rows(ConicSet.equal, [[1], [1]], [value, value + apart]))
    assert found.proves_empty == empty


@pytest.mark.parametrize(("bound", "empty"), [(-1.01e-9, True), (-0.99e-9, False)])
def test_a_bound_proves_emptiness_beyond_rounding(bound, empty):
    assert Interior(bound, bound, np.zeros(1), (), ()).proves_empty == empty


def test_a_proof_reaches_a_thousand_or_ten_times_as_far_as_the_best_point():
    for far, reach in ((0.0, 1e3), (99.0, 1e3), (101.0, 1010.0)):
        assert Interior(0.0, 0.0, np.array([far]), (), ()).reach == pytest.approx(reach)


def test_the_bound_is_a_mean_of_margins_and_the_slope_costs_in_the_ball():
    # x <= -1 and x >= 0: each may be missed by a half, wherever the point is.
    domain = rows(ConicSet.at_most, [[1], [-1]], [-1, 0])
    for x in (-0.5, 7.0):
        bound, _ = _bound(domain, np.array([x]), (), np.array([3.0, 3.0]))
        assert bound == pytest.approx(-0.5)
    # Of uneven multipliers a slope of 0.1 is left: 0.1 x + 100 in a ball of 1000.
    bound, _ = _bound(domain, np.array([2.0]), (), np.array([0.5, 0.4]))
    assert bound == pytest.approx((0.5 * -3.0 + 0.4 * 2.0 + 0.1 * 1e3) / 0.9)
    assert _bound(domain, np.zeros(1), (), np.zeros(2))[0] == 1.0


def test_equalities_take_up_slope_at_the_cost_of_what_they_miss():
    # x = 2 holds, x <= 1 is missed by 1; from the point 2.5 as from any other.
    domain = rows(ConicSet.at_most, [[1]], [1]) & rows(ConicSet.equal, [[2]], [4])
    for x in (2.0, 2.5):
        bound, taken = _bound(domain, np.array([x]), (), np.array([5.0]))
        assert bound == pytest.approx(-1.0)
        assert taken == pytest.approx([-0.5])  # -1 of slope, by a row of 2
    block = blocks("x") & rows(ConicSet.equal, [[2]], [-6])
    bound, taken = _bound(block, np.array([0.0]), (np.array([[4.0]]),), np.zeros(0))
    assert bound == pytest.approx(-3.0) and taken == pytest.approx([0.5])


def test_the_best_point_is_as_far_from_all_rows_as_can_be():
    # Between -1 and 5 the middle is 2, three from either.
    found = find_interior(rows(ConicSet.at_most, [[1], [-1]], [5, 1]))
    assert found.margin == pytest.approx(1.0, abs=1e-6)  # never more than one
    found = find_interior(rows(ConicSet.at_most, [[1], [-1]], [0.5, 0.1]))
    assert found.margin == pytest.approx(0.3, abs=1e-6)
    assert found.u == pytest.approx([0.2], abs=1e-5)
    assert found.bound >= found.margin - 1e-9 and not found.proves_empty


def tried(monkeypatch, *outcomes):
    """Return what `find_interior` makes of solutions or failures, and those left."""
    left = list(outcomes)

    def next_one(*_):
        if isinstance(left[0], str):
            raise SolverError(left.pop(0))
        return left.pop(0)

    monkeypatch.setattr(interior, "_best_point", next_one)
    try:
        return find_interior(ConicSet.everything(1)), left
    except SolverError as failure:
        return str(failure), left


def test_a_solution_that_decides_nothing_is_tried_once_more(monkeypatch):
    def solution(margin, bound):
        return Interior(margin, bound, np.zeros(1), (), ())

    inside, edge = solution(0.5, 0.6), solution(-0.9e-9, 0.1)
    empty, open_ = solution(-0.2, -0.1), solution(-1.1e-9, 0.1)
    for first in (inside, edge, empty):
        assert tried(monkeypatch, first, "unused") == (first, ["unused"])
    for second in (inside, empty, open_):
        assert tried(monkeypatch, open_, second) == (second, [])
        assert tried(monkeypatch, "out of order", second) == (second, [])
    assert tried(monkeypatch, open_, "out of order") == (open_, [])
    assert tried(monkeypatch, "first", "second") == ("second", [])


def test_where_the_solver_fails_no_conflict_is_proven(monkeypatch):
    empty = rows(ConicSet.at_most, [[1], [-1]], [-1, 0])
    assert irreducible_conflict(empty) == (0, 1)

    def fails(*_):
        raise SolverError("out of order")

    monkeypatch.setattr(interior, "_best_point", fails)
    assert irreducible_conflict(empty) == ()


@pytest.mark.parametrize(
    ("A", "b", "size"),
    [
        ([[3, 4]], [50], 10.0),  # the nearest point to zero is (6, 8)
        ([[1, 0], [0, 1]], [5, -12], 13.0),
        ([[3, 4]], [0.1], 1.0),  # never below one
        (np.zeros((0, 2)), [], 1.0),
    ],
)
def test_equalities_that_hold_have_the_size_of_their_smallest_point(A, b, size):
    found, scale = _contradiction(rows(ConicSet.equal, A, b))
    assert found is None and scale == pytest.approx(size)


def test_where_nothing_is_demanded_the_margin_is_one():
    assert find_interior(ConicSet.everything(2)).margin == 1.0


def test_a_residual_that_rounding_explains_proves_no_contradiction():
    # Its slope is 1e-16 of entries of 1e15, which outweighs the residual in the ball.
    A = 1e15 * np.array([[1.0 / 3.0], [0.7], [1.1]])
    found, scale = _contradiction(rows(ConicSet.equal, A, [0.0, 1.0, 0.3]))
    assert found is None and scale == 1.0
