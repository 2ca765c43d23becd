"""The best constrained fit by a second search, which has no cone and no solver.

`smooth_fit` and `fit_cross_check` (helpers) are the oracle: Newton's method in
log-Cholesky variables recovers the truth, and agrees with the cone programme.
"""

import numpy as np
import pytest
from body_variables import (
    _thickened,
    body_variables,
)
from differences import central_differences
from experiments import DRIVE, experiment, pendulum
from fit_cross_check import cross_check
from robots import random_robot, random_states
from smooth_fit import _proof, smooth_least_squares
from some_fast import some_fast

from consistent_id import (
    FixedMasses,
    InertialParameters,
    InfeasibleError,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    Recording,
    TorqueModel,
    build_regression,
    simulate_torque,
)
from consistent_id.constraints import (
    CentreOfMassBoxes,
    CentreOfMassIn,
    DensityOn,
    Ellipsoid,
    FixedCentresOfMass,
    FixedParameters,
    LinearRelation,
    ParameterBounds,
    lowered,
)
from consistent_id.estimation.best_fit import scaled_fit
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.regression import joint_noise
from consistent_id.regression.base import base_parameters
from consistent_id.robot import Datasheet
from consistent_id.robot.scaling import link_scales


def noisy(seed, joints, samples=300, amplitude=1.0, noise=0.1, still=()):
    """A simulated problem with noise in proportion to each joint's torque."""
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints, tree=bool(seed % 2))
    model = TorqueModel(robot, DRIVE)
    states = [amplitude * x for x in random_states(rng, joints, samples)]
    for joint in still:
        states[1][:, joint] = states[2][:, joint] = 0.0
    log = Recording(robot.joint_names, np.arange(samples) / 100, *states)
    truth = [*robot.nominal, *rng.uniform(0.1, 1.0, len(model.layout) - 10 * joints)]
    sigma = noise * simulate_torque(model, truth, log).torque.std(axis=0) + 1e-9
    log = simulate_torque(model, truth, log, noise=sigma, rng=rng)
    return model, build_regression(model, log)


@pytest.mark.parametrize("seed", some_fast(range(4), 2))
def test_without_noise_the_true_robot_is_recovered_where_the_data_speak(seed):
    model, truth, log = experiment(seed, joints=2 + seed)
    start = truth * np.random.default_rng(seed).uniform(0.5, 2.0, len(truth))
    estimate = smooth_least_squares(model, build_regression(model, log), start=start)
    assert estimate.certificate.verdict == "certified"
    expected = estimate.base.projection @ truth
    # A misfit of a millionth of the torque counts as none.
    assert np.allclose(estimate.base_values, expected, atol=1e-4 * abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("joints", some_fast(range(2, 8), 3))
def test_it_agrees_with_the_cone_programme(joints):
    model, regression = noisy(joints, joints)
    weighted = regression.weighted(joint_noise(model, regression))
    check = cross_check(model, weighted)
    assert check.cone_verdict == "certified"
    assert check.agrees
    assert abs(check.difference) < 1e-6
    for body in check.smooth.links:
        assert InertialParameters(body).is_consistent()


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(6), 2))
def test_it_agrees_where_the_robot_hardly_moves(seed):
    # Little motion and much noise: optima with flat bodies and frictionless joints.
    model, regression = noisy(50 + seed, 3, samples=60, amplitude=0.03, noise=1.0)
    check = cross_check(model, regression)
    assert check.agrees
    assert abs(check.difference) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_what_the_data_leave_open_is_named_and_does_not_hinder(seed):
    model, regression = noisy(seed, 4, still=[0])
    check = cross_check(model, regression)
    assert abs(check.difference) < 1e-6
    assert any("j0.viscous" in open_end for open_end in check.smooth.undetermined)
    assert check.smooth.origins[model.layout.index("j0.viscous")] == "prior"


