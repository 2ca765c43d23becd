"""A folder of results opens again: no command computes it anew, or it says why."""

import json
import os
import shutil
import time
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import pytest
from logged import write_arm

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.cli.answers import Answer
from consistent_id.cli.compare import _parameters
from consistent_id.cli.source import each
from consistent_id.report.results import Results
from consistent_id.report.results_writing import _input

VERSION = ci.__version__


def run(capsys, *arguments):
    """Return the exit code, and what was printed on either stream."""
    capsys.readouterr()
    code = main([str(word) for word in arguments])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A robot, a log, and the results of identifying it."""
    place = tmp_path_factory.mktemp("journey")
    urdf, log = write_arm(place)
    call = ["identify", str(urdf), str(log), "--no-select", "--cutoff", "10"]
    assert main([*call, "--output", str(place / "results"), "--quiet"]) == 0
    return place


@pytest.fixture
def results(written, tmp_path):
    """A copy of all that, at a place of its own, as its user's own run wrote it."""
    place = tmp_path / "place"
    place.mkdir()
    shutil.copy(written / "arm.urdf", place)
    shutil.copy(written / "log.csv", place)
    shutil.copytree(written / "results", place / "results")
    return place / "results"


@pytest.fixture
def nothing_computed(monkeypatch):
    def computed(*_, **__):
        pytest.fail("it was computed")

    monkeypatch.setattr("consistent_id.problems.study.Study.run", computed)
    monkeypatch.setattr("consistent_id.problems.opening.open_problem", computed)


OPENED = {
    "report": ["--output", "robot.html"],
    "compare": [],
    "info": [],
    "check": [],
    "identify": [],
    "export": ["--format", "urdf", "--output", "new.urdf"],
}


@pytest.mark.slow
@pytest.mark.parametrize("command", OPENED)
def test_what_only_reads_needs_nothing_outside_of_the_folder(
    command, results, tmp_path, capsys, monkeypatch, nothing_computed
):
    monkeypatch.chdir(tmp_path)
    other = shutil.move(results, tmp_path / "elsewhere")
    shutil.rmtree(tmp_path / "place")
    code, out, err = run(capsys, command, other, *OPENED[command])
    assert (code, err) == (0, "")
    first = out.splitlines()[0]
    assert first.startswith(
        "use" if command not in ("check",) else "Nothing suspicious"
    )


@pytest.mark.slow
def test_figures_are_equal_to_the_digit(written, results, capsys):
    folder = written / "results"
    study = json.loads((folder / "comparison.json").read_text())
    for command in ("compare", "identify"):
        code, out, _ = run(capsys, command, folder, "--json")
        assert code == 0 and json.loads(out) == study
    _, out, _ = run(capsys, "check", folder, "--json")
    assert json.loads(out)["findings"] == study["findings"]
    opened = ci.open_results(folder)
    answer = {key: study[key] for key in opened.answer}
    assert opened.answer == answer
    assert opened.verdict.held_out == study["held_out_error"]
    delivered = {n: p["value"] for n, p in study["delivered"]["parameters"].items()}
    (note,) = (n for n in opened.delivered.notes if n.startswith("fitted again"))
    assert note.count("log.csv") == 1  # of which both parts are
    names = opened.problem.model.layout.names
    mine = dict(zip(names, opened.delivered.parameters, strict=True))
    assert mine == delivered


@pytest.mark.slow
def test_an_export_of_results_is_that_of_the_study(written, results, tmp_path, capsys):
    files = [tmp_path / "opened.urdf", tmp_path / "computed.urdf"]
    how = ["--format", "urdf", "--output"]
    code, opened, _ = run(capsys, "export", results, *how, files[0])
    assert code == 0
    problem = written / "results" / "problem.toml"
    code, computed, _ = run(capsys, "export", problem, *how, files[1])
    assert code == 0
    said = [
        [line for line in out.splitlines() if "of the file, read back" in line]
        for out in (opened, computed)
    ]
    assert said[0] == said[1]
    assert said[0][0].startswith("  held-out error")
    mine, theirs = (ci.load_robot(file) for file in files)
    for one, other in zip(mine.links, theirs.links, strict=True):
        assert one.nominal.vector == pytest.approx(
            other.nominal.vector, rel=1e-9, abs=1e-12
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    "what", ["log", "robot", "estimate", "option", "accept", "version"]
)
def test_what_has_changed_is_said_and_computed_again(
    what, results, capsys, monkeypatch
):
    options = []
    if what == "log":
        log = results.parent / "log.csv"
        log.write_text(log.read_text().replace("0.03,", "0.0300001,", 1))
    elif what == "robot":
        urdf = results.parent / "arm.urdf"
        urdf.write_text(urdf.read_text() + "<!-- weighed in May -->")
    elif what == "estimate":
        file = results / "delivered.json"
        file.write_text(file.read_text().replace('"use"', '"use "', 1))
    elif what == "option":
        options = ["--cutoff", "5"]
    elif what == "accept":
        options = ["--accept", "lag"]
    else:
        monkeypatch.setattr("consistent_id.__version__", "9.9")
    said = []

    def computed(path, logs, stated, **_):
        said.append((path, tuple(logs), stated.given))
        raise ci.ProblemError("it would be computed")

    monkeypatch.setattr("consistent_id.problems.opening.open_problem", computed)
    code, _, err = run(capsys, "compare", results, *options)
    assert code == 2 and "computed again" in err and "it would be computed" in err
    assert said == [(results, (), ("cutoff",) if what == "option" else ())]
    known = {"log": "log.csv has changed", "robot": "arm.urdf has changed"}
    known |= {
        "estimate": "delivered.json has been edited",
        "option": "cutoff is stated",
        "accept": "its results have no --accept",
    }
    ours = f"version {VERSION} wrote it, this is 9.9"
    assert known.get(what, ours) in err


