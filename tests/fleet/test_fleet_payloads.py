"""Robots of a fleet that carry something of their own."""

import json
from functools import partial

import cvxpy as cp
import numpy as np
import pytest
from excited import arm
from some_fast import some_fast

import consistent_id as ci
from consistent_id.constraints import lowered
from consistent_id.errors import ProblemError
from consistent_id.fleet.fleet_model import (
    fleet_model,
    own_sets,
    robot_share,
    shared_constraints,
    write_share,
)
from consistent_id.fleet.payloads import FREE, load_fit, placed, without_load
from consistent_id.fleet.settling import StoredRobot, held_rows, settle
from consistent_id.regression.base import base_parameters
from consistent_id.robot.inertia import pseudo_inertia

DRIVE = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True)
CONSTRAINTS = (ci.PhysicalConsistency(), ci.NonNegativeDrive())
LINK = "link2"
HAND = "link3"
BRICK = ci.InertialParameters.from_central(
    1.5, (0.1, 0.05, -0.02), np.diag([0.01, 0.02, 0.015])
)
NAIL = ci.InertialParameters.from_central(0.8, (0.2, 0.0, 0.05), np.zeros((3, 3)))


@pytest.fixture(scope="module")
def model():
    """A torque model of an arm with two joints."""
    return ci.TorqueModel(arm(2), DRIVE)


@pytest.fixture(scope="module")
def longer():
    """A torque model of an arm with three joints, which feel a load's mass."""
    return ci.TorqueModel(arm(3), DRIVE)


def _robot(model, rng, *, load=None, smooth=False, samples=1500, noise=0.3):
    """Regression of a robot with friction of its own, and with a load perhaps."""
    time = np.arange(samples) / 100.0
    rates = np.array([0.5, 1.1, 2.3])
    angle = time[:, None, None] * rates + rng.uniform(0, 6, (len(model.robot), 3))
    q, dq = np.sin(angle).sum(axis=2), (rates * np.cos(angle)).sum(axis=2)
    ddq = -(rates**2 * np.sin(angle)).sum(axis=2)
    x = np.zeros(len(model.layout))
    inertial = model.layout.inertial_size
    x[:inertial] = np.ravel(model.robot.nominal)
    x[inertial - 10 : inertial] += 0.0 if load is None else load.vector
    for joint in model.robot.joint_names:
        x[model.layout.index(f"{joint}.viscous")] = 0.0 if smooth else 1.3
        x[model.layout.index(f"{joint}.coulomb")] = rng.uniform(0.2, 1.0)
        x[model.layout.index(f"{joint}.offset")] = rng.normal(0, 0.2)
    motion = ci.Recording(model.robot.joint_names, time, q, dq, ddq)
    log = ci.simulate_torque(model, x, motion, noise=noise, rng=rng)
    return ci.build_regression(model, log)


def test_what_a_load_explains_is_projected_out(model):
    fleet, rng = fleet_model(model), np.random.default_rng(0)
    share = robot_share("a", fleet, _robot(model, rng, load=BRICK)).shared
    place = placed(fleet, ci.fleet.CarriedBody(LINK), "a")
    left = without_load(share, place, FREE)
    rows = [F / s for F, s in zip(share.factors, share.sigma, strict=True)]
    for _ in range(5):
        x = rng.normal(size=len(fleet.common))
        at = [F[:, place.columns] for F in rows]
        rest = np.concatenate([F @ np.append(x, -1.0) for F in rows])
        body = -np.linalg.lstsq(np.vstack(at), rest, rcond=None)[0]
        # Joint by joint: residuals beside the load that fits best.
        loaded = place.added(x, body)
        np.testing.assert_allclose(
            left.residual_rms(x), share.residual_rms(loaded), rtol=1e-8
        )


def test_what_a_load_takes_up_is_in_no_score(longer):
    """Columns of the carrier are a free load's own: nothing is left of them."""
    fleet, rng = fleet_model(longer), np.random.default_rng(0)
    share = robot_share("a", fleet, _robot(longer, rng, load=BRICK)).shared
    place = placed(fleet, ci.fleet.CarriedBody(HAND), "a")
    left = without_load(share, place, FREE)
    for before, after in zip(share.noise.scores, left.noise.scores, strict=True):
        assert abs(after[:, place.columns]).max() < 1e-8 * abs(before).max()
    assert abs(left.noise.scores[0]).max() > 1e-3 * abs(share.noise.scores[0]).max()