@pytest.mark.slow
@pytest.mark.parametrize("margin", [0.0, 1e-6, 1e-3])
def test_the_misfit_converges_though_the_best_body_is_flat(margin):
    # The torque asks for less inertia about the axis than a point mass has.
    model, truth, log = pendulum()
    truth[9] = 0.15
    known = [PhysicalConsistency(margin), FixedMasses(), FixedCentresOfMass()]
    regression = build_regression(model, simulate_torque(model, truth, log))
    check = cross_check(model, regression, constraints=known)
    assert abs(check.difference) < 1e-6
    assert check.smooth.certificate.verdict == "certified"
    # Schur's complement of J - margin D: the least second moments about the axis.
    scales = link_scales(model.robot)
    m, d = scales.mass[0], scales.length[0]
    least = 0.6**2 / (2.0 - margin * m) + 2.0 * margin * m * d**2
    assert check.smooth["link1.Izz"] == pytest.approx(least, rel=1e-6)
    assert check.smooth["link1.m"] == pytest.approx(2.0, rel=1e-12)
    assert np.allclose(check.smooth.links[0][1:4], [0.6, 0, 0], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "knowledge",
    [
        [MassBounds()],
        [MassBounds(), FixedCentresOfMass()],
        [FixedCentresOfMass(), ParameterBounds({"joint1.viscous": (0.0, 0.1)})],
        [FixedMasses(), FixedParameters({"joint1.viscous": 0.4})],
        [FixedParameters({"link1.m": 2.0, "link1.hz": 0.0})],
    ],
    ids=lambda known: " ".join(type(k).__name__ for k in known),
)
@pytest.mark.parametrize("margin", [0.0, 1e-2])
def test_it_agrees_for_every_kind_of_knowledge(knowledge, margin):
    model, truth, log = pendulum()
    heavier = simulate_torque(
        model, 2.0 * truth, log, noise=0.5, rng=np.random.default_rng(0)
    )
    check = cross_check(
        model,
        build_regression(model, heavier),
        constraints=[PhysicalConsistency(margin), *knowledge],
    )
    assert check.agrees
    assert abs(check.difference) < 1e-6
    says = lowered(knowledge, model).normalised(np.ones(len(model.layout)))
    assert says.violation(check.smooth.parameters) < 1e-9


def test_derivatives_are_exact_where_a_fixed_centre_moves_with_a_free_mass():
    model, _, _ = pendulum()
    known = [PhysicalConsistency(0.3), MassBounds(), FixedCentresOfMass()]
    variables = body_variables(model, known, np.ones(len(model.layout)))
    rng = np.random.default_rng(0)
    v, g = 0.3 * rng.normal(size=8), rng.normal(size=len(model.layout))
    slope = central_differences(variables.parameters, v)
    assert np.allclose(variables.jacobian(v), slope, atol=1e-8)
    bend = central_differences(lambda at: variables.jacobian(at).T @ g, v)
    assert np.allclose(variables.curvature(v, g), bend, atol=1e-8)


@pytest.mark.slow
def test_the_end_does_not_depend_on_the_start():
    model, regression = noisy(3, 3)
    rng = np.random.default_rng(0)
    other = [1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1] * 3 + [*rng.uniform(0, 1, 9)]
    ends = [
        smooth_least_squares(model, regression, start=start) for start in (None, other)
    ]
    a, b = (np.linalg.norm(regression.residual_rms(end.parameters)) for end in ends)
    assert a == pytest.approx(b, rel=1e-8)


