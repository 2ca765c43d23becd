"""The report: whole, self-contained, escaped, and with the study's own figures."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from logged import write_arm
from report_pages import Page
from shared_studies import shared_within
from some_fast import some_fast

from consistent_id import (
    ModelError,
    draft_problem,
    load_problem,
    run_study,
    write_report,
)
from consistent_id._support.ownership import sealed
from consistent_id.cli import main
from consistent_id.estimation.expected_error import ExpectedError
from consistent_id.estimation.verdict import percent
from consistent_id.problems.log_entries import FoundDrives
from consistent_id.problems.published import (
    PublishedReport,
    PublishedVector,
    RankReport,
)
from consistent_id.recordings.signals.drive_torque import DriveCalibration
from consistent_id.report import report_html
from consistent_id.report.page import SECTIONS
from consistent_id.report.results_writing import study_record
from consistent_id.report.summary import (
    delay_line,
    expected_lines,
    headline_tables,
    slack_table,
)

studies = shared_within("module")


@pytest.fixture(scope="module", params=some_fast(["arm", "rx60"], fast=0))
def study(request, tmp_path_factory):
    """Of a small arm and its log, and of a paper's simulated experiment."""
    if request.param == "rx60":
        return run_study(load_problem("problems/rx60"), seed=3)
    folder = tmp_path_factory.mktemp("arm")
    draft = draft_problem(*write_arm(folder), select=False, cutoff=10.0)
    (folder / "problem.toml").write_text(draft.text(folder))
    return run_study(load_problem(folder, trust=True), seed=3)


@pytest.fixture(scope="module")
def sure(study):
    return study.uncertainty


@pytest.fixture(scope="module")
def html(study, sure):
    return report_html(study, uncertainty=sure, command="do it again")


def test_a_study_has_every_section_that_applies_in_order(study, html):
    sections = Page(html).sections
    assert sections[0] == "verdict"
    assert set(sections) == {
        "verdict",
        "health",
        "excitation",
        "parameters",
        "links",
        "torque",
        "residuals",
        "costs",
        "friction" if study.published is None else "published",
        "delivered",
        "certificate",
        "reproduce",
    }  # the RX-60 of the paper has no friction
    assert len(SECTIONS) == len(sections) + 1


def test_the_page_needs_no_other_file_and_no_network(html):
    for name, attributes in Page(html).elements:
        assert name not in {"link", "img", "iframe", "object"}
        assert "src" not in attributes
        assert attributes.get("href", "#").startswith("#")
    shown = html.replace("http://www.w3.org/2000/svg", "")  # a name, not a place
    assert not re.search(r"(url\(|@import|fetch\(|XMLHttp)", shown)
    assert len(html) < 3_000_000


def test_it_has_light_dark_print_and_narrow_styles(html):
    for rule in ("prefers-color-scheme: dark", "@media print", "@media (max-width"):
        assert rule in html
    assert 'name="viewport"' in html


def test_figures_are_the_study_s(study, html):
    page = Page(html)
    for report in study.comparison.reports:
        for error in report.validation:
            assert f"{error.stacked:.2%}" in page.texts
    chosen = study.recommended
    for value in chosen.estimate.base_values:
        assert f"{value:.4g}" in page.texts
    for price in study.prices[:12]:
        assert price.label in page.texts
    assert str(study.excitation.data_rank) in page.texts
    assert study.problem.model.fingerprint in page.texts


def test_the_first_screen_has_the_expected_error_with_its_range(study, html):
    expected = study.recommendation.expected
    first = headline_tables(study)[0].notes
    assert first[0].startswith("error to expect") and expected.range in first[0]
    held_out = list(zip(study.recommended.validation, first[1:], strict=False))
    assert held_out
    for error, line in held_out:
        assert line.startswith(f"expected on {error.recording}: ")
        assert percent(error.stacked) in line
    record = study_record(study)
    chosen = record["recommendation"]
    assert chosen["expected_range"] == [expected.low, expected.high]
    assert record["expected_error"]["error"] == chosen["expected_error"]
    assert len(chosen["expected_on"]) == len(study.validation)
    assert f"80 % range {expected.range}" in html


def test_a_motion_that_the_data_do_not_predict_is_held_against_no_range():
    errors = [SimpleNamespace(recording=name, stacked=0.12) for name in ("far", "near")]
    study = SimpleNamespace(
        recommended=SimpleNamespace(validation=errors),
        expected_held_out=(ExpectedError(1.6, 0.3, 9.0), ExpectedError(0.5, 0.3, 4.0)),
    )
    assert expected_lines(study) == (
        "expected on near: 30 % to over 100 %; measured 12 %, less than expected",
    )


