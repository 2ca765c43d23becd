"""Constrained estimates: closed forms, recovery, certificates, contradictions."""

import numpy as np
import pytest
from robots import random_body, random_robot, random_states

from consistent_id import (
    CentreOfMassBoxes,
    Datasheet,
    DHRow,
    DriveTerms,
    FixedCentresOfMass,
    FixedMasses,
    FixedParameters,
    InertialParameters,
    InfeasibleError,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    PointToSet,
    ProblemError,
    Recording,
    SolverError,
    TorqueModel,
    base_feasibility,
    base_parameters,
    build_regression,
    constrained_least_squares,
    from_modified_dh,
    joint_noise,
    least_squares,
    simulate_torque,
)
from consistent_id.certificate import certify, solve_certified
from consistent_id.cone_program import LeastNorm, solve_least_norm
from consistent_id.conic import ConicSet, SemidefiniteBlock
from consistent_id.constraint_costs import constraint_costs
from consistent_id.feasibility import find_interior

DRIVE = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True)


def _experiment(seed, joints=4, noise=0.0, samples=1500, drive=DRIVE):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints)
    model = TorqueModel(robot, drive)
    states = random_states(rng, joints, samples)
    motion = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    extra = rng.uniform(0.1, 1.0, len(model.layout) - 10 * joints)
    truth = np.concatenate([robot.nominal, extra])
    return model, truth, simulate_torque(model, truth, motion, noise=noise, rng=rng)


