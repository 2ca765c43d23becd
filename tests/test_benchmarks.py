"""The benchmarks run, and both ways that they time give the same answer."""

import ast
import importlib
import importlib.util
import os
import random
import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import ANY

import msgspec
import numpy as np
import pytest
from experiments import experiment
from logged import write_arm

import consistent_id as ci


def _benchmark(name):
    path = Path(__file__).parent.parent / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_our_way_and_the_stacked_way_leave_the_same_residual():
    speed = _benchmark("speed")
    model = speed.arm()
    data = speed.log(model, 3000)
    # One compresses by QR, the other stacks and solves by SVD.
    assert speed.ours(model, data)["residual"] == pytest.approx(
        speed.stacked(model, data)["residual"], rel=1e-9
    )


@pytest.mark.slow
def test_the_stacked_error_comes_out_of_compressed_recordings():
    speed = _benchmark("speed")
    model = speed.arm()
    log = speed.log(model, 3000)
    halves = [log.samples(slice(0, 1000)), log.samples(slice(1000, 3000))]
    regressions = [ci.build_regression(model, half) for half in halves]
    fits = [ci.least_squares(model, r) for r in reversed(regressions)]
    missed = np.vstack(
        [h.torque - f.predict(h) for h, f in zip(halves, fits, strict=True)]
    )
    error = _benchmark("pairs").stacked_error(regressions, [f.parameters for f in fits])
    direct = np.linalg.norm(missed) / np.linalg.norm(log.torque)
    assert error == pytest.approx(direct, rel=1e-9)


@pytest.mark.slow
def test_the_table_of_the_constrained_solve_can_be_made():
    table = _benchmark("speed").solve_table(1, samples=2000, replicates=4)
    assert "Clarabel" in table
    assert "certified" in table


@pytest.mark.slow
def test_random_problems_are_certified_or_rightly_refused():
    robustness = _benchmark("robustness")
    for seed in (20, 21, 22):
        result = robustness.run(robustness.case(seed))
        assert not result.wrong
        assert result.verdict == ("refused" if seed % 20 == 0 else "certified")


@pytest.mark.slow
def test_the_series_beats_the_filter_on_periodic_motion():
    differentiation = _benchmark("differentiation")
    motion, encoder = next(iter(differentiation.MOTIONS)), differentiation.ENCODERS[2]

    def acceleration(method):
        cell = differentiation.cell(motion, method, encoder)
        return float(cell.split("/")[1].rstrip("%"))

    series = acceleration("Fourier, period known")
    assert series < 0.1 * acceleration("Butterworth, best of 11 cut-offs*")


def test_the_table_of_repaired_robots_can_be_made(tmp_path):
    pytest.importorskip("mujoco")
    from robots import URDF

    repair = _benchmark("repair")
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.replace('izz="0.025"', 'izz="0.09"', 1))
    done = repair.repair_urdf(path)
    before, after = repair.refused(done.original), repair.refused(done.content)
    assert (before, after) == (1, 0)
    table = repair.page([repair.Case("robot.urdf", done, before, after, 0)])
    assert "| robot.urdf | 4 | 1 |" in table


@pytest.mark.slow
def test_the_wrist_draws_what_it_is_to_write():
    cases = _benchmark("excitation").cases
    robot = cases.rx60_problem().model.robot
    path = cases.writing_tasks(10.0)["a circle"]
    middle = np.array([0.4, 0.05, 0.25])
    for q in path.evaluate([0.0, 3.0, 7.7])[0]:
        away = cases._wrist(robot, q) - middle
        # Twelve harmonics of the joints' motion leave a tenth of a millimetre.
        assert np.linalg.norm(away) == pytest.approx(cases.SIZE, abs=1e-4)
        assert away[2] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.slow
def test_random_paths_of_the_benchmark_use_all_of_the_limits():
    cases = _benchmark("excitation").cases
    case = cases.rx60()
    margins = cases.motion_margins(cases.random_path(case, 0), case.limits)
    assert margins.holds
    for joint in case.limits.joints:
        least = min(m.relative for m in margins.margins if m.joint == joint)
        assert least < 0.01


@pytest.mark.slow
def test_simulated_scatter_is_that_of_the_prediction():
    excitation = _benchmark("excitation")
    cases, case = excitation.cases, excitation.cases.rx60()
    path, noise = cases.random_path(case, 0), np.array([0.1, 0.2, 0.3])
    mine = excitation.montecarlo.scatter(case, path, path, noise)
    base = cases.ci.regression.base_parameters(case.model)
    aim = cases.Aim(noise=noise, rate=cases.RATE, correlation_time=0.0)
    accuracy = cases.predicted_accuracy(case.model, base, path, aim)
    expected = accuracy.standard_errors()
    # 500 draws know a standard deviation to 3 %.
    assert mine.errors == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