def test_the_slack_chosen_is_in_the_table_the_record_and_the_notes(study):
    for method, found in study.slacks.items():
        shown = slack_table(study.slacks).text()
        assert found.slacks[found.best] in shown and " <" in shown
        assert study_record(study)["slacks"][method] == found.to_dict()
        assert found.statement in study.estimate(method).notes


def test_the_record_of_a_paper_s_report_has_each_number_for_json(study, monkeypatch):
    first = study.comparison.reports[0]
    rank = RankReport(("a", "b"), 1, np.array([1.0, 0.0]), ("a - b",))
    vector = PublishedVector(
        "mean", first.base_feasibility, study.recommended.estimate, np.array([0.5, 2.0])
    )
    paper = PublishedReport(
        SimpleNamespace(names=("a", "b")),
        study.training[0],
        all_columns=rank,
        free_columns=replace(rank, columns=("a",), null_directions=()),
        mean=np.array([3.0, 4.0]),
        standard_deviation=np.array([0.1, 0.2]),
        largest_differences={"mean": 1e-3},
        mean_links={},
        central_inertia={"fore": np.arange(6.0)},
        vectors=(vector,),
    )
    monkeypatch.setitem(study.__dict__, "published", paper)
    record = json.loads(json.dumps(study_record(study)))["published"]
    assert record.pop("vectors") == [
        {
            "name": "mean",
            "answer": first.base_feasibility.answer,
            "summary": first.base_feasibility.summary,
            "depth": first.base_feasibility.proof.margin,
            "bound": first.base_feasibility.proof.bound,
            "nearest": json.loads(json.dumps(study.recommended.estimate.to_dict())),
            "torque_change": [0.5, 2.0],
        }
    ]
    values = {"rank": 1, "singular_values": [1.0, 0.0]}
    assert record == {
        "parameters": ["a", "b"],
        "mean": [3.0, 4.0],
        "standard_deviation": [0.1, 0.2],
        "largest_differences": {"mean": 1e-3},
        "central_inertia": {"fore": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]},
        "ranks": [
            {"columns": ["a", "b"], **values, "null_directions": ["a - b"]},
            {"columns": ["a"], **values, "null_directions": []},
        ],
    }


def test_parameters_have_their_intervals_and_verdicts(sure, html):
    page = Page(html)
    for p in sure.parameters:
        assert f"{p.value:.4g}" in page.texts
        assert f"{p.consistent[0]:.4g} to {p.consistent[1]:.4g}" in page.texts
    count = sum(p.verdict == "prior" for p in sure.parameters)
    assert f" {count}: its value is the prior's" in page.texts


def test_it_says_how_to_get_it_again(study, html):
    page = Page(html)
    assert "do it again" in page.texts
    assert "3" in page.texts
    text_of_file = study.problem.source.read_text()
    assert text_of_file in page.text
    assert any(re.fullmatch("[0-9a-f]{64}", part) for part in page.texts)


def test_what_is_written_is_what_is_returned_with_its_digest(study, tmp_path):
    path = write_report(study, tmp_path / "new" / "report.html")
    assert path.read_bytes() == sealed(path, report_html(study).encode())


