"""Robots of one type: shared bodies, own friction, outliers."""

import json
from types import SimpleNamespace

import cvxpy as cp
import numpy as np
import pytest
from excited import arm
from fleet_folders import FILE, write_robots
from schemas import parsed
from scipy.optimize import lsq_linear
from shown import assert_reached

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.constraints import lowered
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import best_fit
from consistent_id.fleet.fleet_model import (
    OwnSet,
    fleet_model,
    own_fit,
    own_sets,
    read_share,
    robot_share,
    shared_constraints,
    write_share,
)
from consistent_id.fleet.settling import StoredRobot, own_fits, settle
from consistent_id.regression.base import base_parameters
from consistent_id.regression.residual_noise import joint_noise

DRIVE = ci.DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True, rotor_inertia=True
)
CONSTRAINTS = (ci.PhysicalConsistency(), ci.NonNegativeDrive())


@pytest.fixture(scope="module")
def model():
    """A torque model of an arm with two joints."""
    return ci.TorqueModel(arm(2), DRIVE)


def _robot(model, rng, *, heavier=0.0, smooth=False, samples=1500, still=False):
    """Parameters of a robot of the type, and its regression."""
    time = np.arange(samples) / 100.0
    rates = np.array([0.5, 1.1, 2.3])
    angle = time[:, None, None] * rates + rng.uniform(0, 6, (2, 3))
    q, dq = np.sin(angle).sum(axis=2), (rates * np.cos(angle)).sum(axis=2)
    ddq = -(rates**2 * np.sin(angle)).sum(axis=2)
    if still:
        q[:, 1], dq[:, 1], ddq[:, 1] = 0.3, 0.0, 0.0
    x = np.zeros(len(model.layout))
    x[:20] = np.ravel(model.robot.nominal)
    body = ci.InertialParameters.from_central(heavier, (0.3, 0, 0), np.zeros((3, 3)))
    x[10:20] += body.vector if heavier else 0.0
    for joint in model.robot.joint_names:
        own = {"viscous": 0.0 if smooth else rng.uniform(0.5, 2.0)}
        own |= {"coulomb": rng.uniform(0.2, 1.0), "offset": rng.normal(0, 0.2)}
        for term, value in (own | {"rotor_inertia": 0.3}).items():
            x[model.layout.index(f"{joint}.{term}")] = value
    motion = ci.Recording(model.robot.joint_names, time, q, dq, ddq)
    log = ci.simulate_torque(model, x, motion, noise=0.2 + 0.2 * rng.uniform(), rng=rng)
    return x, ci.build_regression(model, log)


def test_squares_are_split_between_own_and_shared(model):
    rng = np.random.default_rng(0)
    fleet = fleet_model(model)
    for still in (False, True):
        _, regression = _robot(model, rng, still=still)
        share = robot_share("a", fleet, regression)
        for _ in range(5):
            x = rng.normal(size=len(model.layout))
            z = np.append(x[fleet.common], -1.0)
            for j, mine in enumerate(fleet.own):
                whole = np.sum((regression.factors[j] @ np.append(x, -1.0)) ** 2)
                own = np.sum((share.own[j] @ np.concatenate([x[mine], z])) ** 2)
                rest = np.sum((share.shared.factors[j] @ z) ** 2)
                # The own rows can be explained away for every shared parameter.
                np.testing.assert_allclose(own + rest, whole, rtol=1e-10)
                A = share.own[j][:, : len(mine)]
                assert np.linalg.matrix_rank(A) == len(A)


def test_scores_are_those_of_the_rows_without_own_columns(model):
    rng = np.random.default_rng(1)
    _, regression = _robot(model, rng)
    fleet = fleet_model(model)
    share = robot_share("a", fleet, regression)
    for j, mine in enumerate(fleet.own):
        # Scores Y_s'^T e = Y_s^T e - C^T Y_o^T e have the covariance that follows.
        R = regression.factors[j]
        C = np.linalg.lstsq(R[:, mine], R[:, fleet.common], rcond=None)[0]
        T = np.zeros((len(model.layout), len(fleet.common)))
        T[fleet.common, range(len(fleet.common))] = 1.0
        T[mine] = -C
        N, S = regression.noise.scores[j], share.shared.noise.scores[j]
        expected = T.T @ N.T @ N @ T
        np.testing.assert_allclose(S.T @ S, expected, atol=1e-9 * abs(expected).max())


