"""Comparisons: errors by hand, mass matrices of Pinocchio, verdicts, tables."""

import re
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from robots import random_robot, random_states

from consistent_id import (
    DHRow,
    DriveTerms,
    ProblemError,
    Recording,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    from_modified_dh,
    least_squares,
    simulate_torque,
)
from consistent_id._support.tables import Table
from consistent_id.comparison import comparison, feasibility
from consistent_id.comparison.comparison import verdict_table
from consistent_id.comparison.feasibility import base_feasibility, in_words
from consistent_id.constraints import PhysicalConsistency
from consistent_id.constraints.cones.certificate import ball_about, certify
from consistent_id.constraints.cones.least_norm import solve_least_norm
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.estimation.estimate import torque_errors
from consistent_id.regression import base_parameters
from consistent_id.regression.row_structure import random_rows
from consistent_id.report.summary import comparison_tables
from consistent_id.robot.inertia import InertialParameters


def _estimates(seed=0, noise=4.0):
    rng = np.random.default_rng(seed)
    reference, robot = random_robot(rng, 3)
    model = TorqueModel(robot, DriveTerms(rotor_inertia=True))
    truth = np.concatenate([robot.nominal, [0.2, 0.3, 0.4]])
    logs = []
    for _ in range(2):
        states = random_states(rng, 3, 300)
        motion = Recording(robot.joint_names, np.arange(300) / 100, *states)
        logs.append(simulate_torque(model, truth, motion, noise=noise, rng=rng))
    regression = build_regression(model, logs[0])
    plain = least_squares(model, regression)
    bodily = constrained_least_squares(model, regression)
    return reference, model, truth, logs, (plain, bodily)


def test_errors_are_those_computed_by_hand():
    _, _, _, logs, (plain, _) = _estimates()
    (error,) = torque_errors([plain], logs[1])
    rest = logs[1].torque - plain.predict(logs[1])
    assert np.allclose(error.mse, np.mean(rest**2, axis=0))
    assert np.allclose(error.rms, np.sqrt(error.mse))
    assert error.stacked == pytest.approx(
        np.sqrt(np.sum(rest**2) / np.sum(logs[1].torque ** 2))
    )
    # All joints move, so that nothing is held by friction.
    np.testing.assert_array_equal(error.beyond, error.rms)
    assert error.stacked_beyond == error.stacked
    assert np.allclose(
        error.relative, error.rms / np.sqrt(np.mean(logs[1].torque ** 2, axis=0))
    )


@pytest.mark.slow
def test_the_constrained_robot_is_consistent_and_its_mass_matrix_positive():
    _, _, _, logs, estimates = _estimates()
    comparison = compare(estimates, [logs[1]], training=[logs[0]])
    bodily = comparison["constrained"]
    assert bodily.estimate.certificate.verdict == "certified"
    assert all(bodily.consistent_links)
    assert bodily.least_mass_eigenvalue > 0.0
    assert bodily.base_feasibility.answer == "consistent"


@pytest.mark.slow
def test_consistent_links_are_counted_by_their_pseudo_inertia():
    comparison, expected = _with_one_impossible_link(), []
    for report in comparison.reports:
        least = [
            np.linalg.eigvalsh(InertialParameters(x).pseudo_inertia)[0]
            for x in report.estimate.links
        ]
        expected.append(f"{sum(value >= -1e-9 for value in least)} of 3")
    table = verdict_table(comparison)
    column = table.header.index("consistent links")
    assert [row[column] for row in table.rows] == expected
    assert expected[-2:] == ["3 of 3", "2 of 3"]


@pytest.mark.slow
def test_what_base_parameters_rule_out_has_other_words():
    comparison = _with_one_impossible_link()
    (table,) = (t for t in comparison_tables(comparison) if "Physical" in t.title)
    assert not any("consistent links" in name for name in table.header)
    column = table.header.index("links that base parameters rule out")
    assert table.rows[-1][column] == "1 of 3"


