"""Consistent intervals: ellipsoids and edges in closed form, and points inside."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from experiments import experiment, pendulum
from scipy.special import fdtri, stdtrit

from consistent_id import (
    FixedMasses,
    PhysicalConsistency,
    ProblemError,
    SolverError,
    build_regression,
    constrained_least_squares,
    least_squares,
    simulate_torque,
)
from consistent_id.constraints import FixedCentresOfMass, ParameterBounds, PointToSet
from consistent_id.constraints.cones import programmes
from consistent_id.constraints.cones.programmes import Ball, ConeRows
from consistent_id.constraints.priors import Distance
from consistent_id.estimation.best_fit import best_fit
from consistent_id.estimation.uncertainties import intervals
from consistent_id.estimation.uncertainties.beyond_noise import (
    FloatingBlocks,
    ScatterCauses,
)
from consistent_id.estimation.uncertainties.intervals import consistent_intervals
from consistent_id.regression import base_parameters, joint_noise
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.robot.scaling import link_scales

SIGMA = 0.2
SEEN = ["link1.hx", "link1.hy", "link1.Izz", "joint1.viscous"]


def noisy_pendulum():
    model, truth, log = pendulum()
    rng = np.random.default_rng(1)
    log = simulate_torque(model, truth, log, noise=SIGMA, rng=rng)
    return model, truth, build_regression(model, log).weighted([SIGMA])


def freedom_of(regression):
    """Freedom of noise, and of ten blocks for the variance that they add."""
    own, more = float(regression.noise.freedom[0]), regression.noise.beyond - 1.0
    return (1.0 + more) ** 2 / (1.0 / own + more**2 / 9.0)


def interval(found, name):
    return found.bounds[found.layout.index(name)]


def ellipsoid(model, regression, slack, names=SEEN, known=()):
    """Ends of ``||R x - z|| <= (1 + slack) least`` for the named parameters alone."""
    R = regression.stacked()
    kept = [model.layout.index(name) for name in names]
    z = R[:, -1] - sum(R[:, model.layout.index(name)] * x for name, x in known)
    x = np.linalg.lstsq(R[:, kept], z, rcond=None)[0]
    least = np.sum((R[:, kept] @ x - z) ** 2)
    allowed = ((1 + slack) ** 2 - 1) * least
    C = np.linalg.inv(R[:, kept].T @ R[:, kept])
    half = np.sqrt(allowed * np.diag(C))
    return np.column_stack([x - half, x + half])


@pytest.mark.parametrize("slack", [0.01, 0.2])
def test_without_constraints_it_is_the_ellipsoid_of_least_squares(slack):
    model, _, regression = noisy_pendulum()
    found = consistent_intervals(model, regression, constraints=(), slack=slack)
    expected = ellipsoid(model, regression, slack)
    for name, ends in zip(SEEN, expected, strict=True):
        assert interval(found, name) == pytest.approx(ends, abs=1e-5)


@pytest.mark.parametrize("tolerance", [1e-8, 1e-4])
def test_intervals_contain_the_exact_ones_however_early_the_solver_stops(
    tolerance, monkeypatch
):
    # The nominal robot is far from zero, and the ball of the proofs reaches farther.
    monkeypatch.setattr(intervals, "_TOLERANCE", tolerance)
    monkeypatch.setattr(intervals, "_FINER", tolerance)
    model, _, log = experiment(1, joints=3, samples=300, noise=0.1)
    regression = build_regression(model, log)
    distance = np.linalg.norm(model.robot.nominal / link_scales(model.robot).units)
    assert distance > 2.0
    found = consistent_intervals(model, regression, constraints=(), slack=0.1)
    base, R = base_parameters(model), regression.stacked()
    A = R[:, list(base.independent)]
    x = np.linalg.lstsq(A, R[:, -1], rcond=None)[0]
    allowed = (1.1**2 - 1.0) * np.sum((A @ x - R[:, -1]) ** 2)
    half = np.sqrt(allowed * np.diag(np.linalg.inv(A.T @ A)))
    for name in model.layout.names[-3:]:
        k = base.names.index(name)
        ends = x[k] - half[k], x[k] + half[k]
        low, high = interval(found, name)
        assert low <= ends[0] and ends[1] <= high


@pytest.mark.parametrize("sigma", [SIGMA, 1.0])
def test_without_constraints_profile_likelihood_is_students_interval(sigma):
    # Whatever the weight: the interval of least squares, t standard errors wide.
    model, _, regression = noisy_pendulum()
    regression = regression.weighted([sigma])
    found = consistent_intervals(model, regression, constraints=())
    estimate = least_squares(model, regression)
    t = stdtrit(freedom_of(regression), 0.975)
    for name, x, error in zip(
        estimate.base.names, estimate.base_values, estimate.standard_errors, strict=True
    ):
        ends = x - t * error, x + t * error
        assert interval(found, name) == pytest.approx(ends, abs=1e-5)


@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_scatter_between_blocks_and_shifts_widen_the_interval(count, joint):
    """Variances add; the degrees of freedom are the blocks', as of standard errors."""
    model, _, regression = noisy_pendulum()
    base = base_parameters(model)
    noise = unconstrained_fit(regression, base).noise
    unit, between, moves = np.zeros((3, len(model.layout)))
    kept = [model.layout.index(name) for name in base.names]
    R = regression.stacked()[:, kept]
    unit[kept] = np.sqrt(np.diag(np.linalg.inv(R.T @ R)))
    between[kept] = np.sqrt(count) * unit[kept] * [0.0, 0.5, 1.0, 2.0]
    moves[kept] = 0.7 * unit[kept]
    blocks = FloatingBlocks(SimpleNamespace(blocks=count), between, unit)
    shifts = SimpleNamespace(squared_misfit=np.full(len(unit), 0.7**2))
    found = consistent_intervals(
        model,
        regression,
        constraints=(),
        joint=joint,
        causes=ScatterCauses(noise, blocks, shifts),
    )
    errors = least_squares(model, regression, base=base).standard_errors
    own, added = errors**2, between[kept] ** 2 / count
    freedom = np.full(4, noise.freedoms(base.lift(np.eye(4)))[kept])
    if count > 1:
        freedom, own = np.full(4, count - 1.0), own + added
    t = stdtrit(freedom, 0.975) ** 2
    ratio = 4 * fdtri(4, freedom, 0.95) if joint else t
    half = np.sqrt(ratio * (own + moves[kept] ** 2))
    np.testing.assert_allclose(found.width[kept] / 2.0, half, rtol=1e-4)
    assert (found.level, found.joint) == (0.95, joint)