@pytest.mark.slow
def test_own_parameters_are_the_bounded_least_squares():
    rng = np.random.default_rng(2)
    reached = set()
    for _ in range(200):
        A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 4))
        t, x = rng.normal(size=3), rng.normal(size=4)
        limits = OwnSet(
            np.zeros((0, 3)),
            np.zeros(0),
            np.vstack([-np.eye(3)[:2], np.eye(3)[2]]),
            np.array([0.0, 0.0, 0.7]),
        )
        found = own_fit(np.column_stack([A, B, t]), x, limits)
        box = ([0.0, 0.0, -np.inf], [np.inf, np.inf, 0.7])
        known = lsq_linear(A, t - B @ x, box, tol=1e-14, method="bvls")
        np.testing.assert_allclose(found.values, known.x, atol=1e-8)
        reached.add(found.bound)
    assert len(reached) == 8  # every set of bounds was met


def test_errors_of_stribeck_velocities_stay_with_a_robots_share(tmp_path):
    drive = ci.DriveTerms(
        viscous=True, coulomb="sign", stribeck_velocity=0.5, offset=True
    )
    model = ci.TorqueModel(arm(2), drive)
    fleet, rng = fleet_model(model), np.random.default_rng(2)
    x = np.append(np.ravel(model.robot.nominal), rng.uniform(0.5, 1.0, 8))
    q, dq, ddq = rng.normal(size=(3, 800, 2))
    motion = ci.Recording(model.robot.joint_names, np.arange(800) / 100, q, dq, ddq)
    log = ci.simulate_torque(model, x, motion, noise=0.2, rng=rng)
    regression = ci.build_regression(model, log)
    share = robot_share("a", fleet, regression)
    for j, mine in enumerate(fleet.own):
        A, N = regression.factors[j], regression.noise.shapes[j]
        C = np.linalg.lstsq(A[:, mine], A[:, fleet.common], rcond=None)[0]
        expected = N[:, fleet.common] - N[:, mine] @ C
        found = share.shared.noise.shapes[j]
        assert len(found) == 2 and found.any()
        np.testing.assert_allclose(found, expected, atol=1e-9 * abs(N).max())
    write_share(tmp_path / "a.npz", share)
    again = read_share(tmp_path / "a.npz", fleet)
    for one, other in zip(again.noise.shapes, share.shared.noise.shapes, strict=True):
        np.testing.assert_array_equal(one, other)


def _misfit(regressions, sigmas, parameters):
    """Sum of squares of all robots, rows divided by their noise."""
    return sum(
        np.sum((F / s @ np.append(x, -1.0)) ** 2)
        for name, x in parameters.items()
        for F, s in zip(regressions[name].factors, sigmas[name], strict=True)
    )