def _with_one_impossible_link():
    _, _, truth, logs, estimates = _estimates()
    impossible = truth.copy()
    impossible[20:30] *= -1.0  # the last link has negative mass and inertia
    anti = replace(estimates[0], parameters=impossible, method="anti-body")
    return compare([*estimates, anti], [logs[1]])


@pytest.mark.slow
def test_base_parameters_of_no_body_are_refused_however_well_they_fit():
    _, _, truth, logs, (plain, _) = _estimates()
    impossible = truth.copy()
    impossible[20:30] *= -1.0  # the last link has negative mass and inertia
    anti = replace(plain, parameters=impossible, method="anti-body")
    (report,) = compare([anti], [logs[1]]).reports
    assert report.estimate.certificate.verdict == "certified"
    assert report.verdict.word == "do not use"
    assert "impossible robot" in [r.kind for r in report.verdict.grounds]
    assert "j2" in report.base_feasibility.summary
    assert report.possible_links == (True, True, False)


@pytest.mark.slow
def test_the_distance_to_nominal_is_that_of_pseudo_inertias():
    """Half as much again in all four directions is ``||I / 2||``."""
    _, _, truth, logs, (plain, _) = _estimates()
    x = truth.copy()
    x[10:20] *= 1.5
    (report,) = compare([replace(plain, parameters=x)], [logs[1]]).reports
    assert report.distance_to_nominal == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)


@pytest.mark.slow
def test_comparing_nothing_or_different_models_is_refused():
    _, _, _, logs, (plain, _) = _estimates()
    with pytest.raises(ProblemError, match="no estimate"):
        compare([], logs)
    rng = np.random.default_rng(5)
    _, robot = random_robot(rng, 3)
    model = TorqueModel(robot)
    states = random_states(rng, 3, 100)
    log = Recording(robot.joint_names, np.arange(100) / 100, *states)
    other = simulate_torque(model, robot.nominal, log)
    foreign = least_squares(model, build_regression(model, other))
    with pytest.raises(ProblemError, match="different parameters"):
        compare([plain, foreign], logs)
    with pytest.raises(ProblemError, match="there are: least squares"):
        compare([plain], logs)["constrained"]


@pytest.mark.parametrize(
    ("vector", "words"),
    [
        ([-1.0, 0, 0, 0, 1, 0, 1, 0, 0, 1], "mass -1 kg is not positive"),
        ([1.0, 0, 0, 0, 1, 0, 1, 0, 0, -2], "least moment of inertia, -2 kg m^2, is"),
        ([1.0, 0, 0, 0, 0.5, 0, 0.1, 0, 0, 0.1], "0.5 kg m^2 about [1. 0. 0.] exceeds"),
        ([1.0, 0, 0, 0, 5, 0, 1, 0, 0, 1], "exceeds the sum of the other two, 2, by 3"),
        ([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 1], "physically consistent"),
        ([0.0, 0, 0, 0, 1, 0, 1, 0, 0, 1], "mass 0 kg is not positive"),
        ([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 2], "physically consistent"),  # flat
        ([1.0, 0, 0, 0, 0, 0, 1, 0, 0, 1], "physically consistent"),  # a rod
    ],
)
def test_violations_are_said_in_words(vector, words):
    assert words in in_words(np.array(vector, dtype=float))


def test_the_link_that_cannot_be_consistent_is_named_and_no_other():
    # Two pendulums, one on the other: Izz of the second is a base parameter itself.
    robot = from_modified_dh("arm", [DHRow(-np.pi / 2, 0.0), DHRow(0.0, 0.5)])
    model = TorqueModel(robot)
    base = base_parameters(model)
    ball = InertialParameters.from_central(2.0, [0.3, 0.0, 0.0], 0.01 * np.eye(3))
    values = base.projection @ np.tile(ball.vector, 2)
    assert base_feasibility(model, base, values).answer == "consistent"
    values[base.names.index("link2.Izz")] = -0.1
    found = base_feasibility(model, base, values)
    assert found.answer == "impossible"
    (violation,) = found.violations
    assert violation.link == "link2" and violation.margin < 0.0
    # The moment itself, less a hundredth for the sake of shorter numbers.
    least = re.search("link2: the least moment of inertia, ([-.0-9]+)", found.summary)
    assert float(least[1]) == pytest.approx(-0.1, rel=0.02)


