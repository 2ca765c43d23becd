"""A study computes each of its parts once, whoever asks for it."""

import shutil
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from consistent_id import InfeasibleError, SolverError, load_problem
from consistent_id._support.run import Run, running
from consistent_id.cli import main
from consistent_id.diagnosis import Diagnosis, LogFinding
from consistent_id.estimation.method import Method
from consistent_id.problems import problem_estimates as estimates_module
from consistent_id.problems import study as study_module
from consistent_id.problems import study_fits as fits_module
from consistent_id.problems.log_check import check_problem
from consistent_id.problems.study import Study, _explain, run_study

PARTS = (
    "base_of_recordings",
    "check_published",
    "compare",
    "constraint_costs",
    "cross_validated",
    "huber_estimate",
    "published_least_squares",
    "recordings_of",
    "segments_of_problem",
    "shadow_prices",
)


@pytest.fixture
def calls(monkeypatch):
    counts = Counter()

    def counted(name, work):
        def run(*args, **options):
            counts[name] += 1
            return work(*args, **options)

        return run

    single = ("regression_of", "constrained_least_squares", "constrained_estimate")
    for name in (*PARTS, *single):
        users = [
            m for m in (study_module, fits_module, estimates_module) if hasattr(m, name)
        ]
        assert users
        for module in users:
            work = getattr(module, name)
            monkeypatch.setattr(module, name, counted(name, work))
    return counts


@pytest.mark.slow
def test_each_part_is_computed_once(calls):
    study = run_study(load_problem("problems/rx60"))
    for part in ("published", "excitation", "comparison", "costs", "prices", "path"):
        assert getattr(study, part) is getattr(study, part)
    assert study.constrained in study.estimates
    assert {name: calls[name] for name in PARTS} == dict.fromkeys(PARTS, 1)
    # Of the fit to all data alone: the sum of the segments is the training data's.
    assert calls["regression_of"] == 1
    assert calls["constrained_estimate"] == 4


@pytest.mark.slow
def test_a_study_needs_no_fit_to_all_data_until_it_is_delivered(monkeypatch):
    def refused(*_):
        raise SolverError("no optimum")

    monkeypatch.setattr(study_module, "refitted", refused)
    study = run_study(load_problem("problems/rx60"), costs=False)
    assert study.verdict.usable
    with pytest.raises(SolverError, match="no optimum"):
        _ = study.delivered


@pytest.mark.slow
def test_the_constrained_estimate_alone_needs_no_other(calls):
    study = Study(load_problem("problems/rx60"))
    assert study.constrained.method == Method.CONSTRAINED
    assert study.constrained is study.constrained
    assert calls["constrained_least_squares"] == 1
    assert calls["compare"] == calls["cross_validated"] == calls["huber_estimate"] == 0


@pytest.mark.slow
def test_recordings_that_are_given_are_estimated_from_as_the_problems_own():
    problem = load_problem("problems/rx60")
    study = Study(problem)
    paper, *own = study.estimates
    assert paper.method == Method.AS_PUBLISHED
    given = Study(problem, recordings=(study.training, ()))
    _, *alone = given.estimates
    assert [e.method for e in own] == [e.method for e in alone]
    for mine, other in zip(own, alone, strict=True):
        assert mine.parameters.tolist() == other.parameters.tolist()


@pytest.mark.slow
def test_a_study_draws_torque_and_parameters_that_it_holds():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    pyplot.close("all")
    study = Study(load_problem("problems/rx60"))
    rows = study.problem.model.torque_joints
    figure, given = pyplot.subplots(len(rows))
    axes = study.plot_torque(axes=given)
    assert list(axes) == list(given)
    log, best = study.validation[0], study.recommendation.method
    for j, axis in enumerate(axes):
        lines = {line.get_label(): line.get_ydata() for line in axis.get_lines()}
        assert list(lines) == ["measured", "least squares", best]
        np.testing.assert_array_equal(lines["measured"], log.torque[:, j])
        for method in ("least squares", best):
            predicted = study.estimate(method).predict(log)[:, j]
            np.testing.assert_array_equal(lines[method], predicted)
    found = study.delivered
    name = found.model.layout.names[int(np.nanargmin(found.parameter_errors))]
    (axis,) = study.plot_parameters([name], axes=figure.add_subplot())
    (dots,) = axis.containers
    assert dots.lines[0].get_xdata() == [found[name]]
    assert pyplot.get_fignums() == [figure.number]  # none but the one given
    pyplot.close("all")


@pytest.fixture
def without_an_estimate(tmp_path):
    """The KUKA's problem with a contradiction, and positions in counts of encoders."""
    folder = tmp_path / "kuka"
    shutil.copytree("problems/kuka_kr300", folder)
    for file in folder.glob("*.csv"):
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        table[:, 1:13] = np.round(table[:, 1:13] / (2.0 * np.pi) * 4096.0)
        header = file.read_text().partition("\n")[0]
        np.savetxt(file, table, delimiter=",", header=header, comments="")
    problem = folder / "problem.toml"
    masses = 'masses = "datasheet"\n'
    text = problem.read_text().replace(masses, f"{masses}total_mass = [1.0, 2.0]\n")
    problem.write_text(text)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("run", [Run(), Run(beside=True)])
def test_an_estimate_that_fails_names_the_faults_of_the_log(without_an_estimate, run):
    with running(run), pytest.raises(InfeasibleError) as failure:
        run_study(load_problem(without_an_estimate))
    (note,) = failure.value.__notes__
    assert "counts of encoders" in note
    assert "--units position=rev/COUNTS" in note


def test_the_gravest_fault_of_each_kind_comes_first():
    faults = [
        LogFinding("spring", "fault", "", f"{score:g}", "check it", score, "log")
        for score in (2.0, 7.0)
    ]
    faults.append(LogFinding("clock", "fault", "", "3", "check it", 3.0, "log"))
    failure = InfeasibleError("no robot")
    _explain(failure, Diagnosis((*faults, replace(faults[0], severity="note"))))
    assert failure.__notes__ == [
        "spring (log): 7. To do: check it",
        "clock (log): 3. To do: check it",
    ]


@pytest.mark.slow
def test_the_shell_prints_them_below_the_error(without_an_estimate, capsys):
    assert main(["identify", str(without_an_estimate)]) == 2
    said = capsys.readouterr().err
    assert said.index("total mass") < said.index("counts of encoders")


@pytest.mark.slow
def test_recordings_that_another_process_checks_have_the_same_diagnosis():
    problem = load_problem("problems/kuka_kr300")
    with running(Run(beside=True)):
        beside = run_study(problem, costs=False)
    here = run_study(problem, costs=False)
    assert beside.diagnosis.findings and beside.diagnosis == here.diagnosis
    assert beside.answer() == here.answer()


@pytest.mark.slow
def test_a_check_that_two_processes_share_finds_the_same():
    problem = load_problem("problems/kuka_kr300")
    with running(Run(beside=True)):
        shared = check_problem(problem)
    assert shared.findings and shared == check_problem(problem)


@pytest.mark.slow
def test_an_estimate_has_the_same_notes_alone_and_among_all():
    study = Study(load_problem("problems/kuka_kr300"))
    alone = study.constrained
    (among,) = (e for e in study.estimates if e.method == alone.method)
    assert any("slack" in note for note in alone.notes)
    assert alone.notes == among.notes
