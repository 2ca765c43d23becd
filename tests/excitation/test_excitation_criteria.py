"""Criteria, information, rows: closed forms, and derivatives by finite differences."""

import numpy as np
import pytest
from excited import FRICTION, arm, arm_limits, arm_problem

from consistent_id import DriveTerms, ProblemError, TorqueModel
from consistent_id.excitation import kernels
from consistent_id.excitation.aims import PathForm
from consistent_id.excitation.basis import FourierBasis, limit_rows, null_space
from consistent_id.excitation.criteria import criterion_of, of_some, scaled, spread
from consistent_id.excitation.guards import TorqueGuard, WatchedPlace, guard_rows
from consistent_id.excitation.kernels import (
    ParameterTorque,
    RegressorKernel,
    TorqueKernel,
    slow_speeds,
    smooth,
)
from consistent_id.excitation.search_problem import PathInformation
from consistent_id.excitation.verification import demands
from consistent_id.regression import base_parameters

OBJECTIVES = ("condition", "D", "A", "E", "task")


def information(seed, size=6):
    W = np.random.default_rng(seed).normal(size=(30, size)) * np.arange(1, size + 1)
    return W.T @ W


def slope(function, x, direction, step=1e-6):
    """Central difference along a direction."""
    return (function(x + step * direction) - function(x - step * direction)) / (
        2.0 * step
    )


@pytest.mark.parametrize("scaling", ["none", "unit columns"])
@pytest.mark.parametrize("power", [2.0, 8.0])
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_gradients_of_criteria_are_those_of_finite_differences(
    objective, power, scaling
):
    criterion = scaled(criterion_of(objective, power, information(9)), scaling)
    rng, M = np.random.default_rng(1), information(0)
    gradient = criterion(M).gradient
    for _ in range(3):
        direction = rng.normal(size=M.shape)
        direction = direction + direction.T
        expected = slope(lambda X: criterion(X).value, M, direction, 1e-5)
        assert np.isclose((gradient * direction).sum(), expected, rtol=1e-5, atol=1e-9)


def test_the_smooth_condition_number_becomes_the_true_one():
    M = information(2)
    true = 0.5 * np.log(np.linalg.cond(M))
    assert np.isclose(spread(np.inf)(M).value, true, rtol=1e-12)
    gaps = [spread(power)(M).value - true for power in (2.0, 8.0, 20.0, 200.0)]
    bounds = [np.log(len(M)) / power for power in (2.0, 8.0, 20.0, 200.0)]
    assert gaps == sorted(gaps, reverse=True)
    assert all(0.0 <= gap <= bound for gap, bound in zip(gaps, bounds, strict=True))
    assert gaps[-1] < 1e-6


def test_criteria_are_the_sizes_of_standard_errors_that_they_say():
    M, gram = information(3), information(4)
    covariance = np.linalg.inv(M)
    values = {
        name: float(np.exp(criterion_of(name, np.inf, gram)(M).value))
        for name in OBJECTIVES
    }
    assert np.isclose(values["D"], np.linalg.det(covariance) ** (0.5 / len(M)))
    assert np.isclose(values["A"], np.sqrt(np.trace(covariance)))
    assert np.isclose(values["E"], np.sqrt(np.linalg.norm(covariance, 2)))
    assert np.isclose(values["task"], np.sqrt(np.trace(gram @ covariance)))


@pytest.mark.parametrize("places", [(1,), (0, 3, 4), (5, 2), tuple(range(6))])
def test_criteria_of_some_parameters_are_sizes_of_their_block_of_the_covariance(places):
    M = information(6)
    block = np.linalg.inv(M)[np.ix_(places, places)]
    values = {
        name: float(np.exp(of_some(criterion_of(name, np.inf, None), places)(M).value))
        for name in ("D", "A", "E")
    }
    assert np.isclose(values["D"], np.linalg.det(block) ** (0.5 / len(places)))
    assert np.isclose(values["A"], np.sqrt(np.trace(block)))
    assert np.isclose(values["E"], np.sqrt(np.linalg.norm(block, 2)))