@pytest.mark.slow
def test_robots_weigh_as_their_noise_whichever_is_first(model, tmp_path):
    """A robot with ten times the noise tells a hundredth, and its peaks as much."""
    fleet, rng = fleet_model(model), np.random.default_rng(5)
    limits = own_sets(fleet, lowered(CONSTRAINTS, model))
    base = base_parameters(fleet.shared)
    robots, shares = {}, {}
    for name, noise in (("loud", 3.0), ("quiet", 0.3)):
        share = robot_share(name, fleet, _robot(model, rng, noise=noise))
        file = tmp_path / f"{name}.npz"
        write_share(file, share)
        ends = share.own, share.shared.sigma, 1.0, 1.0, 1
        robots[name], shares[name] = StoredRobot(name, file, *ends), share.shared
    bodies = shared_constraints(fleet, CONSTRAINTS)
    solved = partial(
        ci.constrained_least_squares, fleet.shared, constraints=bodies, base=base
    )

    def found(*names):
        settled = settle(fleet, [robots[name] for name in names], limits, solved)
        return settled.shared

    def errors(shared):
        return ci.least_squares(fleet.shared, shared, base=base).standard_errors

    alone = errors(found("quiet"))
    both = found("loud", "quiet")
    np.testing.assert_allclose(errors(both) / alone, np.sqrt(100 / 101), rtol=0.1)
    # In the noise of the first.
    unit = shares["loud"].sigma / shares["quiet"].sigma
    expected = np.maximum(shares["loud"].peaks, unit * shares["quiet"].peaks)
    np.testing.assert_allclose(both.peaks, expected)


def test_a_load_is_as_stiff_as_its_cone_lets_it_be(model):
    # The model of what the shared parameters cost beside a load at its boundary has
    # the value, the slope and the curvature of the true cost, by differences.
    fleet, rng = fleet_model(model), np.random.default_rng(1)
    share = robot_share("a", fleet, _robot(model, rng, load=NAIL)).shared
    place = placed(fleet, ci.fleet.CarriedBody(LINK), "a")
    x = np.ravel(model.robot.nominal) * 1.01
    fit = load_fit(share, place, x)
    assert np.linalg.eigvalsh(pseudo_inertia(fit.body))[0] < 1e-6
    thought = without_load(share, place, fit)

    def cost(regression, y):
        rows = regression.residual_rms(y) / regression.sigma
        return float(np.sum(rows**2 * regression.counts))

    assert cost(thought, x) == pytest.approx(fit.misfit, rel=1e-6)
    for _ in range(4):
        step = rng.normal(size=20) * np.ravel(model.robot.nominal) * 3e-4
        true = [load_fit(share, place, x + k * step).misfit for k in (-1, 1)]
        seen = [cost(thought, x + k * step) for k in (-1, 1)]
        assert seen[1] - seen[0] == pytest.approx(true[1] - true[0], rel=1e-3)
        curved, known = (sum(costs) - 2 * fit.misfit for costs in (seen, true))
        assert curved == pytest.approx(known, rel=0.05)