def test_the_proof_admits_as_much_as_a_point_falls_short():
    model, regression = noisy(4, 4)
    base = base_parameters(model)
    unit = scaled_fit(model, regression, base, DEFAULT_CONSTRAINTS)
    variables = body_variables(model, DEFAULT_CONSTRAINTS, unit.unit)
    best = smooth_least_squares(model, regression, base=base).parameters / unit.unit
    v = variables.variables(best)
    least = 0.5 * np.linalg.norm(unit.M @ best - unit.z) ** 2
    for seed in range(5):
        step = np.random.default_rng(seed).normal(size=len(v))
        u = variables.parameters(np.maximum(v + 0.01 * step, variables.lower))
        excess = 0.5 * np.linalg.norm(unit.M @ u - unit.z) ** 2 - least
        proof = _proof(unit, variables, u)
        assert proof.verdict == "uncertified"
        assert proof.gap * max(proof.objective, 0.5) >= excess > 0.0


@pytest.mark.parametrize(
    "constraint",
    [
        CentreOfMassBoxes(),
        CentreOfMassIn("link1", Ellipsoid([0, 0, 0], [1, 1, 1])),
        FixedParameters({"link1.Izz": 0.1}),
        FixedParameters({"link1.hx": 0.1}),
        ParameterBounds({"link1.hx": (0.0, 1.0)}),
        LinearRelation({"link1.m": 1.0, "joint1.viscous": 1.0}, 0.0, 0.0),
        DensityOn("link1", Ellipsoid([0, 0, 0], [1, 1, 1])),
    ],
    ids=lambda constraint: type(constraint).__name__,
)
def test_other_constraints_are_refused_by_name(constraint):
    model, _, log = pendulum()
    name = type(constraint).__name__
    with pytest.raises(ProblemError, match=f"{name} says.*constrained_least_squares"):
        smooth_least_squares(
            model,
            build_regression(model, log),
            constraints=[PhysicalConsistency(), constraint],
        )


def test_links_must_be_bodies():
    model, _, log = pendulum()
    with pytest.raises(ProblemError, match="stated 0 times"):
        smooth_least_squares(
            model, build_regression(model, log), constraints=[FixedMasses()]
        )


def test_contradictions_are_refused():
    model, _, log = pendulum()
    regression = build_regression(model, log)
    for known in (
        [FixedMasses(), FixedMasses({"link1": 3.0})],
        [FixedMasses(), MassBounds({"link1": (3.0, 4.0)})],
        [FixedCentresOfMass(), FixedCentresOfMass({"link1": (0.2, 0.0, 0.0)})],
        [NonNegativeDrive(), FixedParameters({"joint1.viscous": -1.0})],
    ):
        with pytest.raises(InfeasibleError, match="contradicts another constraint"):
            smooth_least_squares(
                model, regression, constraints=[PhysicalConsistency(), *known]
            )


def test_a_mass_of_zero_is_refused():
    model, _, log = pendulum()
    weightless = TorqueModel(
        model.robot.with_datasheet({"link1": Datasheet(mass=0.0)}), model.drive
    )
    with pytest.raises(ProblemError, match=r"link1: a mass .* has no logarithm"):
        smooth_least_squares(weightless, build_regression(weightless, log))


@pytest.mark.parametrize("mass", [0.2, 1.0, 30.0])
def test_a_body_is_thickened_only_where_it_is_thin(mass):
    spread = np.diag([0.04, 0.02, 0.01])  # central second moments over the mass, m^2
    thick = InertialParameters.from_central(
        mass, [0.3, -0.2, 0.1], mass * (np.trace(spread) * np.eye(3) - spread)
    )
    np.testing.assert_allclose(_thickened(thick.vector), thick.vector, atol=1e-12)
    # A point has none; it keeps its mass and its place, and gets 3 cm.
    point = InertialParameters.from_central(mass, [0.3, -0.2, 0.1], np.zeros((3, 3)))
    found = InertialParameters(_thickened(point.vector))
    np.testing.assert_allclose(found.vector[:4], point.vector[:4], atol=1e-12)
    assert found.is_consistent()
    # Equal in all directions: two moments of second order are each moment of inertia.
    _, *equal = np.linalg.eigvalsh(found.central_inertia / mass)
    np.testing.assert_allclose(equal, 2.0 * 0.03**2, rtol=1e-6)