@pytest.mark.parametrize("objective", ["D", "A", "E"])
def test_gradients_of_some_parameters_are_those_of_finite_differences(objective):
    criterion = of_some(criterion_of(objective, 4.0, None), (1, 4))
    rng, M = np.random.default_rng(2), information(7)
    gradient = criterion(M).gradient
    for _ in range(3):
        direction = rng.normal(size=M.shape)
        direction = direction + direction.T
        expected = slope(lambda X: criterion(X).value, M, direction, 1e-5)
        assert np.isclose((gradient * direction).sum(), expected, rtol=1e-5)


def test_unit_columns_are_blind_to_the_units_of_parameters():
    M, units = information(5), np.diag([1.0, 10.0, 0.1, 3.0, 7.0, 100.0])
    criterion = scaled(spread(8.0), "unit columns")
    assert np.isclose(criterion(M).value, criterion(units @ M @ units).value)


def test_objectives_that_make_no_sense_are_refused():
    with pytest.raises(ProblemError, match="expected one of condition"):
        criterion_of("best", 2.0, None)
    with pytest.raises(ProblemError, match="needs the task"):
        criterion_of("task", 2.0, None)
    with pytest.raises(ProblemError, match="scaling is 'some'"):
        scaled(spread(2.0), "some")


@pytest.mark.parametrize("drive", [None, FRICTION], ids=["rigid", "friction"])
def test_the_kernel_is_the_regressor_of_the_torque_model(drive):
    model = TorqueModel(arm(3)) if drive is None else TorqueModel(arm(3), drive)
    base, rng = base_parameters(model), np.random.default_rng(0)
    motion = rng.normal(size=(3, 12, 3))
    kernel = RegressorKernel(model, base, 12)
    expected = model.regressor(*motion)[:, list(base.independent)]
    W = kernel.regressor(motion)
    assert np.allclose(W, expected.transpose(0, 2, 1), rtol=1e-12, atol=1e-12)
    seed, direction = rng.normal(size=W.shape), rng.normal(size=motion.shape)
    pulled = (kernel.pull(motion, seed) * direction).sum()
    by_difference = slope(
        lambda m: (seed * kernel.regressor(m)).sum(), motion, direction
    )
    assert np.isclose(pulled, by_difference, rtol=1e-6)


def test_the_jump_of_friction_is_steep_for_slow_joints_too():
    robot = arm(2)
    model = TorqueModel(robot, DriveTerms(coulomb="sign"))
    limits = arm_limits(robot, velocity=[2.0, 0.01])
    slow = slow_speeds(limits)
    assert np.allclose(slow, [0.02, 0.0001])
    motion = np.zeros((3, 1, 2))
    motion[1] = [1.0, 0.005]  # half of what each joint can do
    exact = model.regressor(*motion)
    steep = smooth(model, slow).regressor(*motion)
    assert np.allclose(steep, exact, atol=1e-9)
    kernel = RegressorKernel(model, base_parameters(model), 1, slow)
    columns = list(base_parameters(model).independent)
    assert np.allclose(kernel.regressor(motion)[:, 0], exact[:, columns, 0], atol=1e-9)


def test_where_nothing_limits_velocity_acceleration_or_jerk_tells_what_is_slow():
    robot = arm(2)
    fast = np.full(2, np.inf)
    ranges = {name: (-1.0, 1.0) for name in robot.joint_names}
    limits = arm_limits(robot, position=ranges, velocity=fast, acceleration=8.0)
    assert np.allclose(slow_speeds(limits), 0.04)
    limits = arm_limits(
        robot, position=ranges, velocity=fast, acceleration=fast, jerk=27.0
    )
    assert np.allclose(slow_speeds(limits), 0.03)


def test_torques_of_a_set_are_those_of_the_model_with_their_slopes():
    model, rng = TorqueModel(arm(2), FRICTION), np.random.default_rng(0)
    members = rng.normal(size=(2, len(model.layout)))
    motion, direction = rng.normal(size=(2, 3, 5, 2))
    kernel = TorqueKernel(model, members)
    torque = kernel.torque(motion).copy()
    for k, member in enumerate(members):
        expected = model.predict(member, *motion)
        assert np.allclose(torque[:, k], expected, rtol=1e-12, atol=1e-12)
    slopes = kernel.slopes(motion).copy()
    change = np.einsum("smtoj,osj->smt", slopes, direction)
    by_difference = slope(lambda m: kernel.torque(m).copy(), motion, direction)
    assert np.allclose(change, by_difference, rtol=1e-5, atol=1e-6)