@pytest.mark.slow
def test_the_answer_is_the_optimum_of_all_robots_together(model, tmp_path):
    rng = np.random.default_rng(3)
    regressions = {
        name: _robot(model, rng, smooth=name in "bc", samples=300)[1] for name in "abcd"
    }
    sigmas = {n: joint_noise(model, r) for n, r in regressions.items()}
    constraints = (
        *CONSTRAINTS,
        ci.constraints.FixedParameters({"joint1.coulomb": 0.5}),
        ci.constraints.ParameterBounds({"joint2.offset": (-0.05, 0.05)}),
    )
    fleet = fleet_model(model)
    limits = own_sets(fleet, lowered(constraints, model))
    base, robots = base_parameters(fleet.shared), []
    for name, regression in regressions.items():
        share = robot_share(name, fleet, regression)
        file = tmp_path / f"{name}.npz"
        write_share(file, share)
        again = read_share(file, fleet)
        np.testing.assert_array_equal(again.stacked(), share.shared.stacked())
        robots.append(
            StoredRobot(name, file, share.own, share.shared.sigma, 1.0, 1.0, 1)
        )
    kept = shared_constraints(fleet, constraints)

    def solved(regression):
        found = best_fit(fleet.shared, regression, kept, base=base)
        return SimpleNamespace(parameters=found.parameters)

    found = settle(fleet, robots, limits, solved)
    bodies = found.bodies
    own = {r.name: own_fits(r, bodies.parameters, limits) for r in robots}
    assert found.settled and any(fit.bound for fits in own.values() for fit in fits)
    parameters = {
        name: fleet.parameters(bodies.parameters, [fit.values for fit in fits])
        for name, fits in own.items()
    }
    ours = _misfit(regressions, sigmas, parameters)

    # The same by one programme with every robot's friction in it.
    size, n = len(model.layout), len(fleet.common)
    mine = np.concatenate(fleet.own)
    whole = lowered(constraints, model)
    rows, rules = [], []
    total = n + len(regressions) * len(mine)
    for k, (name, regression) in enumerate(regressions.items()):
        place = n + k * len(mine)
        T = np.zeros((size, total))
        T[fleet.common, range(n)] = 1.0
        T[mine, range(place, place + len(mine))] = 1.0
        rows += [
            np.column_stack([F[:, :-1] @ T, F[:, -1]]) / s
            for F, s in zip(regression.factors, sigmas[name], strict=True)
        ]
        rules.append(T)
    R = np.linalg.qr(np.vstack(rows), mode="r")
    norms = np.linalg.norm(R[:, :-1], axis=0)
    unit = 1.0 / np.where(norms > 1e-9 * norms.max(), norms, norms.max())
    v = cp.Variable(total)
    size = np.linalg.norm(R[:, -1])
    x = cp.multiply(unit, v) * size
    within = [
        rule
        for T in rules
        for rule in (whole.A_in @ T @ x <= whole.b_in, whole.A_eq @ T @ x == whole.b_eq)
    ]
    for block in whole.blocks:
        F = block.coefficients[fleet.common]
        J = sum(x[i] * F[i] for i in range(n)) + block.constant
        within.append(cp.diag(1 / block.scale) @ J @ cp.diag(1 / block.scale) >> 0)
    problem = cp.Problem(
        cp.Minimize(cp.norm(R[:, :-1] * unit @ v - R[:, -1] / size)), within
    )
    problem.solve(cp.CLARABEL)
    assert ours == pytest.approx((problem.value * size) ** 2, rel=1e-5)


@pytest.mark.slow
def test_outliers_are_named_and_bodies_recovered(model):
    rng = np.random.default_rng(4)
    made = {
        f"r{k}": _robot(model, rng, heavier=0.3 if k in (3, 7) else 0.0)
        for k in range(12)
    }
    regressions = {name: regression for name, (_, regression) in made.items()}
    fleet = ci.fleet.fleet_estimate(model, regressions, constraints=CONSTRAINTS)
    assert_reached("tests/fleet/test_fleet.py", fleet)
    assert fleet.outliers == ("r3", "r7") and fleet.settled
    assert fleet.bodies.verdict.usable and "r3" in fleet.table().text()
    truth = np.append(np.ravel(model.robot.nominal), [0.3, 0.3])
    exact = fleet.bodies.base.projection @ truth
    values = fleet.bodies.base_values
    # Ten robots of 1500 samples: errors are some thousandths.
    assert np.linalg.norm(values - exact) < 5e-3 * np.linalg.norm(exact)
    for name, (x, _) in made.items():
        if name not in fleet.outliers:
            assert abs(fleet[name].parameters[20:] - x[20:]).max() < 0.05
            assert fleet[name].misfit < 1.02 * fleet[name].alone
    # Alone, a robot's are three times as far off.
    one = ci.constrained_least_squares(
        model, regressions["r0"], constraints=CONSTRAINTS
    )
    P = fleet.bodies.base.projection
    index = [model.layout.index(name) for name in fleet.bodies.model.layout.names]
    alone = P @ one.parameters[index]
    assert np.linalg.norm(alone - exact) > 2 * np.linalg.norm(values - exact)