def test_rivals_are_measured_within_the_limits():
    rivals = _benchmark("excitation").rivals
    case = _benchmark("excitation").cases.rx60()
    judge = rivals.Judge(case, 60.0)
    path = 5.0 * judge.problem.random(0)
    inside = judge.problem.limits.within(path)
    expected = judge.problem.score("condition", inside)
    assert judge(path.ravel()) == pytest.approx(expected)
    assert judge.trace[-1][1] == pytest.approx(np.exp(expected))
    with pytest.raises(rivals.TimeIsUp):
        rivals.random_search(rivals.Judge(case, 0.2), 0)


@pytest.mark.slow
def test_every_mutant_is_python_with_one_line_changed():
    mutation = _benchmark("mutation")
    file = mutation.ROOT / "consistent_id" / "regression" / "correlated_noise.py"
    mutants = list(mutation.mutants_of(file, random.Random(0)))
    assert len(mutants) > 30
    for mutant in mutants:
        ast.parse(mutant.content)
        before, after = mutant.source.splitlines(), mutant.content.splitlines()
        pairs = zip(before, after, strict=True)
        changed = [new.strip().decode() for old, new in pairs if old != new]
        assert changed == [mutant.changed]


@pytest.mark.slow
def test_coverage_counts_every_method_and_sees_what_no_interval_can_hold():
    coverage = _benchmark("coverage")
    model, truth = coverage.arm(2)
    shares = {
        kind: coverage.covered(model, truth, kind, replicates=6, few=3)
        for kind in ("low-passed", "unmodelled friction")
    }
    for found in shares.values():
        assert set(found) == set(coverage.METHODS)
    # Six sets of 12 parameters, Huber's three: 95 % within three errors of 5 and 7 %.
    for method, least in zip(coverage.METHODS, (0.8, 0.8, 0.75, 0.75), strict=True):
        assert shares["low-passed"][method][0] > least
        assert shares["unmodelled friction"][method][0] < 0.8


@pytest.mark.slow
def test_intervals_hold_a_ur10_s_friction_where_its_torque_is_filtered():
    filtered = _benchmark("coverage_filtered")
    model, truth = filtered.ur10()
    z = np.array(list(filtered.scores(model, truth, "white", 2.0, replicates=6)))
    # Twelve friction parameters in six logs: 95 % within three errors of 2.6 %.  Rows
    # of filtered motion hold none of them.
    share, _ = filtered.held(z[:, filtered.of_friction(model)])
    assert share > 0.87
    assert filtered.held(z)[0] > 0.87


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "wrong"), [(2003, 0.3), (2009, 0.1), (2030, 0.0)])
def test_terms_that_others_hide_are_found(seed, wrong, monkeypatch):
    """Robots that had three false Stribeck terms, or up to five times the error."""
    monkeypatch.syspath_prepend(Path(__file__).parent.parent / "benchmarks")
    found = _benchmark("selection_terms").found(seed, plain=False)
    assert found.false == ()
    assert not {"drag", "spring", "stribeck_velocity"} & {t for _, t in found.missed}
    assert found.velocities == pytest.approx((1.0,) * len(found.velocities), abs=wrong)
    assert found.error < 1.1 * found.oracle


@pytest.mark.slow
def test_intervals_hold_friction_beside_wrong_stribeck_velocities():
    shares = _benchmark("coverage_stribeck").held(2, "white", replicates=8)
    with_errors, without = shares.mean(axis=0)
    assert with_errors > 0.85 and without < 0.8


def test_coverage_sees_intervals_that_have_nothing_in_common():
    robots = _benchmark("coverage_robots")
    a = np.array([[0.0, 1.0], [0.0, 1.0], [2.0, 2.0], [0.0, np.inf]])
    b = np.array([[0.5, 2.0], [1.5, 2.0], [3.0, 3.0], [5.0, 6.0]])
    compared, beyond = robots._apart(a, b)
    assert compared.tolist() == [True, True, False, False]
    assert beyond.tolist() == [False, True, False, False]


def test_the_command_that_a_message_prints_is_tried_with_what_the_user_knows():
    logs = _benchmark("public_logs")
    message = "consistent-id: no\ntry: consistent-id check a.urdf -x 'b c' -g KP,KD"
    known = logs.next_words(message, {"KP,KD": "20,1.5"})
    assert known == ["check", "a.urdf", "-x", "b c", "-g", "20,1.5"]
    assert logs.next_words(message, {}) is None
    assert logs.next_words("consistent-id: no", {}) is None


def test_tensors_are_written_as_they_are_read(tmp_path):
    from consistent_id.recordings.readers import pytorch

    position = np.arange(900.0).reshape(300, 3)
    _benchmark("public_logs").torch_file(tmp_path / "a.pt", {"dof_pos": position})
    read = pytorch.read_arrays(tmp_path / "a.pt", ["dof_pos"])["dof_pos"]
    np.testing.assert_array_equal(read, position)