@pytest.mark.slow
def test_the_shell_writes_it_and_says_which_estimate_to_use(tmp_path, capsys):
    file = tmp_path / "deep" / "rx60.html"
    assert main(["report", "problems/rx60", "--output", str(file)]) == 0
    out = capsys.readouterr().out
    assert "use: constrained" in out
    assert str(file) in out
    page = Page(file.read_text(encoding="utf-8"))
    assert "consistent-id report problems/rx60/problem.toml --seed 0" in page.texts


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs chromium")
def test_a_browser_draws_and_zooms_without_complaint(study, html, tmp_path):
    zoom = '<script>document.querySelector("[data-zoom=in]").click()</script></body>'
    file = tmp_path / "report.html"
    file.write_text(html.replace("</body>", zoom), encoding="utf-8")
    done = subprocess.run(
        [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--enable-logging=stderr",
            "--virtual-time-budget=2000",
            "--dump-dom",
            file.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "CONSOLE" not in done.stderr
    span = re.search(r'data-span="([^"]+)"', done.stdout).group(1)
    time = study.validation[0].time
    quarter = (time[-1] - time[0]) / 4
    half = [time[0] + quarter, time[-1] - quarter]
    assert [float(end) for end in span.split()] == pytest.approx(half, abs=1e-4)


def broken(*_, **__):
    raise ZeroDivisionError("what nobody thought of")


def refused(*_, **__):
    raise ModelError("this robot has none")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "said", "logged"),
    [
        (broken, "ZeroDivisionError: what nobody thought of", True),
        (refused, "this robot has none", False),
    ],
)
def test_a_section_that_fails_loses_only_itself(
    study, monkeypatch, caplog, make, said, logged
):
    before = Page(report_html(study)).sections
    names = [section.__name__ for section in SECTIONS]
    place = names.index("residuals_section")
    make.__name__ = "residuals_section"
    sections = (*SECTIONS[:place], make, *SECTIONS[place + 1 :])
    monkeypatch.setattr("consistent_id.report.page.SECTIONS", sections)
    page = Page(report_html(study))
    assert page.sections == before
    assert f"This section could not be made: {said}" in page.text
    assert ("section residuals" in caplog.text) == logged


@pytest.mark.parametrize(
    ("name", "arguments", "lost"),
    [
        ("report.page.SECTIONS", ["report"], ()),
        ("rollout.rollout_page.rollout_section", ["report"], ()),
        ("report.plot.motion_figure", ["compare"], ("motion.svg",)),
        ("report.summary._TABLES", ["compare"], ()),
    ],
)
@pytest.mark.slow
def test_the_shell_says_what_could_not_be_made_after_all_else_was_written(
    tmp_path, capsys, monkeypatch, studies, name, arguments, lost
):
    problem, whole, part = "problems/rx60", tmp_path / "whole", tmp_path / "part"
    for folder in (whole, part):
        folder.mkdir()
    if "rollout" in name:  # a section of robots with gains
        pytest.importorskip("mujoco")
        from commanded_leg import write_leg  # it imports MuJoCo

        (tmp_path / "leg").mkdir()
        write_leg(tmp_path / "leg")
        problem = str(tmp_path / "leg")
    file = "report.html" if arguments == ["report"] else "."
    code = main([*arguments, problem, "--output", str(whole / file)])
    found: object = broken
    if name.endswith("SECTIONS"):
        found = (*SECTIONS[:3], broken, *SECTIONS[4:])
    elif name.endswith("_TABLES"):
        from consistent_id.report.summary import _TABLES

        found = {**_TABLES, "links": broken}
    capsys.readouterr()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(f"consistent_id.{name}", found)
    assert code in (0, 1)
    assert main([*arguments, problem, "--output", str(part / file), "--quiet"]) == 70
    (line,) = capsys.readouterr().err.splitlines()
    assert "could not be made" in line and "what nobody thought of" in line
    (kept,) = tmp_path.glob("consistent-id-*.txt")
    assert str(kept) in line and "in broken" in kept.read_text()
    names = {path.name for path in whole.iterdir()}
    assert {path.name for path in part.iterdir()} == names - set(lost)
    if not lost:
        said = part / ("report.html" if "report" in arguments else "comparison.md")
        assert "could not be made: ZeroDivisionError" in said.read_text()


def test_the_report_shows_the_estimates_own_standard_errors(study):
    page = Page(report_html(study))
    recommended = study.recommended.estimate
    shown = [t for t in recommended.error_texts if t != "-"]
    assert shown and all(error in page.texts for error in shown)
    assert "standard error" in page.texts
    links = f"{len(recommended.links)} of {len(recommended.links)}"
    assert page.texts[page.texts.index("consistent links") - 1] == links


@pytest.mark.parametrize(("error", "said"), [(2e-4, False), (5e-3, True)])
def test_a_delay_that_was_found_is_said_with_its_error(error, said):
    late = DriveCalibration(delay=0.01, delay_error=error)
    (line,) = delay_line(FoundDrives(calibration=late))
    assert f"10 ms late, +- {1e3 * 1.96 * error:.2g} ms (95 %)" in line
    assert ("rollout finds the delay" in line) is said
    exact = DriveCalibration(delay=0.01)
    assert delay_line(FoundDrives(calibration=exact)) == ()
    assert delay_line(FoundDrives(calibration=late, delay=Scan())) == ()


class Scan:
    """A scan of the delay, which has a table of its own."""

    def table(self):
        return None