def index_of(folder):
    """What results.json says, but for digests: files hold times of this run."""
    record = json.loads((folder / "results.json").read_text())
    del record["digest"]
    return record | {"files": sorted(record["files"])}


@pytest.mark.slow
def test_a_run_may_be_repeated_into_its_own_folder_until_a_file_is_edited(
    written, capsys, monkeypatch
):
    call = ["identify", written / "arm.urdf", written / "log.csv", "--no-select"]
    call += ["--cutoff", "10", "--output", written / "again"]
    assert run(capsys, *call)[0] == 0
    first = index_of(written / "again")
    assert run(capsys, *call)[0] == 0
    assert index_of(written / "again") == first
    assert run(capsys, "compare", written / "again", "--quiet")[0] == 0
    mine = written / "again" / "problem.toml"
    mine.write_text(mine.read_text().replace("viscous = true", "viscous = false"))
    monkeypatch.setattr(
        "consistent_id.problems.study.Study.run",
        lambda *_, **__: pytest.fail("computed before the folder was looked at"),
    )
    code, _, err = run(capsys, *call)
    assert code == 2 and "was edited since consistent-id wrote it" in err
    assert "viscous = false" in mine.read_text()


@pytest.mark.slow
def test_a_stranger_s_folder_names_nothing_outside_of_it(results, tmp_path, capsys):
    index = results / "results.json"
    record = json.loads(index.read_text())
    secret = tmp_path / "secret.txt"
    secret.write_text("not yours")
    name = os.path.relpath(secret, results)
    index.write_text(
        json.dumps(record | {"files": {name: record["files"]["report.html"]}})
    )
    code, _, err = run(capsys, "report", results)
    assert code == 2 and "is not a file of this folder" in err
    index.write_text("{")
    assert run(capsys, "compare", results)[0] == 2
    # Computing it again reads what the problem file names: that needs trust.
    index.write_text(json.dumps(record))
    (results / "comparison.md").write_text("something else")
    code, _, err = run(capsys, "compare", results)
    assert code == 2 and "--trust" in err


FORGED = {
    "no digest of delivered.json": lambda r: r["files"].pop("delivered.json"),
    "no tables of check": lambda r: r["tables"].pop("check"),
    "rows that do not fit": lambda r: r["tables"]["compare"][0].update(
        rows=[["a"], ["b", "c"]], header=["x", "y"]
    ),
    "answer: ": lambda r: r["answer"].update(verdict="great"),
    "findings: ": lambda r: r["findings"].update(findings=[{}]),
    "model.form": lambda r: r["model"].update(form="name"),
    "'..' is not a file": lambda r: r["model"].update(name=".."),
    "'' is not a file": lambda r: r["model"].update(name=""),
}


@pytest.mark.slow
@pytest.mark.parametrize("said", FORGED)
def test_an_index_that_lacks_what_commands_read_is_refused(said, results, capsys):
    index = results / "results.json"
    record = json.loads(index.read_text())
    FORGED[said](record)
    index.write_text(json.dumps(record))
    code, _, err = run(capsys, "check", results)
    assert code == 2 and said in err