def test_no_link_is_named_where_only_all_together_are_impossible():
    robot = from_modified_dh("arm", [DHRow(-np.pi / 2, 0.0), DHRow(0.0, 0.5)])
    model = TorqueModel(robot)
    base = base_parameters(model)
    # All mass of the second link is on its joint's axis: it has no thickness.
    values = np.zeros(len(base))
    assert base_feasibility(model, base, values).answer == "consistent"
    # The first one's moment, and the second's mass, may each be less than nothing.
    values[base.names.index("link1.Izz")] = -0.1
    found = base_feasibility(model, base, values)
    assert found.answer == "impossible" and found.violations == ()
    assert "link1.Izz + 0.25 link2.m contradict each other" in found.summary


@pytest.mark.parametrize(("bound", "named"), [(-9e-10, ()), (-2e-9, ("link2",))])
def test_a_link_is_named_if_its_own_proof_is_beyond_rounding(monkeypatch, bound, named):
    model, base, values = _without_inertia(0.1)

    def found(domain):
        alone = find_interior(domain)
        last = [block.label for block in domain.blocks] == ["link2"]
        return replace(alone, bound=bound) if last else alone

    find_interior = feasibility.find_interior
    monkeypatch.setattr(feasibility, "find_interior", found)
    violations = base_feasibility(model, base, values).violations
    assert tuple(violation.link for violation in violations) == named


@pytest.mark.parametrize(("farther", "nearest"), [(3e-13, True), (3e-12, False)])
def test_the_nearest_robot_is_proven_to_a_part_of_a_thousandth_of_the_torque(
    monkeypatch, farther, nearest
):
    """A square of a millionth, of which a millionth is allowed: a square of 1e-12."""
    model, base, values = _without_inertia(1e-5)
    best = base_feasibility(model, base, values).nearest
    assert best.verdict == "certified" and best.torque_change < 1e-4

    def beside(problem, centre, *, reference):
        solution = solve_least_norm(problem)
        rest, step = problem.G @ solution.u - problem.g, centre - solution.u
        moved = problem.G @ step
        share = np.roots([moved @ moved, 2.0 * moved @ rest, -farther]).max()
        u = solution.u + share * step
        wrong = replace(solution, u=u)
        return wrong, certify(problem, wrong, ball_about(centre), reference=reference)

    monkeypatch.setattr(feasibility, "solve_certified", beside)
    found = base_feasibility(model, base, values).nearest
    assert (found.verdict == "certified") == nearest


def test_the_nearest_robots_change_is_that_of_torque_along_random_motions():
    _, model, truth, _, (plain, _) = _estimates()
    x = truth.copy()
    x[20:30] *= -1.0
    values = plain.base.projection @ x
    nearest = base_feasibility(model, plain.base, values).nearest
    R = random_rows(model).stacked()
    change = np.linalg.norm(R @ (nearest.parameters - x)) / np.linalg.norm(R @ x)
    assert nearest.torque_change == pytest.approx(change, rel=1e-6)
    assert 0.01 < change < np.linalg.norm(R @ (truth - x)) / np.linalg.norm(R @ x)


def test_of_no_torque_no_robot_is_the_nearest():
    model, base, values = _without_inertia(0.0)
    thick = [PhysicalConsistency(margin=0.01)]
    found = base_feasibility(model, base, 0.0 * values, constraints=thick)
    assert found.answer == "impossible" and found.nearest is None