FORMS = [
    PathForm(5.0, 3),
    PathForm(5.0, 3, rest=False),
    PathForm(7.0, 3, base_frequencies=(0.2, 0.3)),
    PathForm(6.0, 4, base_frequencies=(0.1, 0.1 * 2**0.5)),
]


def basis_of(form, robot=None):
    robot = robot or arm(2)
    return FourierBasis(
        arm_limits(robot, jerk=40.0), form.frequencies, form.duration, form.rest
    )


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_paths_rest_exactly_and_are_their_fourier_trajectories(form):
    basis, rng = basis_of(form), np.random.default_rng(0)
    variables = rng.normal(size=(basis.size, 2))
    path = basis.trajectory(variables)
    time = np.linspace(0.0, form.duration, 17)
    motion = basis.motion(variables, time, derivatives=3)
    scale = abs(motion).max(axis=(1, 2), keepdims=True)
    assert (abs(motion - path.evaluate(time, 3)) <= 1e-12 * scale).all()
    ends = path.evaluate([0.0, form.duration])[1:] / scale[1:3]
    assert form.rest == bool((abs(ends) < 1e-12).all())
    periodic = len(np.atleast_1d(form.base_frequencies or 1.0)) == 1
    if periodic:
        assert path.period == pytest.approx(form.duration)


@pytest.mark.parametrize("rank", [1, 2, 4])
def test_a_null_space_has_one_basis_however_its_rows_are_mixed(rank):
    # The singular vectors of the two differ by any rotation, as between processors.
    rng = np.random.default_rng(rank)
    rows = rng.normal(size=(rank, 9))
    mixed = rng.normal(size=(5, rank)) @ rows
    basis = null_space(rows)
    assert np.allclose(rows @ basis, 0.0, atol=1e-12)
    assert np.allclose(basis.T @ basis, np.eye(9 - rank), atol=1e-12)
    assert np.allclose(null_space(mixed), basis, atol=1e-9)


def test_too_few_frequencies_for_rest_are_refused():
    # velocity and acceleration vanish at both ends: with period and duration the same,
    # two conditions on the two coefficients of a single frequency
    with pytest.raises(ProblemError, match="give more harmonics"):
        basis_of(PathForm(5.0, 1))


@pytest.mark.parametrize("order", range(4))
def test_the_pull_of_a_basis_is_the_transpose_of_its_motion(order):
    basis, rng = basis_of(FORMS[0]), np.random.default_rng(0)
    time = np.linspace(0.0, 5.0, 9)
    variables = rng.normal(size=(basis.size, 2))
    slopes = rng.normal(size=(9, 2))
    still = np.zeros_like(variables)
    change = (basis.motion(variables, time, 3) - basis.motion(still, time, 3))[order]
    pulled = basis.pull(order, basis.columns(order, time), slopes)
    assert np.isclose((slopes * change).sum(), (pulled * variables).sum(), rtol=1e-10)


def test_information_is_that_of_the_recorded_rows_with_its_gradient():
    model = TorqueModel(arm(2), FRICTION)
    base, basis, rng = (
        base_parameters(model),
        basis_of(FORMS[0]),
        np.random.default_rng(0),
    )
    time, noise = np.arange(20) * 0.25, np.array([0.5, 2.0])
    earlier = information(0, len(base))
    informed = PathInformation(
        model, base, basis, samples=20, recorded=500.0, noise=noise, earlier=earlier
    )
    variables, direction, G = (
        rng.normal(size=(basis.size, 2)),
        rng.normal(size=(basis.size, 2)),
        rng.normal(size=(len(base), len(base))),
    )
    G = G + G.T
    matrix, pull = informed(variables)
    q, dq, ddq = basis.trajectory(variables).evaluate(time)
    W = model.regressor(q, dq, ddq)[:, list(base.independent)] / noise[:, None, None]
    expected = np.einsum("jps,jqs->pq", W, W) * 500.0 / 20.0 + earlier
    assert np.allclose(matrix, expected, rtol=1e-10, atol=1e-9)
    by_difference = slope(
        lambda x: (G * informed(x).matrix).sum(), variables, direction
    )
    assert np.isclose((pull(G) * direction).sum(), by_difference, rtol=1e-6)