@pytest.mark.slow
def test_results_of_several_folders_are_put_side_by_side(
    written, results, capsys, nothing_computed
):
    code, out, err = run(capsys, "compare", written / "results", results, "--verbose")
    assert (code, err) == (0, "")
    assert out.startswith("2 results side by side")
    assert "0 of 26 in common differ" in out
    # What asks for other results is refused, and what was edited is said.
    for words in (["--masses", "free"], ["--accept", "lag"], ["--output", "new"]):
        code, _, err = run(capsys, "compare", results, written / "results", *words)
        assert code == 2 and err.startswith(f"consistent-id: {words[0]}: folders of")
    (results / "comparison.md").write_text("mine")
    code, out, _ = run(capsys, "compare", written / "results", results, "--verbose")
    assert code == 0 and f"{results}: comparison.md has been edited since" in out


def test_zeros_of_the_solver_are_not_parameters_that_differ():
    def folder(name, hz, mass):
        values = {"a.m": (mass, "kg"), "a.hz": (hz, "kg m"), "a.hx": (0.2, "kg m")}
        record = {n: {"value": v, "unit": unit} for n, (v, unit) in values.items()}
        return SimpleNamespace(
            folder=name, record={"delivered": {"parameters": record}}
        )

    table = _parameters([folder("one", 3e-17, 1.0), folder("two", -4e-17, 2.0)])
    assert [row[0] for row in table.rows] == ["a.m"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["problem.toml", "delivered.json", "results.json"])
def test_what_reads_a_folder_writes_no_other_file_over_it(name, results, capsys):
    file = results / name
    before = file.read_bytes()
    for command in (
        ["report", results, "--output", file],
        ["identify", results, "--report", file],
        ["export", results, "--format", "json", "--output", file],
    ):
        code, _, err = run(capsys, *command)
        assert code == 2 and "is an input of this run" in err
        assert file.read_bytes() == before
    assert run(capsys, "report", results)[0] == 0  # its own report


def test_a_folder_in_front_of_logs_is_no_robot(tmp_path, capsys):
    _, log = write_arm(tmp_path)
    code, _, err = run(capsys, "check", tmp_path, log)
    assert code == 2 and "is a folder, expected a robot's URDF or MJCF file" in err


def test_a_folder_that_does_not_exist_is_named(tmp_path, capsys):
    code, _, err = run(capsys, "compare", tmp_path, tmp_path / "nowhere")
    assert code == 2 and f"{tmp_path / 'nowhere'}: no such file or folder" in err


@pytest.mark.parametrize("option", [["report", "--output"], ["identify", "--report"]])
def test_a_report_that_would_be_called_a_pdf_is_refused(option, capsys):
    command, name = option
    with pytest.raises(SystemExit) as ended:
        main([command, "problems/rx60", name, "study.pdf"])
    assert ended.value.code == 2
    assert "is an HTML file, name it study.html" in capsys.readouterr().err


def test_results_without_recordings_are_checked_as_their_problem_is(
    capsys, monkeypatch
):
    monkeypatch.setattr(
        "consistent_id.cli.check.stored",
        lambda _: SimpleNamespace(
            index=SimpleNamespace(findings={}), tables=lambda _: []
        ),
    )
    code, _, err = run(capsys, "check", "problems/rx60")
    assert code == 2 and "has no recordings; add a [data] table" in err


def test_a_folder_without_results_is_no_results(tmp_path):
    with pytest.raises(ci.ProblemError, match=r"has no results.json"):
        ci.open_results(tmp_path)
    assert not (Path("problems/rx60") / "results.json").exists()


@pytest.fixture
def two(tmp_path):
    """A folder of two problems, `one` a problem file and `two` a folder of results."""
    folder = tmp_path / "several"
    text = Path("problems/rx60/problem.toml").read_text()
    for name in ("one", "two"):
        (folder / name).mkdir(parents=True)
        (folder / name / "problem.toml").write_text(
            text.replace('name = "rx60"', f'name = "{name}"')
        )
    (folder / "two" / "results.json").write_text("{}")
    return folder


def test_of_several_problems_the_results_among_them_are_opened(two, tmp_path):
    asked = []

    def answer_to(options):
        asked.append((options.problem, options.output))
        return Answer(0, "", None)

    options = Namespace(
        problem=two, log=[], output=tmp_path / "a.b.urdf", json=False, quiet=True
    )
    assert each(options, answer_to, file=True) == 0
    problems = [two / "one" / "problem.toml", two / "two"]
    files = [tmp_path / "a.b-one.urdf", tmp_path / "a.b-two.urdf"]
    assert asked == list(zip(problems, files, strict=True))
    asked.clear()
    shutil.rmtree(two / "one")
    assert each(options, answer_to, file=True) == 0
    assert asked == [(two / "two", options.output)]
    options.problem = two / "two" / "problem.toml"  # the file itself: computed
    each(options, answer_to)
    assert asked[1:] == [(options.problem, options.output)]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["report", "compare", "export", "identify"])