@pytest.mark.slow
def test_bodies_of_all_links_have_mass_and_moments_and_any_centre():
    """What least squares and the truth have is within, nothing below zero."""
    model, truth, log = experiment(2, joints=2, samples=60, noise=0.5)
    regression = build_regression(model, log)
    bodies = [PhysicalConsistency(margin=0.0)]
    found = consistent_intervals(model, regression, constraints=bodies, slack=30.0)
    low, high = found.bounds.T
    size = np.maximum(abs(truth), 1.0)
    assert (low <= truth + 1e-6 * size).all() and (truth <= high + 1e-6 * size).all()
    least = low[:20].reshape(2, 10)
    assert (least[:, [0, 4, 6, 9]] >= 0.0).all()
    assert (least[:, [0, 4, 6, 9]] == 0.0).any(axis=1).all()
    assert (least[:, [1, 2, 3]] < 0.0).all()


def test_intervals_of_all_parameters_together_are_those_of_f():
    # Scheffe's: wider than each by itself by sqrt(p F) over t.
    model, _, regression = noisy_pendulum()
    each = consistent_intervals(model, regression, constraints=())
    every = consistent_intervals(model, regression, constraints=(), joint=True)
    freedom = freedom_of(regression)
    ratio = np.sqrt(4 * fdtri(4, freedom, 0.95)) / stdtrit(freedom, 0.975)
    for name in SEEN:
        k = model.layout.index(name)
        assert every.width[k] / each.width[k] == pytest.approx(ratio, rel=1e-4)