def test_what_does_not_make_a_fleet_is_refused(model):
    bare = ci.TorqueModel(arm(2), ci.DriveTerms(rotor_inertia=True))
    with pytest.raises(ProblemError, match="no friction or offset"):
        fleet_model(bare)
    relation = ci.constraints.LinearRelation(
        {"joint1.viscous": 1.0, "joint2.viscous": -1.0}, 0, 0
    )
    with pytest.raises(ProblemError, match=r"relates friction or offsets"):
        own_sets(fleet_model(model), lowered([relation], model))
    with pytest.raises(ProblemError, match="no robot"):
        ci.fleet.fleet_estimate(model, {})
    with pytest.raises(ProblemError, match="no robot"):
        ci.fleet.identify_fleet([])


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Problem files of five robots, one of which carries something."""
    return write_robots(tmp_path_factory.mktemp("fleet"))


@pytest.mark.slow
def test_the_shell_names_the_robot_that_carries_something(folders, tmp_path, capsys):
    pattern = str(folders / "robot*" / "problem.toml")
    code = main(["fleet", pattern, "--output", str(tmp_path), "--json"])
    printed = capsys.readouterr()
    record = parsed(printed.out)
    assert "0/5 problem files" in printed.err and "0/5 robots" in printed.err
    assert record["outliers"] == ["robot2"] and code in (0, 1)
    assert sorted(record["robots"]) == [f"robot{k}" for k in range(5)]
    written = {file.name for file in tmp_path.iterdir()}
    assert written == {"fleet.md", "fleet.json", "bodies.json"}
    assert json.loads((tmp_path / "fleet.json").read_text())["robots"]
    viscous = [robot["parameters"] for robot in record["robots"].values()]
    assert [p["shoulder.viscous"] for p in viscous] == pytest.approx([2.0] * 5, abs=0.1)
    assert main(["fleet", pattern, "--output", str(tmp_path)]) == code  # over its own
    assert "robot2" in capsys.readouterr().out


@pytest.mark.slow
def test_logs_that_cannot_be_streamed_are_read_whole(folders):
    problems = [ci.load_problem(folders / f"robot{k}") for k in range(5)]
    text = (folders / "robot1" / "problem.toml").read_text()
    log = np.genfromtxt(folders / "robot1" / "log.csv", delimiter=",", names=True)
    np.savez(folders / "robot1" / "log.npz", **{n: log[n] for n in log.dtype.names})
    (folders / "robot1" / "whole.toml").write_text(text.replace("log.csv", "log.npz"))
    streamed = ci.fleet.identify_fleet(problems)
    problems[1] = ci.load_problem(folders / "robot1" / "whole.toml")
    mixed = ci.fleet.identify_fleet(problems)
    np.testing.assert_allclose(
        mixed.bodies.base_values, streamed.bodies.base_values, rtol=1e-6, atol=1e-8
    )
    assert mixed.outliers == streamed.outliers


@pytest.mark.slow
def test_a_file_says_what_its_robot_carries(folders, tmp_path, capsys):
    text = (folders / "robot2" / "problem.toml").read_text()
    told = folders / "robot2" / "loaded.toml"
    told.write_text(text + '[payload]\nlink = "fore"\nmass_bounds = [0.0, 2.0]\n')
    others = [str(folders / f"robot{k}" / "problem.toml") for k in (0, 1, 3, 4)]
    main(["fleet", *others, str(told), "--output", str(tmp_path), "--json"])
    record = json.loads(capsys.readouterr().out)
    found = record["robots"]["robot2"]["payload"]
    assert record["outliers"] == [] and found["optimum"] == "certified"
    for name, value in (("m", 0.5), ("hx", 0.15), ("hy", 0.05)):  # at (0.3, 0.1, 0)
        error = found["standard_errors"][name]
        assert abs(found["parameters"][name] - value) < 3 * error < 0.05
    assert "Payloads of the robots" in (tmp_path / "fleet.md").read_text()
    # A robot by itself: link and load are one body, of no known mass.
    sheets = {
        link.name: link.datasheet for link in ci.load_problem(told).model.robot.links
    }
    assert sheets["fore"].mass is None and sheets["upper"].mass == 4.0
    assert main(["fleet", str(told)]) == 2
    assert "every robot has a payload" in capsys.readouterr().err


@pytest.mark.slow
def test_robots_of_two_types_are_refused(folders, tmp_path, capsys):
    other = folders / "robot1" / "other.toml"
    other.write_text(FILE.format(name="other", rotor="true"))
    assert main(["fleet", str(folders / "robot0"), str(other)]) == 2
    assert "another model" in capsys.readouterr().err
    same = str(folders / "robot0" / "problem.toml")
    assert main(["fleet", same, str(tmp_path / "none*")]) == 2
    assert "no such file" in capsys.readouterr().err


@pytest.mark.slow
def test_the_shell_compresses_recordings(folders, tmp_path, capsys):
    file = tmp_path / "regression.json"
    problem = folders / "robot0"
    assert main(["compress", str(problem), "--output", str(file)]) == 0
    assert "shoulder" in capsys.readouterr().out
    loaded = ci.regression.load_regression(file)
    whole = ci.fleet.stream_regression(ci.load_problem(problem))
    np.testing.assert_array_equal(loaded.stacked(), whole.stacked())
    assert main(["compress", str(problem), "--output", str(file)]) == 0