@pytest.mark.parametrize("scaling", ["none", "unit columns"])
@pytest.mark.parametrize("objective", OBJECTIVES[:4])
def test_the_gradient_in_the_variables_is_that_of_finite_differences(
    objective, scaling
):
    from consistent_id.excitation.aims import Aim

    problem = arm_problem(TorqueModel(arm(2)), aim=Aim(scaling=scaling))
    criterion = problem.criterion(objective, 4.0)
    variables = problem.random(0)
    direction = np.random.default_rng(1).normal(size=variables.shape)
    gradient = problem.value(criterion, variables).gradient
    by_difference = slope(
        lambda x: problem.value(criterion, x).value, variables, direction
    )
    assert np.isclose((gradient * direction).sum(), by_difference, rtol=1e-5)


def test_rows_of_a_guard_have_the_slopes_of_finite_differences():
    robot = arm(2)
    model = TorqueModel(robot)
    members = np.array([robot.nominal, 1.3 * robot.nominal])
    guard = TorqueGuard(ParameterTorque(model, members), np.array([5.0, 10.0]), 0.9)
    basis, rng = basis_of(FORMS[0]), np.random.default_rng(0)
    variables, direction = rng.normal(size=(2, basis.size, 2))
    grid = np.linspace(0.0, 5.0, 40)
    places = [
        WatchedPlace(3, 0),
        WatchedPlace(17, 1),
        WatchedPlace(17, 2),
        WatchedPlace(30, 3),
    ]

    def rows(x):
        return guard_rows(guard, places, basis, grid, x)

    values, jacobian = rows(variables)
    by_difference = slope(lambda x: rows(x)[0], variables, direction)
    assert np.allclose(jacobian @ direction.ravel(), by_difference, rtol=1e-5)
    torque = model.predict(members[1], *basis.motion(variables, grid[17:18]))
    assert np.isclose(values[2], abs(torque[0, 0]) / 5.0 - 0.9, rtol=1e-12)
    assert guard.item_name(3) == "torque of joint 'joint2'"
    assert (
        guard.tightened().measure(basis.motion(variables, grid)).max()
        > guard.measure(basis.motion(variables, grid)).max()
    )


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_limit_rows_never_take_a_path_for_smaller_than_it_is(form, seed):
    basis, rng = basis_of(form), np.random.default_rng(seed)
    variables = rng.normal(size=(basis.size, 2))
    rows = limit_rows(basis, basis.trajectory(variables).period)
    largest = rows.largest(variables)
    time = np.linspace(0.0, form.duration, 20_001)
    motion = basis.trajectory(variables).evaluate(time, 3)
    motion[0] -= basis.limits.middle
    limits = np.array([basis.limits.derivative(order) for order in range(4)])
    reached = (abs(motion).max(axis=1) / limits).max(axis=0)
    assert (reached <= largest * (1.0 + 1e-12)).all()
    # Rows of the programme are the same shares, at fewer times.
    assert abs(rows.matrix @ variables.ravel()).max() <= largest.max() * (1.0 + 1e-12)
    kept = basis.trajectory(rows.within(3.0 * variables)).evaluate(time, 3)
    kept[0] -= basis.limits.middle
    assert (abs(kept).max(axis=1) <= limits * (1.0 + 1e-12)).all()


def test_a_tightened_guard_needs_no_other_kernel(monkeypatch):
    robot, compiled = arm(2), []
    kernel = kernels.TorqueKernel
    monkeypatch.setattr(
        kernels, "TorqueKernel", lambda *of: compiled.append(of) or kernel(*of)
    )
    required = demands(TorqueModel(robot), arm_limits(robot, effort=10.0))
    motion = np.zeros((3, 4, 2))
    (guard,), (again,) = required.guards, required.guards
    loose = guard.measure(motion)
    assert (guard.tightened().measure(motion) > loose).all()
    assert np.array_equal(again.measure(motion), loose)
    assert len(compiled) == 1