def test_what_the_data_do_not_touch_is_without_bounds_or_has_those_given():
    model, _, regression = noisy_pendulum()
    free = consistent_intervals(model, regression, constraints=())
    unseen = [n for n in model.layout.names if n not in SEEN]
    for name in unseen:
        assert interval(free, name).tolist() == [-np.inf, np.inf]
    bounds = ParameterBounds({"link1.Ixx": (0.1, 0.3), "link1.hz": (-np.inf, 0.5)})
    held = consistent_intervals(model, regression, constraints=[bounds])
    assert interval(held, "link1.Ixx").tolist() == pytest.approx([0.1, 0.3])
    assert interval(held, "link1.hz").tolist() == pytest.approx([-np.inf, 0.5])


@pytest.mark.parametrize("tilt", [4e-8, 6e-8, 1e-5, 1e-3])
@pytest.mark.parametrize("size", [1e-6, 0.1, 10.0])
def test_what_ends_only_with_the_ball_has_no_bound(tilt, size):
    """Data say ``u + tilt v`` to `size`; ``v`` ends with the ball, at a thousand."""
    origin = np.array([2.0, 3.0])
    misfit = np.array([[0.0, 0.0], [-1.0, -tilt]])
    programme = intervals._IntervalProgramme(
        SimpleNamespace(
            scaled=SimpleNamespace(residual=3.0), solution=SimpleNamespace(u=origin)
        ),
        np.ones(2, dtype=bool),
        (),
        Ball(np.zeros(2), 1000.0),
        ConeRows("second order", misfit, np.zeros(2)),
    )
    found = programme.ends(0, 9.0 + size**2)
    change = size + 1000.0 * tilt
    # A twentieth of the change by the ball is none; less than a thousandth is none.
    if 1000.0 * tilt > 0.05 * max(change, 1e-3):
        assert found == (-np.inf, np.inf)
    else:
        assert found == pytest.approx((2.0 - change, 2.0 + change), rel=1e-4)


def test_where_the_solver_fails_nothing_bounds_a_parameter(monkeypatch):
    def fails(solution):
        raise SolverError("no point")

    model, _, regression = noisy_pendulum()
    best = best_fit(model, regression, (), base=base_parameters(model))
    monkeypatch.setattr(intervals, "best_fit", lambda *_, **__: best)
    monkeypatch.setattr(programmes, "point_of", fails)
    found = consistent_intervals(model, regression, constraints=())
    assert np.array_equal(found.bounds, [[-np.inf, np.inf]] * len(model.layout))


def test_where_the_solver_fails_for_one_end_a_coarser_tolerance_bounds_it(monkeypatch):
    model, _, regression = noisy_pendulum()
    before = consistent_intervals(model, regression, constraints=())
    solve, tried = intervals.solve_costs, []

    def sometimes(costs, rows, *, tolerance):
        tried.append((len(costs), tolerance))
        found = solve(costs, rows, tolerance=tolerance)
        return [found[0], None] if len(costs) == 2 else found

    monkeypatch.setattr(intervals, "_WORKERS", 1)
    monkeypatch.setattr(intervals, "solve_costs", sometimes)
    found = consistent_intervals(model, regression, constraints=())
    assert tried == [(2, 1e-8), (1, 1e-6)] * len(model.layout)
    assert np.array_equal(found.bounds[:, 0], before.bounds[:, 0])
    np.testing.assert_allclose(found.bounds[:, 1], before.bounds[:, 1], rtol=1e-4)


def test_an_end_that_is_proven_loosely_is_proven_by_a_finer_programme(monkeypatch):
    model, _, regression = noisy_pendulum()
    before = consistent_intervals(model, regression, constraints=())
    solve, tried = intervals.solve_costs, []

    def loosely(costs, rows, *, tolerance):
        tried.append(tolerance)
        found = solve(costs, rows, tolerance=tolerance)
        if tolerance == 1e-10:
            return found
        return [replace(p, duals=tuple(1.1 * z for z in p.duals)) for p in found]

    monkeypatch.setattr(intervals, "_WORKERS", 1)
    monkeypatch.setattr(intervals, "solve_costs", loosely)
    found = consistent_intervals(model, regression, constraints=())
    bounded = int(np.isfinite(before.bounds).sum())
    assert bounded > 0 and tried.count(1e-10) == bounded
    np.testing.assert_allclose(found.bounds, before.bounds, rtol=1e-4)


