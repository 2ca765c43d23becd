"""What proofs must not claim: points that look optimal, sets that look empty."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment, pendulum

from consistent_id import (
    DriveTerms,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    SolverError,
    TorqueModel,
    build_regression,
    constrained_least_squares,
)
from consistent_id.constraints import PointToSet, SharedMotors, lowered
from consistent_id.constraints.cones.certificate import (
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.interior import (
    find_interior,
    irreducible_conflict,
)
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.priors import nominal_distance
from consistent_id.estimation.best_fit import best_fit
from consistent_id.estimation.nearest import nearest_within
from consistent_id.estimation.penalised import penalised_fit
from consistent_id.regression import GearCoupling, base_parameters


def _nothing(rows=0, equal=0):
    return Multipliers(np.zeros(equal), np.zeros(rows), ())


def test_a_point_off_an_equality_is_not_proven_where_that_changes_the_objective():
    G = np.array([[1.0, -1e6], [0.0, 1e3]])
    domain = ConicSet.equal(np.array([[0.0, 1.0]]), np.zeros(1), ["u2 = 0"])
    u = np.array([0.0, 0.9e-7])
    problem = LeastNorm(G, G @ u - [1e-3, 1.0], domain)
    point = ConeSolution(u, _nothing(equal=1), "made up", 0.0, 0.0)
    optimality = certify(problem, point, ball_about(np.zeros(2)), reference=0.5)
    better = np.array([-0.091, 0.0])
    excess = np.sum((G @ u - problem.g) ** 2) - np.sum((G @ better - problem.g) ** 2)
    assert optimality.gap * max(optimality.objective, 0.5) >= excess / 2
    assert optimality.verdict == "uncertified"


def test_what_is_no_number_is_not_certified():
    domain = ConicSet.at_most(np.eye(1), np.ones(1), ["u <= 1"])
    problem = LeastNorm(np.eye(1), np.ones(1), domain)
    point = ConeSolution(np.array([np.nan]), _nothing(rows=1), "made up", 0.0, 0.0)
    assert certify(problem, point, ball_about(np.zeros(1))).verdict == "uncertified"
    assert domain.violation(np.array([np.nan])) == np.inf


def test_a_proof_reaches_beyond_the_point():
    # Nearly flat: the best of (1 - 1e-6 u) is at a million, not within the ball.
    problem = LeastNorm(np.array([[1e-6]]), np.array([1.0]), ConicSet.everything(1))
    near = ConeSolution(np.array([10.0]), _nothing(), "made up", 0.0, 0.0)
    optimality = certify(problem, near, ball_about(np.zeros(1)), reference=0.5)
    assert optimality.radius >= 100.0
    solution, best = solve_certified(problem, np.zeros(1), reference=0.5)
    if best.verdict == "certified":
        assert solution.u == pytest.approx([1e6], rel=1e-2)


@pytest.mark.parametrize("slope", [2e-7, 1e-8])
def test_a_set_whose_points_are_not_near_zero_is_not_called_empty(slope):
    # x >= 0 and x + slope y <= -20 slope: (0, -21) is one.
    A = np.array([[-1.0, 0.0], [1.0, slope]])
    domain = ConicSet.at_most(A, np.array([0.0, -20 * slope]), ["x >= 0", "sum"])
    assert domain.violation(np.array([0.0, -21.0])) == 0.0
    assert not find_interior(domain).proves_empty
    assert irreducible_conflict(domain) == ()


def test_equalities_that_meet_far_away_are_no_contradiction():
    A = np.array([[1.0, 0.3], [1.0, 0.3 + 1e-10]])
    point = np.array([-3.0, 10.0])
    domain = ConicSet.equal(A, A @ point, ["a", "b"])
    assert not find_interior(domain).proves_empty


@pytest.mark.parametrize("seed", range(4))
def test_no_robot_within_the_slack_is_nearer(seed):
    model, _, log = experiment(seed, joints=3, noise=2.0, samples=300)
    base = base_parameters(model)
    constraints = [PhysicalConsistency(), FixedMasses(), NonNegativeDrive()]
    regression = build_regression(model, log)
    best = best_fit(model, regression, constraints, base=base)
    distance = nominal_distance(model, "pullback", best.scaled.unit)
    slack = 0.02
    near = nearest_within(best, distance, slack)
    least = best.scaled.excess(best.solution.u)
    allowed = ((1 + slack) ** 2 - 1) * max(least + best.scaled.residual**2, 1.0)
    assert near.allowed == pytest.approx(allowed, rel=1e-12)
    assert near.fit.excess - least <= allowed
    assert near.distance_gap <= 0.01
    # Any weight whose point is within the slack is no nearer than what is proven.
    for weight in near.fit.weight * np.array([0.5, 0.9, 1.001, 1.01, 1.1, 2.0]):
        other = penalised_fit(best.scaled, distance, weight)
        if other.excess - least <= allowed:
            mine = near.fit.squared_distance
            assert other.squared_distance >= mine - near.distance_gap * max(mine, 0.01)


@pytest.mark.slow
def test_the_entropic_distance_refuses_a_link_without_mass():
    model, _, log = pendulum()
    massless = [PhysicalConsistency(margin=0.0), FixedMasses({"link1": 0.0})]
    with pytest.raises(SolverError, match="entropic distance needs links with mass"):
        constrained_least_squares(
            model,
            build_regression(model, log),
            constraints=massless,
            prior=PointToSet(distance="entropic"),
        )


def test_couplings_of_one_joint_add_up_to_no_more_than_its_own():
    model, _, _ = experiment(0, joints=3)
    names = model.robot.joint_names
    coupled = TorqueModel(
        model.robot,
        (DriveTerms(viscous=True),) * 3,
        couplings=(
            GearCoupling(names[0], names[1], viscous=True),
            GearCoupling(names[1], names[2], viscous=True),
        ),
    )
    domain = lowered([SharedMotors()], coupled)
    x = np.ones(len(coupled.layout))
    assert domain.violation(x) == pytest.approx(1.0)
    x[[coupled.layout.index(f"{name}.viscous") for name in names]] = [1.0, 2.0, 1.0]
    assert domain.violation(x) == 0.0


def test_a_mass_matrix_that_is_not_positive_is_not_certified():
    model, _, log = experiment(1, joints=2, noise=30.0, samples=60)
    free = [PhysicalConsistency(), FixedMasses()]
    estimate = constrained_least_squares(
        model, build_regression(model, log), constraints=free
    )
    least = estimate.certificate.figures["least eigenvalue of M(q) over 10000 poses"]
    assert (estimate.certificate.verdict == "certified") == (least > 0.0)


@pytest.mark.parametrize(("size", "named"), [(1.0, False), (1e-8, True), (1e4, True)])
def test_a_torque_of_another_size_is_named_where_no_optimum_is_found(
    monkeypatch, size, named
):
    model, _, recording = pendulum()
    recording = replace(recording, torque=size * recording.torque)

    def failing(problem, inside):
        raise SolverError("no usable optimum")

    place = "consistent_id.estimation.constrained_fit.best_inside"
    monkeypatch.setattr(place, failing)
    regression = build_regression(model, recording)
    with pytest.raises(SolverError, match="no usable optimum") as raised:
        constrained_least_squares(model, regression)
    assert ("check the torque's unit" in str(raised.value)) == named
