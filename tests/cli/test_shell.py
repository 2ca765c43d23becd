"""The shell tool on a robot and a log; what it prints, to whom, and how it ends."""

import ast
import io
import json
import logging
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from logged import write_arm
from schemas import FOLDER
from shared_studies import no_study_shared, shared_within

from consistent_id import __version__, load_problem, uncertainty
from consistent_id._support.ownership import marked
from consistent_id.cli import main
from consistent_id.cli.answers import coloured, wants_colour, warnings_unless
from consistent_id.cli.tool import OutOfTime, tool_parser, within

COMMANDS = [
    "init",
    "info",
    "check",
    "excite",
    "identify",
    "compare",
    "export",
    "lint",
    "repair",
    "report",
    "reproduce",
    "payload",
    "gains",
    "servo",
    "completion",
]


studies = shared_within("module")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return [str(path) for path in write_arm(tmp_path_factory.mktemp("arm"))]


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_a_robot_and_a_log_are_identified_by_one_command(arm, tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["identify", *arm, "--output", str(folder), "--verbose"]) == 0
    out = capsys.readouterr().out
    assert re.match(r"use( with care)?: .*, held-out error \d", out)
    assert "position: q_{joint}" in out
    assert "Nothing suspicious was found" in out
    assert "fore.Izz" in out
    assert load_problem(folder, trust=True).missing == ()
    record = json.loads((folder / "comparison.json").read_text())
    (constrained,) = [e for e in record["estimates"] if e["method"] == "constrained"]
    assert constrained["validation"][0]["stacked"] < 0.05
    assert (folder / "constrained.json").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_a_dry_run_writes_nothing(arm, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["identify", *arm, "--output", "out", "--dry-run", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["format"] == "consistent_id study 1"
    assert record["findings"] is not None
    assert main(["init", *arm, "--dry-run"]) == 0
    assert "[[data.recordings]]" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_init_writes_a_problem_that_compare_works_through(
    arm, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["init", *arm]) == 0
    # The robot and the log lie elsewhere; the file is this user's own.
    out = capsys.readouterr().out
    assert out.endswith("next: consistent-id compare problem.toml\n")
    assert main(["compare", "problem.toml", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (tmp_path / "results" / "log" / "comparison.md").exists()


@pytest.mark.slow
def test_the_quiet_hear_no_warnings_and_others_do_later(arm, tmp_path, capsys):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(Path(arm[0]).read_text().replace('xyz="0 1 0"', 'xyz="0 2 0"'))
    logger = logging.getLogger("consistent_id")
    heard = []
    handler = logging.Handler()
    handler.emit = heard.append
    logger.addHandler(handler)
    try:
        main(["init", str(urdf), arm[1], "--dry-run", "--quiet"])
        assert heard == []
        main(["init", str(urdf), arm[1], "--dry-run"])
        assert heard != []
    finally:
        logger.removeHandler(handler)
    capsys.readouterr()


def test_a_warning_is_said_once_for_a_command(capsys):
    logger = logging.getLogger("consistent_id.somewhere")
    with warnings_unless(False):
        for word in ("first", "second", "first"):
            logger.warning("the %s", word)
    with warnings_unless(False):
        logger.warning("the first")
    assert capsys.readouterr().err.split("\n") == [
        "the first",
        "the second",
        "the first",
        "",
    ]


def test_a_warning_of_copies_of_one_file_is_said_once(capsys, tmp_path):
    logger = logging.getLogger("consistent_id.somewhere")
    with warnings_unless(False):
        for k in range(16):
            logger.warning("%s, line %d: odd", tmp_path / str(k) / "arm.urdf", 9)
        logger.warning("%s, line %d: odd", tmp_path / "other.urdf", 9)
        logger.warning("%s, line %d: odd", tmp_path / "arm.urdf", 10)
    said = capsys.readouterr().err.splitlines()
    assert said == [
        f"{tmp_path / '0' / 'arm.urdf'}, line 9: odd",
        f"{tmp_path / 'other.urdf'}, line 9: odd",
        f"{tmp_path / 'arm.urdf'}, line 10: odd",
    ]


@pytest.mark.slow
def test_init_does_not_write_over_a_file_unless_told(arm, tmp_path, capsys):
    file = tmp_path / "problem.toml"
    file.write_text("mine")
    assert main(["init", *arm, "--output", str(file)]) == 2
    assert "--force" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert main(["init", *arm, "--output", str(file), "--force", "--json"]) == 0
    text = json.loads(capsys.readouterr().out)["text"]
    assert file.read_text() == marked(text)


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_a_faulty_log_is_told_with_the_verdict(arm, tmp_path, capsys):
    rows = [row.split(",") for row in Path(arm[1]).read_text().splitlines()]
    for row in rows[1:]:
        row[4] = str(-float(row[4]))
    log = tmp_path / "log.csv"
    log.write_text("\n".join(map(",".join, rows)) + "\n")
    for quiet in ([], ["--quiet"]):
        assert main(["identify", arm[0], str(log), *quiet]) == 1
    head = capsys.readouterr().out.split("\n\n")[0]
    assert head.startswith("do not use: ")
    assert "torque sign" in head
    assert "consistent-id help bad-result" in head
    kinds = ["--accept", "torque sign", "--accept", "held-out error"]
    out = tmp_path / "out"
    arguments = ["identify", arm[0], str(log), *kinds, "--output", str(out), "--json"]
    main(arguments)
    record = json.loads(capsys.readouterr().out)
    assert "torque sign" in record["accepted"]
    assert (
        "# Accepted in spite of the verdict: torque sign"
        in (out / "problem.toml").read_text()
    )


def test_what_is_stated_beside_a_problem_file_is_heeded_and_said(capsys):
    assert main(["identify", "problems/rx60", "--torque-gain", "2"]) == 2
    assert "--torque-gain is for logs, but problems/rx60" in capsys.readouterr().err
    call = ["info", "problems/kuka_kr300", "--lock", "joint_6", "--verbose"]
    assert main(call) == 0
    out = capsys.readouterr().out
    assert "5 joints" in out
    assert "stated: model.locked = {'joint_6': 0.0}" in out


@pytest.mark.slow
def test_one_command_goes_from_a_robot_and_a_log_to_a_report(
    arm, tmp_path, capsys, monkeypatch
):
    calls = []

    def counted(*arguments, **options):
        calls.append(options["seed"])
        return uncertainty(*arguments, **options)

    monkeypatch.setattr("consistent_id.problems.study_fits.uncertainty", counted)
    file = tmp_path / "report.html"
    more = ["--uncertainty", "--seed", "3", "--report", str(file), "--verbose"]
    assert main(["identify", *arm, *more]) == 0
    html = file.read_text()
    assert html.lower().startswith("<!doctype html>")
    assert "bootstrap 95 %" in html
    out = capsys.readouterr().out
    assert "bootstrap 95 %" in out
    assert f"written: {file}" in out
    assert calls == [3]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_examples(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert f"examples:\n  consistent-id {command}" in out
    assert "--json" in out
    assert "--quiet" in out


@pytest.mark.slow
def test_every_example_is_understood(capsys):
    parser = tool_parser()
    for command in COMMANDS:
        with pytest.raises(SystemExit):
            main([command, "--help"])
        examples = capsys.readouterr().out.split("examples:\n")[1].splitlines()
        for example in examples:
            words = example.split(" > ")[0].split()
            assert parser.parse_args(words[1:]).command == command


@pytest.mark.slow
def test_the_package_runs_as_a_module_and_says_its_version():
    done = subprocess.run(
        [sys.executable, "-m", "consistent_id", "--version"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout.strip() == __version__


@pytest.mark.slow
def test_work_that_takes_too_long_is_given_up_with_3(arm, capsys, monkeypatch):
    def slow(*_, **__):
        time.sleep(5.0)

    monkeypatch.setattr("consistent_id.problems.study.run_study", slow)
    limit = ["--time-limit", "0.2", "--dry-run"]
    assert main(["compare", "problems/rx60", *limit]) == 3
    assert "not done within 0.2 s" in capsys.readouterr().err


@pytest.mark.slow
def test_a_time_limit_ends_with_the_work():
    with within(0.05):
        pass
    time.sleep(0.1)
    with pytest.raises(OutOfTime), within(0.05):
        time.sleep(1.0)


@pytest.mark.parametrize("limit", ["0", "-1", "inf", "nan", "soon"])
def test_a_time_limit_is_a_positive_number(limit, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["compare", "problems/rx60", "--time-limit", limit])
    assert ended.value.code == 2
    capsys.readouterr()


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_findings_of_lint_are_wrapped_for_a_terminal_alone(monkeypatch, tmp_path):
    robot = tmp_path / ("a-long-name-" * 6 + "robot.urdf")
    robot.write_text(
        '<robot name="arm"><link name="base"/><link name="boom"><inertial>'
        '<mass value="-1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial></link><joint name="lift" type="revolute"><parent link="base"/>'
        '<child link="boom"/><limit lower="-1" upper="1" effort="9" velocity="1"/>'
        "</joint></robot>"
    )
    monkeypatch.setenv("NO_COLOR", "1")
    shown = {}
    for screen in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stdout", screen)
        assert main(["lint", str(robot)]) == 1
        shown[screen.isatty()] = screen.getvalue()
    assert " ".join(shown[True].split()) == " ".join(shown[False].split())
    assert any(len(line) > 100 for line in shown[False].splitlines())
    further = [line for line in shown[True].splitlines() if line.startswith("  ")]
    assert further and max(map(len, further)) <= 100
    first = [line for line in shown[True].splitlines() if str(robot) in line]
    assert all(len(line.split()) == 1 for line in first)  # a path is not broken


def test_verdicts_are_coloured_for_a_terminal_alone(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert wants_colour(Terminal())
    assert not wants_colour(io.StringIO())
    monkeypatch.setenv("NO_COLOR", "1")
    assert not wants_colour(Terminal())
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert not wants_colour(Terminal())


def test_colours_take_nothing_away_and_do_not_touch_other_words():
    text = "arm: refused\n  uncertified  certified  certifiedly\n"
    shown = coloured(text)
    assert shown.count("\x1b[31m") == 1
    assert shown.count("\x1b[32m") == 1
    assert shown.count("\x1b[33m") == 1
    for code in (0, 1, 31, 32, 33):
        shown = shown.replace(f"\x1b[{code}m", "")
    assert shown == text


@pytest.mark.slow
def test_progress_is_shown_to_whoever_watches(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with no_study_shared():
        assert main(["compare", "problems/rx60", "--dry-run", "--json"]) == 0
    captured = capsys.readouterr()
    json.loads(captured.out)
    assert "shadow prices" in captured.err


@pytest.mark.slow
def test_a_pipe_gets_a_line_for_each_stage_and_none_where_quiet_is_wanted(capsys):
    assert main(["check", "problems/rx60"]) in (0, 1, 2)
    assert capsys.readouterr().err.startswith("0/1 faults of the recordings [0 s]\n")
    main(["check", "problems/rx60", "--quiet"])
    assert "faults of the recordings" not in capsys.readouterr().err


@pytest.mark.slow
def test_demo_copies_the_problems_once_and_keeps_what_was_edited(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--dry-run"]) == 0 and not (tmp_path / "problems").exists()
    assert main(["demo", "--json"]) == 0
    source = Path(__file__).parents[2] / "problems"
    for name in ("rx60/problem.toml", "kuka_kr300/FF_A.csv", "README.md"):
        copy = tmp_path / "problems" / name
        assert copy.read_bytes() == (source / name).read_bytes()
    assert main(["demo", "--output", "a b", "--dry-run"]) == 0
    assert "try: consistent-id compare 'a b/rx60'\n" in capsys.readouterr().out
    copy = tmp_path / "problems" / "rx60" / "problem.toml"
    assert main(["demo"]) == 0  # the same files may stay
    copy.write_text(copy.read_text() + "# edited")
    assert main(["demo"]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["demo", "--force"]) == 0 and "edited" not in copy.read_text()


@pytest.mark.slow
def test_help_says_what_a_reason_means(capsys):
    rules = Path(__file__).parents[2] / "consistent_id/estimation"
    files = [rules / "judgement.py", *sorted(rules.glob("*_reasons.py"))]
    text = "".join(file.read_text() for file in files)
    every = re.findall(r'Reason\(\s*"([^"]+)",\s*"([^"]+)"', text)
    kinds = {kind for kind, word in every if word != "use"}
    assert len(kinds) > 10
    for kind in kinds:
        assert main(["help", kind]) == 0
        name, *lines = capsys.readouterr().out.splitlines()
        assert name == kind
        assert lines[0].startswith("  means: ") and any("  to do: " in n for n in lines)


@pytest.mark.slow
def test_help_explains_verdicts_notes_and_reasons_about_loads(capsys):
    for topic, said in {
        "use": "to do: use it",
        "use with care": "to do: read its reasons",
        "boundary": "means: links have no thickness",
        "torque sign": "to do: look for a reversed axis",
        "inertia is open": "to do: accelerate the last joints",
        "gains not identifiable": "to do: a heavier load",
        "undetermined": "to do: logs of faster and slower motion",
    }.items():
        assert main(["help", topic]) == 0
        assert said in capsys.readouterr().out


@pytest.mark.slow
def test_help_explains_every_kind_of_finding(capsys):
    package = Path(__file__).parents[2] / "consistent_id"
    kinds = {"short", "small motion", "slow motion", "load"}
    folders = (package / "diagnosis", package / "problems")
    for file in (file for folder in folders for file in folder.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Name("LogFinding" | "Cause" | "_steps"), args=[kind, *_]
                ):
                    kinds |= said_in(kind)
                case ast.Assign(targets=[ast.Name("kind")], value=kind):
                    kinds |= said_in(kind)
    assert {"outliers", "speed limit", "wrapped encoder", "lag"} <= kinds
    for kind in sorted(kinds):
        assert main(["help", kind]) == 0, kind
        assert "\n  means: " in capsys.readouterr().out


def said_in(node):
    """The words in an expression that may be one of several."""
    if isinstance(node, ast.IfExp):
        return said_in(node.body) | said_in(node.orelse)
    return {node.value} if isinstance(node, ast.Constant) else set()


def test_help_prints_pages_and_the_help_of_commands(capsys):
    assert main(["help"]) == 0
    assert "bad-result" in capsys.readouterr().out
    for topic in ("bad-result", "docs/bad-result.md"):
        assert main(["help", topic]) == 0
        assert capsys.readouterr().out.startswith("# My result is bad, what now?\n")
    with pytest.raises(SystemExit):
        main(["demo", "--help"])
    shown = capsys.readouterr().out
    assert main(["help", "demo"]) == 0 and capsys.readouterr().out == shown
    assert main(["help", "bad-reslt"]) == 2
    assert "known: bad-result" in capsys.readouterr().err
    assert main(["help", "llms.txt"]) == 0
    assert capsys.readouterr().out == (FOLDER.parent / "llms.txt").read_text()


@pytest.mark.slow
def test_help_lists_schemas_and_prints_each_with_all_that_it_refers_to(capsys):
    assert main(["help", "schemas"]) == 0
    listed = capsys.readouterr().out
    assert listed.endswith(f"Files: {FOLDER}\n")
    names = {file.stem for file in FOLDER.glob("*.json")}
    assert set(re.findall(r"^  ([\w-]+-\d+) ", listed, re.M)) == names
    for name in names:
        assert main(["help", name]) == 0
        schema = json.loads(capsys.readouterr().out)
        assert schema["$id"] == f"{name}.json"
        # Every reference leads to a part of the text itself.
        inside = {part["$id"] for part in schema.get("$defs", {}).values()}
        assert set(re.findall(r'"\$ref": "([^"]+)"', json.dumps(schema))) <= inside


@pytest.mark.parametrize(
    "topic", ["consistent_id model gains 1", "schemas/model-gains-1.json"]
)
def test_help_finds_a_schema_by_the_format_of_an_object(topic, capsys):
    assert main(["help", "model-gains-1"]) == 0
    by_name = capsys.readouterr().out
    assert main(["help", topic]) == 0
    assert capsys.readouterr().out == by_name


@pytest.mark.slow
def test_a_schema_that_help_prints_refuses_what_lacks_a_key_of_a_shared_part(capsys):
    jsonschema = pytest.importorskip("jsonschema")
    assert main(["help", "verdict-1"]) == 0
    schema = json.loads(capsys.readouterr().out)
    reason = {"kind": "misfit", "word": "use", "statement": "large", "advice": "look"}
    verdict = {"held_out_recordings": [], "accepted": []}
    verdict |= {"method": "weighted", "verdict": "use", "held_out_error": 0.1}
    checked = jsonschema.Draft202012Validator(schema)
    assert checked.is_valid(verdict | {"reasons": [reason]})
    del reason["advice"]
    assert not checked.is_valid(verdict | {"reasons": [reason]})


def test_pages_that_messages_name_are_printed_by_help(capsys):
    package = Path(__file__).parents[2] / "consistent_id"
    source = "".join(file.read_text() for file in package.rglob("*.py"))
    strings = re.findall(r'"[^"\n]*"', source)
    assert [s for s in strings if re.search(r"docs/[\w-]+\.md", s)] == []
    topics = set(re.findall(r"consistent-id help ([a-z-]+)", "".join(strings)))
    assert {"bad-result", "wrist-sensor"} <= topics
    for topic in topics:
        assert main(["help", topic]) == 0