@pytest.mark.slow
def test_bodies_and_loads_are_the_optimum_of_all_robots_together(model, tmp_path):
    fleet, rng = fleet_model(model), np.random.default_rng(2)
    loads = {"b": BRICK, "c": NAIL, "d": NAIL}
    regressions = {
        name: _robot(model, rng, load=loads.get(name), smooth=name in "bd", samples=300)
        for name in "abcd"
    }
    limits, base = own_sets(fleet, lowered(CONSTRAINTS, model)), None
    base, robots = base_parameters(fleet.shared), []
    for name, regression in regressions.items():
        share, file = robot_share(name, fleet, regression), tmp_path / f"{name}.npz"
        write_share(file, share)
        carried = (
            placed(fleet, ci.fleet.CarriedBody(LINK), name) if name in loads else None
        )
        ends = share.own, share.shared.sigma, 1.0, 1.0, 1, carried
        robots.append(StoredRobot(name, file, *ends))
    solved = partial(
        ci.constrained_least_squares,
        fleet.shared,
        constraints=shared_constraints(fleet, CONSTRAINTS),
        base=base,
        prior=ci.constraints.PointToSet(slack=1e-9),
    )
    found = settle(fleet, robots, limits, solved)
    assert found.settled
    x = found.bodies.parameters
    ours = np.sum(
        (found.shared.residual_rms(x) / found.shared.sigma) ** 2 * found.shared.counts
    )
    for robot in robots:
        if robot.place is not None:
            held = held_rows(fleet, robot, robot.place, x, limits)
            body = load_fit(held, robot.place, x).body
            assert np.linalg.eigvalsh(pseudo_inertia(body))[0] > -1e-7

    # The same by one programme with every robot's load and friction in it.
    shared, rules, residuals = cp.Variable(20), [], []
    unit = np.maximum(abs(np.ravel(model.robot.nominal)), 0.01)
    bodies = cp.multiply(shared, unit)
    whole = lowered(CONSTRAINTS, model)

    def consistent(links):
        for block in whole.blocks:
            used = np.flatnonzero(block.coefficients.any(axis=(1, 2)))
            J = sum(links[int(i)] * block.coefficients[i] for i in used)
            rules.append((J + block.constant) / np.outer(block.scale, block.scale) >> 0)

    consistent(bodies)
    for name, regression in regressions.items():
        links = bodies
        if name in loads:
            load = cp.multiply(cp.Variable(10), unit[10:])
            links = bodies + cp.hstack([np.zeros(10), load])
            spread = np.diag([10.0, 10.0, 10.0, 1.0])
            J = sum(
                load[i] * (spread @ pseudo_inertia(np.eye(10)[i]) @ spread)
                for i in range(10)
            )
            rules.append(J >> 0)
        friction = cp.Variable(len(model.layout) - 20)
        every = cp.hstack([links, friction])
        rules.append(whole.A_in @ every <= whole.b_in)
        sigma = robot_share(name, fleet, regression).shared.sigma
        residuals += [
            (F[:, :-1] @ every - F[:, -1]) / s
            for F, s in zip(regression.factors, sigma, strict=True)
        ]
    problem = cp.Problem(cp.Minimize(cp.norm(cp.hstack(residuals))), rules)
    problem.solve(cp.CLARABEL)
    assert ours == pytest.approx(problem.value**2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("fleets", some_fast([1, 3]))
def test_loads_are_recovered_with_honest_errors(longer, fleets):
    rng = np.random.default_rng(3)
    apart, names = [], [f"r{k}" for k in range(8)]
    for _ in range(fleets):
        regressions = {
            name: _robot(longer, rng, load=BRICK if k >= 4 else None)
            for k, name in enumerate(names)
        }
        fleet = ci.fleet.fleet_estimate(
            longer,
            regressions,
            constraints=CONSTRAINTS,
            payloads={name: ci.fleet.CarriedBody(HAND) for name in names[4:]},
        )
        assert fleet.outliers == () and fleet.settled
        assert "payload" in fleet.to_dict()["robots"]["r7"]
        for robot in fleet.robots[4:]:
            found = robot.payload
            assert found.estimate.certificate.verdict == "certified"
            assert found.body.mass == pytest.approx(1.5, rel=0.02)
            np.testing.assert_allclose(found.body.com, BRICK.com, atol=0.01)
            errors = found.standard_errors
            assert np.isfinite(errors).all()
            apart += ((found.estimate.parameters - BRICK.vector) / errors).tolist()
            np.testing.assert_allclose(
                robot.parameters[20:30],
                fleet.bodies.parameters[20:30] + found.estimate.parameters,
            )
            assert robot.misfit < 1.02 * robot.alone
    # 40 or 120 errors, those of one fleet's robots alike in part: some hundredths of
    # 95 %, and a standard deviation that 40 know to a tenth.
    assert 0.88 < np.mean(np.abs(apart) < 1.96)
    if fleets > 1:
        assert np.mean(np.abs(apart) < 1.96) < 0.995
    assert np.std(apart) == pytest.approx(1.0, abs=0.3 if fleets == 1 else 0.2)


@pytest.mark.slow
def test_a_load_that_is_not_known_of_makes_an_outlier(model):
    rng = np.random.default_rng(4)
    regressions = {
        f"r{k}": _robot(model, rng, load=BRICK if k == 2 else None) for k in range(6)
    }
    silent = ci.fleet.fleet_estimate(model, regressions, constraints=CONSTRAINTS)
    assert silent.outliers == ("r2",)
    told = ci.fleet.fleet_estimate(
        model,
        regressions,
        constraints=CONSTRAINTS,
        payloads={"r2": ci.fleet.CarriedBody(LINK, ci.robot.Datasheet(mass=1.5))},
    )
    assert told.outliers == () and told["r2"].payload.body.mass == 1.5  # given
    assert "r2" in told.payload_table().text()


@pytest.mark.slow
def test_without_a_robot_that_carries_nothing_loads_are_open(model):
    rng = np.random.default_rng(5)
    regressions = {f"r{k}": _robot(model, rng, load=BRICK) for k in range(2)}
    carried = dict.fromkeys(regressions, ci.fleet.CarriedBody(LINK))
    fleet = ci.fleet.fleet_estimate(
        model, regressions, constraints=CONSTRAINTS, payloads=carried
    )
    for robot in fleet.robots:
        assert np.isinf(robot.payload.standard_errors).all()
        assert robot.misfit < 1.02 * robot.alone
    assert "open" in fleet.payload_table().text()
    assert json.dumps(fleet.to_dict(), allow_nan=False)


def test_loads_of_other_robots_and_on_other_links_are_refused(model):
    regressions = {"a": _robot(model, np.random.default_rng(6))}
    for payloads, said in (
        ({"b": ci.fleet.CarriedBody(LINK)}, "no such robot"),
        ({"a": ci.fleet.CarriedBody("hand")}, "has a payload on link 'hand'"),
    ):
        with pytest.raises(ProblemError, match=said):
            ci.fleet.fleet_estimate(
                model, regressions, constraints=CONSTRAINTS, payloads=payloads
            )