def test_a_folder_of_several_results_opens(
    command, results, tmp_path, capsys, nothing_computed
):
    place = results.parent.parent / "all"
    for name in ("one", "two"):
        shutil.copytree(results, place / name)
    output = {"export": tmp_path / "new.urdf", "report": tmp_path / "new.html"}
    words = ["--output", output[command]] if command in output else []
    words += ["--format", "urdf"] * (command == "export")
    code, out, err = run(capsys, command, place, *words)
    assert (code, err) == (0, "")
    assert "=== one" in out and "=== two" in out
    for name in ("one", "two") if command in output else ():
        file = output[command]
        assert file.with_name(f"{file.stem}-{name}{file.suffix}").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["rollout", "identify"])
def test_results_whose_robot_is_gone_do_not_ask_for_trust(
    command, results, tmp_path, capsys
):
    other = shutil.move(results, tmp_path / "elsewhere")
    (tmp_path / "place" / "arm.urdf").unlink()
    words = ["--masses", "free"] if command == "identify" else []  # computed again
    code, _, err = run(capsys, command, other, *words)
    assert code == 2 and "no such file" in err and "--trust" not in err


CONTENTS = {
    "no JSON": b"{",
    "not UTF-8": b'{"problem": "\xff", "delivered": {"parameters": {}}}',
    "no parameters": b'{"problem": "arm", "delivered": {}}',
    "a list": b"[]",
    "no number": b'{"problem": "arm", "delivered": {"parameters": {"a": '
    b'{"value": "1", "unit": ""}}}}',
    "not finite": b'{"problem": "arm", "delivered": {"parameters": {"a": '
    b'{"value": NaN, "unit": ""}}}}',
    "without end": b"[" * 100_000,
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_a_forged_record_is_refused_in_words_of_our_own(content, tmp_path):
    (tmp_path / "comparison.json").write_bytes(content)
    with pytest.raises(ci.ProblemError, match="not the record of a study"):
        _ = Results(tmp_path, None).record


def test_an_edit_that_keeps_size_and_stamp_is_seen(tmp_path, monkeypatch):
    log = tmp_path / "log.csv"
    log.write_text("0,1,2")
    long_ago = (1_600_000_000_000_000_000,) * 2
    os.utime(log, ns=long_ago)
    record = _input(log)
    for large in (2**26, 0):  # what a small file is, and a large one
        monkeypatch.setattr("consistent_id.report.results._LARGE", large)
        log.write_text("0,1,2")
        assert record.fits(log)
        log.write_text("0,1,3")
        os.utime(log, ns=long_ago)
        assert not record.fits(log)


def test_a_large_file_is_not_read_again_unless_it_was_recorded_just_after_a_change(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("consistent_id.report.results._LARGE", 0)
    log = tmp_path / "log.csv"
    log.write_text("0,1,2")
    fresh = _input(log)
    assert (fresh.changed, fresh.status) == (0, 0)
    monkeypatch.setattr(
        "consistent_id.report.results_writing.time_ns", lambda: time.time_ns() + 10**10
    )
    settled = _input(log)
    read = []
    monkeypatch.setattr("consistent_id.report.results.digest", read.append)
    assert settled.fits(log) and not read
    assert not fresh.fits(log) and read == [log]


@pytest.mark.slow
def test_a_design_keeps_the_torque_limits_of_the_results_estimate(tmp_path, capsys):
    """Not that of results that may not be used, or whose log has changed."""
    results = tmp_path / "results"
    call = ["identify", *write_arm(tmp_path), "--no-select", "--cutoff", "10"]
    assert run(capsys, *call, "--output", results)[0] == 0
    plan = ["--dry-run", "--acceleration", "5", "--velocity", "2"]
    code, given, err = run(
        capsys, "excite", results, *plan, "--parameters", results / "delivered.json"
    )
    assert (code, err) == (0, "")
    assert "torque limits: kept for an estimate" in given
    assert run(capsys, "excite", results, *plan) == (0, given, "")
    assert run(capsys, "excite", results / "problem.toml", *plan)[1] == given
    log = tmp_path / "log.csv"
    text = log.read_text()
    log.write_text(text.replace("0.", "0.0", 1))
    _, of_file, _ = run(capsys, "excite", results, *plan)
    assert "torque limits: of the robot's file" in of_file
    log.write_text(text)
    index = results / "results.json"
    refused = json.loads(index.read_text())
    refused["answer"]["verdict"] = "do not use"
    index.write_text(json.dumps(refused))
    _, of_file, _ = run(capsys, "excite", results, *plan)
    assert "torque limits: of the robot's file" in of_file