def test_the_table_s_intervals_are_a_mean_s_and_its_error_the_score(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    table = _benchmark("table")
    x = np.random.default_rng(0).normal(size=table.BLOCKS)
    parts = np.column_stack([x, np.ones_like(x)])
    found = table.jackknife(parts, lambda sums: sums[0] / sums[1])
    assert found.value == pytest.approx(x.mean())
    # Student's 97.5 % quantile of nine degrees of freedom
    expected = 2.262157 * x.std(ddof=1) / np.sqrt(table.BLOCKS)
    assert found.half == pytest.approx(expected, rel=1e-5)
    words = [table.Interval(v, 1.0).word for v in (-2.0, 0.5, 2.0)]
    assert words == ["win", "alike", "**loss**"]
    model, _, log = experiment(2, joints=2, noise=0.3, samples=300)
    plain = table.ci.least_squares(model, table.ci.build_regression(model, log))
    (sums,) = table.torque_parts([plain], [log])
    assert len(sums) == table.BLOCKS
    stacked = plain.score(log).stacked
    assert table.relative_error(model, sums.sum(axis=0)) == pytest.approx(stacked)


def test_a_servo_in_the_table_has_its_own_verdict(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    table = importlib.import_module("table")
    joint = SimpleNamespace(
        chosen=SimpleNamespace(name="plain"), validation={"plain": {"a": 0.1, "b": 0.2}}
    )
    fit = SimpleNamespace(joints=[joint], verdict="use with care")
    monkeypatch.setattr(table, "identify_servos", lambda *_: fit)
    monkeypatch.setattr(table, "read_servo_logs", lambda files, _: files)
    entry = {"robot": "hand_made/servo_pendulum.urdf", "logs": ["a"]}
    entry |= {"name": "servo", "validate": ["a", "b"]}
    row = dict(zip(table.HEADER[:-1], table.servo_row(entry, table.HERE), strict=True))
    assert row["verdict"] == "use with care"
    assert row["recommended"].startswith("150.00 (")


@pytest.mark.slow
@pytest.mark.skipif("CONSISTENT_ID_DATASETS" not in os.environ, reason="no recordings")
def test_figures_of_the_person_on_force_plates_have_intervals(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    said = importlib.import_module("table").plates()
    found = re.findall(r"(\S+) \((-?[\d.]+) to (-?[\d.]+)\)", said)
    assert len(found) == 8  # least squares, the best, and two of three published
    for figure, low, high in found:
        assert float(low) < float(figure) < float(high)


OWN_LIST = """
[[robot]]
name = "servo"
servo = true
robot = "robot.urdf"
logs = ["log.csv"]

[[robot]]
name = "arm"
robot = "robot.urdf"
logs = ["log.csv"]
select = false
"""


@pytest.fixture
def rivals(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    return importlib.import_module("table_rivals")


@pytest.mark.slow
def test_rivals_are_those_of_a_list_and_what_is_left_out_is_said(
    rivals, tmp_path, capsys
):
    write_arm(tmp_path)
    (tmp_path / "arm.urdf").rename(tmp_path / "robot.urdf")
    entries = tomllib.loads(OWN_LIST)["robot"]
    (one,) = rivals.jobs(entries, tmp_path, None)
    assert (one.robot, one.tool) == ("servo", "BAM")
    assert capsys.readouterr().err == "arm: left out: no --figaroh\n"
    both = list(rivals.jobs(entries, tmp_path, "python"))
    assert [(job.robot, job.tool) for job in both] == [
        ("servo", "BAM"),
        ("arm", "FIGAROH"),
    ]
    with (tmp_path / "log.csv").open("a") as log:
        log.write("\n")
    after = list(rivals.jobs(entries, tmp_path, "python"))
    assert all(a.inputs != b.inputs for a, b in zip(both, after, strict=True))


@pytest.mark.slow
def test_rows_of_rivals_are_measured_once_for_the_same_inputs(rivals, tmp_path):
    measured = []

    def rows(alike):
        measured.append(1)
        alike.append(["alike"])
        yield ["row", str(len(measured))]

    job = rivals.Job("arm", "tool", "digest", rows)
    kept = rivals.Kept(tmp_path / "rows.jsonl")
    first = kept.done(job)
    assert kept.done(job) == first == ([["row", "1", ANY]], [["alike", ANY]])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d, [0-9a-f]{8}\+?", first[0][0][-1])
    changed = replace(job, inputs="other")
    assert kept.done(changed)[0][0][1] == "2"
    assert kept.done(job) == first
    assert rivals.Kept(None).done(job)[0][0][1] == "3"


@pytest.mark.slow
def test_a_delay_of_a_spoilt_torque_is_not_taken_out_of_other_logs(
    monkeypatch, tmp_path
):
    monkeypatch.syspath_prepend(Path(__file__).parent.parent / "benchmarks")
    faults_real = importlib.import_module("faults_real")
    urdf, log = write_arm(tmp_path)
    right = ci.draft_problem(urdf, log, select=False, cutoff=10.0).problem()
    data = right.table.data
    preparation = msgspec.structs.replace(data.preparation, delays={"torque": 0.1})
    data = msgspec.structs.replace(data, preparation=preparation)
    late = replace(right, table=msgspec.structs.replace(right.table, data=data))
    (own,) = (right.prepare(log) for log in right.logs("training"))
    (found,) = faults_real._prepared(right, late)
    assert np.array_equal(found.torque, own.torque)
    assert not np.array_equal(
        late.prepare(right.logs("training")[0]).torque, own.torque
    )