def test_what_is_fixed_has_no_width():
    model, _, regression = noisy_pendulum()
    known = [PhysicalConsistency(), FixedMasses(), FixedCentresOfMass()]
    found = consistent_intervals(model, regression, constraints=known)
    assert interval(found, "link1.m").tolist() == [2.0, 2.0]
    # Known through two equalities, so by a programme and not by a bound of its own.
    assert interval(found, "link1.hx") == pytest.approx([0.6, 0.6], abs=1e-6)
    assert interval(found, "link1.hy") == pytest.approx([0.0, 0.0], abs=1e-6)


def test_an_edge_of_the_possible_cuts_the_ellipsoid():
    # With m and c known, Izz >= m c^2 = 0.18 for any body: the point mass.
    model, _, regression = noisy_pendulum()
    known = [PhysicalConsistency(margin=0.0), FixedMasses(), FixedCentresOfMass()]
    found = consistent_intervals(model, regression, constraints=known, slack=0.05)
    held = [("link1.hx", 0.6), ("link1.hy", 0.0)]
    names = ["link1.Izz", "joint1.viscous"]
    # The best fit is inside, so the slack is counted from the same misfit.
    (low, high), friction = ellipsoid(model, regression, 0.05, names, held)
    assert low < 0.18
    assert interval(found, "link1.Izz") == pytest.approx([0.18, high], abs=1e-5)
    assert interval(found, "joint1.viscous") == pytest.approx(friction, abs=1e-5)
    # Ixx + Iyy >= Izz >= 0 and Iyy >= m c^2, without an upper bound along the axis.
    assert interval(found, "link1.Iyy") == pytest.approx([0.18, np.inf], abs=1e-5)
    assert interval(found, "link1.Ixx") == pytest.approx([0.0, np.inf], abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_estimate_that_fits_within_the_slack_is_inside(seed):
    model, truth, exact = experiment(seed, joints=3, samples=200)
    rng = np.random.default_rng(seed)
    sigma = 0.1 * exact.torque.std(axis=0)
    log = simulate_torque(model, truth, exact, noise=sigma, rng=rng)
    regression = build_regression(model, log)
    regression = regression.weighted(joint_noise(model, regression))
    found = consistent_intervals(model, regression, slack=0.02)
    inside = [
        constrained_least_squares(
            model, regression, prior=PointToSet(slack=slack, distance=distance)
        ).parameters
        for distance in get_args(Distance)
        for slack in (1e-4, 0.02)
    ]
    # The set is convex: so is everything between them.
    between = rng.dirichlet(np.ones(len(inside)), size=50) @ np.array(inside)
    size = np.maximum(abs(np.array(inside)).max(axis=0), 1.0)
    for x in [*inside, *between]:
        assert (x >= found.bounds[:, 0] - 1e-6 * size).all()
        assert (x <= found.bounds[:, 1] + 1e-6 * size).all()


@pytest.mark.slow
def test_more_slack_is_a_wider_interval():
    model, _, log = experiment(5, joints=2, noise=2.0, samples=200)
    regression = build_regression(model, log)
    ends = []
    for slack in (1e-3, 1e-2, 0.1):
        low, high = consistent_intervals(model, regression, slack=slack).bounds.T
        ends.append(np.concatenate([-low, high]))
    for tight, wide in pairwise(ends):
        finite = np.isfinite(tight) & np.isfinite(wide)
        assert finite.sum() > 10
        # Bounds are proven, and by so much too wide at the most.
        assert (tight[finite] <= wide[finite] + 1e-3).all()


def test_a_slack_that_is_none_is_refused():
    model, _, regression = noisy_pendulum()
    for slack in (0.0, -0.1, np.nan, np.inf):
        with pytest.raises(ProblemError, match="slack"):
            consistent_intervals(model, regression, slack=slack)
    for level in (0.0, 1.0, np.nan):
        with pytest.raises(ProblemError, match="expected between 0 and 1"):
            consistent_intervals(model, regression, level=level)


def test_the_number_of_workers_does_not_matter(monkeypatch):
    model, _, regression = noisy_pendulum()
    first = consistent_intervals(model, regression).bounds
    monkeypatch.setattr("consistent_id.estimation.uncertainties.intervals._WORKERS", 1)
    assert np.array_equal(consistent_intervals(model, regression).bounds, first)