def _triangular(seed, size=3):
    """Nearest positive semidefinite matrix as a cone problem, with its known answer."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(size, size))
    A = A + A.T
    pairs = [(i, j) for i in range(size) for j in range(i, size)]
    basis = np.zeros((len(pairs), size, size))
    for n, (i, j) in enumerate(pairs):
        basis[n, i, j] = basis[n, j, i] = 1.0
    weight = np.array([1.0 if i == j else np.sqrt(2.0) for i, j in pairs])
    block = SemidefiniteBlock("X", basis, np.zeros((size, size)), np.ones(size))
    domain = ConicSet.semidefinite([block], len(pairs))
    target = np.array([A[i, j] for i, j in pairs])
    values, vectors = np.linalg.eigh(A)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    answer = np.array([nearest[i, j] for i, j in pairs])
    return LeastNorm(np.diag(weight), weight * target, domain), answer


@pytest.mark.parametrize("seed", range(10))
def test_the_nearest_semidefinite_matrix_is_the_one_with_its_negative_part_cut(seed):
    problem, answer = _triangular(seed)
    solution, optimality = solve_certified(problem, np.zeros(6), reference=0.5)
    assert optimality.verdict == "certified"
    # The objective is strongly convex, so its gap bounds the distance to the answer;
    # 1e-7 is what violation may add.
    excess = optimality.gap * max(optimality.objective, 0.5)
    distance = np.linalg.norm(problem.G @ (solution.u - answer))
    assert distance <= np.sqrt(2.0 * excess) + 1e-7


def test_a_point_that_is_not_optimal_is_not_certified():
    from dataclasses import replace

    problem, answer = _triangular(3)
    solution = solve_least_norm(problem)
    worse = replace(solution, u=1.01 * answer)
    gap = certify(problem, worse, np.zeros(6)).gap
    excess = 0.5 * np.linalg.norm(problem.G @ worse.u - problem.g) ** 2
    excess -= 0.5 * np.linalg.norm(problem.G @ answer - problem.g) ** 2
    assert gap * (0.5 * np.linalg.norm(problem.G @ worse.u - problem.g) ** 2) >= excess
    assert certify(problem, worse, np.zeros(6)).verdict == "uncertified"


def test_a_point_outside_is_not_certified():
    from dataclasses import replace

    problem, answer = _triangular(4)
    solution = solve_least_norm(problem)
    outside = replace(solution, u=answer - 1e-3)
    assert certify(problem, outside, np.zeros(6)).verdict == "uncertified"


@pytest.mark.parametrize("seed", range(4))
def test_without_noise_the_true_robot_is_recovered_where_the_data_speak(seed):
    model, truth, log = _experiment(seed)
    estimate = constrained_least_squares(model, build_regression(model, log))
    assert estimate.certificate.verdict == "certified"
    assert np.allclose(
        estimate.predict(log), log.torque, atol=1e-4 * abs(log.torque).max()
    )
    base = estimate.base
    expected = base.projection @ truth
    assert np.allclose(estimate.base_values, expected, atol=1e-3 * abs(expected).max())


@pytest.mark.parametrize("seed", range(6))
def test_every_link_is_a_body_and_every_mass_is_the_datasheets(seed):
    model, truth, log = _experiment(20 + seed, noise=5.0, samples=200)
    regression = build_regression(model, log)
    sigma = joint_noise(model, regression)
    estimate = constrained_least_squares(model, regression.weighted(sigma))
    assert estimate.certificate.verdict == "certified"
    for k, body in enumerate(estimate.links):
        assert InertialParameters(body).is_consistent()
        assert body[0] == pytest.approx(truth[10 * k], rel=1e-7)
    assert (estimate.parameters[40:] > -1e-7).all()


@pytest.mark.parametrize("seed", range(30))
def test_random_problems_of_all_kinds_are_certified(seed):
    rng = np.random.default_rng(1000 + seed)
    joints, samples = int(rng.integers(2, 10)), int(rng.choice([60, 300, 2000]))
    _, robot = random_robot(rng, joints, tree=bool(rng.integers(2)))
    drive = DriveTerms(
        viscous=bool(rng.integers(2)),
        coulomb="sign" if rng.integers(2) else "none",
        offset=bool(rng.integers(2)),
        rotor_inertia=bool(rng.integers(2)),
    )
    model = TorqueModel(robot, drive)
    amplitude, noise = 10.0 ** rng.uniform(-2.0, 0.0), 10.0 ** rng.uniform(-4.0, 0.3)
    states = [amplitude * x for x in random_states(rng, joints, samples)]
    log = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    extra = rng.uniform(0.1, 1.0, len(model.layout) - 10 * joints)
    exact = simulate_torque(model, [*robot.nominal, *extra], log)
    sigma = noise * exact.torque.std(axis=0) + 1e-9
    log = simulate_torque(model, [*robot.nominal, *extra], log, noise=sigma, rng=rng)
    regression = build_regression(model, log)
    weighted = regression.weighted(joint_noise(model, regression))
    estimate = constrained_least_squares(model, weighted)
    assert estimate.certificate.verdict == "certified", estimate.certificate.reason
    assert all(InertialParameters(body).is_consistent() for body in estimate.links)


def test_the_optimum_is_no_worse_than_the_truth_and_no_better_than_least_squares():
    model, truth, log = _experiment(30, noise=3.0, samples=300)
    regression = build_regression(model, log)
    tight = constrained_least_squares(model, regression, prior=PointToSet(slack=1e-5))
    free = least_squares(model, regression)

    def misfit(x):
        return np.linalg.norm(regression.residual_rms(x))

    assert misfit(free.parameters) <= misfit(tight.parameters) * (1 + 1e-9)
    assert misfit(tight.parameters) <= misfit(truth) * (1 + 2e-5)


def test_where_constraints_are_slack_it_is_least_squares():
    model, _, log = _experiment(31, joints=2, noise=0.01, drive=DriveTerms())
    regression = build_regression(model, log)
    free = least_squares(model, regression)
    bodily = constrained_least_squares(
        model,
        regression,
        constraints=[PhysicalConsistency()],
        prior=PointToSet(slack=1e-6),
    )
    difference = abs(bodily.base_values - free.base_values)
    # A slack of 1e-6 in the misfit is 1.4e-3 of its norm in the parameters' own scale.
    assert (difference <= 0.2 * np.sqrt(len(free.base)) * free.standard_errors).all()


@pytest.mark.parametrize("distance", ["pullback", "euclidean"])
def test_what_the_data_leave_open_is_nominal(distance):
    model, truth, log = _experiment(32, joints=3, drive=DriveTerms())
    prior = PointToSet(slack=1e-4, distance=distance)
    estimate = constrained_least_squares(
        model,
        build_regression(model, log),
        constraints=[PhysicalConsistency()],
        prior=prior,
    )
    # The truth is the nominal robot, so all of it is.
    size = np.maximum(abs(truth), 1.0)
    assert (abs(estimate.parameters - truth) <= 1e-3 * size).all()


def _pendulum(mass=2.0, com=(0.3, 0.0, 0.0)):
    robot = from_modified_dh("pendulum", [DHRow(-np.pi / 2, 0.0)])
    sheet = Datasheet(
        mass=mass, com=com, mass_bounds=(1.0, 3.0), com_box=[[0] * 3, [0.5] * 3]
    )
    model = TorqueModel(
        robot.with_datasheet({"link1": sheet}), DriveTerms(viscous=True)
    )
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-2, 2, (3, 500, 1))
    log = Recording(("joint1",), np.arange(500) / 100, q, dq, ddq)
    ball = InertialParameters.from_central(mass, com, 0.01 * np.eye(3))
    truth = np.append(ball.vector, 0.4)
    return model, truth, simulate_torque(model, truth, log)


def test_constraints_hold_to_the_letter():
    model, truth, log = _pendulum()
    regression = build_regression(model, log)
    estimate = constrained_least_squares(
        model,
        regression,
        constraints=[
            PhysicalConsistency(margin=1e-3),
            FixedMasses(),
            FixedCentresOfMass(),
            NonNegativeDrive(),
            FixedParameters({"joint1.viscous": 0.4}),
        ],
    )
    assert estimate["link1.m"] == pytest.approx(2.0, rel=1e-8)
    assert estimate["link1.hx"] == pytest.approx(0.6, rel=1e-8)
    assert estimate["joint1.viscous"] == pytest.approx(0.4, rel=1e-8)
    assert estimate["link1.Izz"] == pytest.approx(truth[9], rel=1e-4)


def test_bounds_and_boxes_hold():
    model, _, log = _pendulum()
    heavier = simulate_torque(model, 2.0 * _pendulum()[1], log)
    estimate = constrained_least_squares(
        model,
        build_regression(model, heavier),
        constraints=[PhysicalConsistency(), MassBounds(), CentreOfMassBoxes()],
    )
    mass, first = estimate["link1.m"], estimate.links[0][1:4]
    assert 1.0 - 1e-6 <= mass <= 3.0 + 1e-6
    assert (first >= -1e-6).all()
    assert (first <= 0.5 * mass + 1e-6).all()


def test_contradictory_constraints_are_refused_with_those_to_blame():
    model, _, log = _pendulum()
    impossible = [
        PhysicalConsistency(),
        FixedMasses(),
        FixedParameters({"link1.Izz": 0.01, "link1.hx": 0.6}),
    ]
    with pytest.raises(InfeasibleError, match="link 'link1' as a body"):
        constrained_least_squares(
            model, build_regression(model, log), constraints=impossible
        )


def test_equalities_that_contradict_each_other_are_named():
    model, _, log = _pendulum()
    twice = [FixedMasses(), FixedMasses({"link1": 3.0})]
    with pytest.raises(InfeasibleError, match=r"link1\.m = 3 kg"):
        constrained_least_squares(
            model, build_regression(model, log), constraints=twice
        )


def test_unknown_links_and_parameters_are_named_with_near_ones():
    model, _, log = _pendulum()
    regression = build_regression(model, log)
    with pytest.raises(ProblemError, match="no link named 'link2'; known: link1"):
        constrained_least_squares(
            model, regression, constraints=[FixedMasses({"link2": 1.0})]
        )
    with pytest.raises(ProblemError, match=r"no parameter named 'link1.mass'"):
        constrained_least_squares(
            model, regression, constraints=[FixedParameters({"link1.mass": 1.0})]
        )


@pytest.mark.parametrize("seed", range(5))
def test_base_parameters_of_a_body_are_consistent_with_a_witness(seed):
    model, truth, _ = _experiment(50 + seed, samples=2)
    base = base_parameters(model)
    answer = base_feasibility(model, base, base.projection @ truth)
    assert answer.answer == "consistent"
    witness = answer.parameters
    assert np.allclose(base.projection @ witness, base.projection @ truth, atol=1e-5)
    for body in witness[:40].reshape(-1, 10):
        assert InertialParameters(body).is_consistent(tolerance=1e-7)


def test_a_pendulum_of_negative_inertia_is_proven_impossible():
    model, truth, _ = _pendulum()
    base = base_parameters(model)
    values = base.projection @ truth
    values[base.names.index("link1.Izz")] = -0.1
    answer = base_feasibility(model, base, values)
    assert answer.answer == "impossible"
    assert answer.proof.bound < 0.0
    assert [v.link for v in answer.violations] == ["link1"]


def test_the_proof_of_impossibility_counts_the_same_for_every_candidate():
    model, truth, _ = _pendulum()
    base = base_parameters(model)
    values = base.projection @ truth
    values[base.names.index("link1.Izz")] = -0.1
    proof = base_feasibility(model, base, values).proof
    # <Z, J> over candidates: all have these base parameters; none can make it >= 0.
    P = base.projection
    null = np.linalg.svd(P)[2][len(P) :].T
    rng = np.random.default_rng(0)
    from consistent_id.inertia import pseudo_inertia
    from consistent_id.scaling import link_scales

    root = link_scales(model.robot).root[0]
    for _ in range(20):
        x = base.lift(values) + null @ rng.normal(size=null.shape[1])
        J = pseudo_inertia(x[:10]) / np.outer(root, root)
        assert np.sum(proof.multipliers[0] * J) < -1e-3


def test_an_empty_set_is_proven_empty_and_a_full_one_is_not():
    block = SemidefiniteBlock("x", np.ones((1, 1, 1)), np.array([[-1.0]]), np.ones(1))
    low = ConicSet.at_most(np.array([[1.0]]), np.array([0.5]), ["x <= 0.5"])
    empty = ConicSet.semidefinite([block], 1) & low
    assert find_interior(empty).proves_empty
    # x >= 1 + t and x <= 0.5 - t meet at t = -0.25.
    assert find_interior(empty).depth == pytest.approx(-0.25, abs=1e-5)
    high = ConicSet.at_most(np.array([[1.0]]), np.array([2.0]), ["x <= 2"])
    assert not find_interior(ConicSet.semidefinite([block], 1) & high).proves_empty


def test_consistency_survives_a_change_of_frame():
    rng = np.random.default_rng(60)
    body = random_body(rng)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = body.transformed(Q * np.sign(np.linalg.det(Q)), rng.normal(size=3))
    assert body.is_consistent()
    assert moved.is_consistent()


def test_the_cost_of_a_constraint_is_the_misfit_that_vanishes_without_it():
    model, truth, log = _pendulum()
    regression = build_regression(model, simulate_torque(model, 1.5 * truth, log))
    # The torque is that of a pendulum half as heavy again: only the mass holds it back.
    costs = constraint_costs(
        model,
        regression + build_regression(model, simulate_torque(model, truth, log)),
        [FixedMasses(), FixedCentresOfMass(), NonNegativeDrive()],
    )
    by_name = {cost.name: cost for cost in costs}
    assert all(cost.verdict == "certified" for cost in costs)
    # Two logs of 1 and 1.5 times the torque are best fitted by 1.25 times; with h = m c
    # held, only inertia and friction follow.  Freeing either frees h.
    Y = model.regressor(log.position, log.velocity, log.acceleration)[0].T
    kept, tau = [9, 10], Y @ truth
    target = np.concatenate([tau, 1.5 * tau])
    fixed = Y[:, :9] @ truth[:9]
    rows = np.vstack([Y, Y])
    rest = target - np.concatenate([fixed, fixed])
    held = rest - rows[:, kept] @ np.linalg.lstsq(rows[:, kept], rest, rcond=None)[0]
    free = target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]
    expected = np.linalg.norm(held) / np.linalg.norm(free) - 1.0
    assert by_name["FixedMasses"].increase == pytest.approx(expected, rel=1e-4)
    assert by_name["FixedCentresOfMass"].increase == pytest.approx(expected, rel=1e-4)
    assert by_name["NonNegativeDrive"].increase == pytest.approx(0.0, abs=1e-6)


def test_base_parameters_of_wild_size_are_judged_too():
    model, truth, _ = _experiment(70, samples=2)
    base = base_parameters(model)
    rng = np.random.default_rng(71)
    for size in (1e3, 1e6, 1e9):
        wild = size * rng.normal(size=len(base))
        assert base_feasibility(model, base, wild).answer == "impossible"
        bodily = base_feasibility(model, base, size * (base.projection @ truth))
        assert bodily.answer == "consistent"


def test_a_failing_solver_leaves_the_question_open(monkeypatch):
    model, truth, _ = _experiment(72, joints=2, samples=2)

    def fails(*_args, **_options):
        raise SolverError("out of order")

    monkeypatch.setattr("consistent_id.feasibility.run_clarabel", fails)
    base = base_parameters(model)
    answer = base_feasibility(model, base, base.projection @ truth)
    assert answer.answer == "undecided"
    assert "neither" in answer.summary