def test_a_witness_is_the_answer_if_it_has_the_base_parameters():
    model, base, values = _without_inertia(-0.3)
    x = base.lift(values)
    x[[6, 9, 16]] += 1.0  # of what no torque depends on, or both links' together
    values = base.projection @ x
    free = base_feasibility(model, base, values, constraints=(), witness=x)
    assert (free.answer, free.proof.margin) == ("consistent", 1.0)
    np.testing.assert_allclose(free.parameters, x, rtol=1e-12)
    values[0] += 1e-6
    other = base_feasibility(model, base, values, constraints=(), witness=x)
    assert other.answer == "consistent"
    assert base.projection @ other.parameters == pytest.approx(values, abs=1e-9)


@pytest.mark.parametrize(("value", "missed"), [(5.0, 0.1), (0.5, 0.4), (0.0, 0.6)])
def test_what_equalities_miss_is_relative_to_their_values(value, missed):
    domain = ConicSet.equal(np.eye(2), np.array([0.0, -value]), ("a", "b"))
    found = feasibility._relative_miss(domain, np.array([0.0, 0.6 - value]))
    assert found == pytest.approx(missed, rel=1e-12)


def _without_inertia(moment):
    """Two pendulums, the second of which has a moment less than nothing."""
    robot = from_modified_dh("arm", [DHRow(-np.pi / 2, 0.0), DHRow(0.0, 0.5)])
    model = TorqueModel(robot)
    base = base_parameters(model)
    values = np.zeros(len(base))
    values[base.names.index("link1.Izz")] = 1.0
    values[base.names.index("link2.Izz")] = -moment
    return model, base, values


def test_tables_align_numbers_and_escape_bars_in_markdown():
    table = Table("T", ("name", "value"), (("a|b", "1.5"), ("c", "-20")))
    assert table.text().splitlines() == [
        "T",
        "  name  value",
        "  a|b     1.5",
        "  c       -20",
    ]
    assert "| a\\|b | 1.5 |" in table.markdown()
    assert "| --- | ---: |" in table.markdown()


@pytest.mark.slow
def test_the_comparison_table_has_a_row_per_estimate_and_recording():
    _, _, _, logs, estimates = _estimates()
    tables = comparison_tables(compare(estimates, logs))
    assert [len(t.rows) for t in tables[:5]] == [2] * 5  # RMS and MSE twice, bodies
    assert tables[0].rows[1][0] == "constrained"


def test_joints_that_turn_and_slide_are_not_added_in_one_error():
    # A sliding joint of 1000 N that is exact, a turning one of 1 N m that is not.
    rows = [DHRow(0, 0, kind="prismatic"), DHRow(np.pi / 2, 0)]
    model = TorqueModel(from_modified_dh("arm", rows), DriveTerms(offset=True))
    x = np.zeros(len(model.layout))
    x[model.layout.index("joint1.offset")] = 1000.0
    x[model.layout.index("joint2.offset")] = 0.8
    still, time = np.zeros((10, 2)), np.arange(10) / 10.0
    torque = np.tile([1000.0, 1.0], (10, 1))
    log = Recording(model.robot.joint_names, time, still, still, still, torque)
    estimate = replace(least_squares(model, build_regression(model, log)), parameters=x)
    (error,) = torque_errors([estimate], log)
    assert error.relative == pytest.approx([0.0, 0.2])
    assert error.stacked == pytest.approx(np.sqrt((0.0**2 + 0.2**2) / 2.0))


@pytest.mark.parametrize(
    ("method", "answer", "tested"),
    [
        ("least squares", "impossible", True),
        ("least squares", "consistent", False),
        ("constrained", "impossible", False),
    ],
)
def test_data_are_tested_where_least_squares_is_impossible(
    monkeypatch, method, answer, tested
):
    @dataclass
    class Report:
        estimate: object
        base_feasibility: object
        consistency: object = None

    test = SimpleNamespace()
    monkeypatch.setattr(comparison, "_UNCONSTRAINED", ("least squares",))
    monkeypatch.setattr(
        comparison, "consistency_test", lambda model, regression, base: test
    )
    estimate = SimpleNamespace(method=method, model=None, base=None)
    reports = [Report(estimate, SimpleNamespace(answer=answer))]
    (found,) = comparison._tested(reports, None)
    assert found.consistency is (test if tested else None)
