"""Every command that takes a robot and logs, or a problem, heeds all that is stated."""

import re
import shlex
from pathlib import Path

import pytest

from consistent_id.cli import main
from consistent_id.cli.source import command_of
from consistent_id.cli.tool import tool_parser
from consistent_id.errors import ProblemError
from consistent_id.problems.statement import declarations

OF_LOGS = "check identify compare report export rollout info payload gains".split()
COMMANDS = {
    **dict.fromkeys(OF_LOGS, "consistent_id.problems.opening.open_problem"),
    "select": "consistent_id.problems.loading.stated_problem",
    "init": "consistent_id.problems.drafting.drafted",
}
ROBOT = {
    "excite": "consistent_id.excitation.sources.problem_to_excite",
    "rehearse": "consistent_id.excitation.sources.problem_to_excite",
}
MORE = {
    "export": ["--format", "json", "--output", "robot.json"],
    "payload": ["--loaded", "carrying.csv"],
    "gains": ["--loaded", "carrying.csv", "--known-mass", "2.8"],
}
WORDS = {
    "lock": ["elbow=0.5"],
    "gravity": ["0,0,-1.62"],
    "names": ["A1=elbow"],
    "units": ["deg"],
    "torque-gain": ["2"],
    "gains": ["60,1.5"],
    "rows": ["10,900"],
    "omit": ["3,7"],
    "max-gap": ["0.5"],
    "most-joint-speed": ["model"],
    "duplicates": ["first"],
    "missing": ["omit"],
    "wraps": ["undo"],
    "position-scale": ["elbow=-1"],
    "position-offset": ["elbow=0.5"],
    "coupled": ["elbow=shoulder"],
    "gain-source": ["model"],
    "quaternion": ["wxyz"],
    "contact": ["foot=always"],
    "bodies": ["identified"],
    "masses": ["free"],
    "cutoff": ["7.5"],
    "friction-velocity": ["0.3"],
    "band": ["9"],
    "no-select": [],
}


class Seen(ProblemError):
    """Ends a command where it has handed on what is stated."""


def given_to(target, monkeypatch):
    """Let a function end the command; return what statements it is given."""
    statements = []

    def seen(*given, **named):
        values = (*given, *named.values())
        statements.extend(v for v in values if type(v).__name__ == "Statement")
        raise Seen("seen")

    monkeypatch.setattr(target, seen)
    return statements


def stated(parts):
    """Names of the fields of some parts, and the words that state all of them."""
    declared = {n: d for n, d in declarations().items() if d.part in parts}
    words = []
    for each in declared.values():
        option = each.option.removeprefix("--")
        words += [f"--{option}", *WORDS.get(option, ["word"])]
    return tuple(declared), words


@pytest.mark.parametrize("command", [*COMMANDS, *ROBOT])
def test_no_option_is_dropped(command, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    Path("robot.urdf").touch()
    Path("log.csv").touch()
    Path("word").mkdir()
    statements = given_to((COMMANDS | ROBOT)[command], monkeypatch)
    parts = {d.part for d in declarations().values()}
    names, words = stated({"robot"} if command in ROBOT else parts)
    if command == "select":  # a choice without a choice is refused
        words.remove("--no-select")
        names = tuple(n for n in names if n not in ("select", "band", "keep"))
    source = ["robot.urdf", "log.csv"] if command == "init" else ["robot.urdf"]
    assert main([command, *source, *MORE.get(command, []), *words]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "consistent-id: seen"
    assert [each.given for each in statements] == [names]


def test_a_choice_of_the_model_heeds_what_is_stated_of_it(monkeypatch, capsys):
    chosen = {}

    def seen(problem, **options):
        chosen.update(options)
        raise Seen("seen")

    monkeypatch.setattr(
        "consistent_id.problems.selection.model_selection.select_model", seen
    )
    kuka = "problems/kuka_kr300"
    words = ["--band", "9", "--keep", "coupling", "--dry-run"]
    assert main(["select", kuka, *words]) == 2
    assert (chosen["band"], chosen["fixed"]) == (9.0, ("coupling",))
    assert main(["select", kuka, "--no-select", "--dry-run"]) == 2
    assert "--no-select" in capsys.readouterr().err


@pytest.mark.parametrize("command", OF_LOGS)
def test_logs_behind_a_robot_are_handed_on(command, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    logs = []

    def seen(path, given, stated, **_):
        logs.extend([path, *given, *stated.given])
        raise Seen("seen")

    monkeypatch.setattr(COMMANDS[command], seen)
    words = ["robot.urdf", "a.csv", "b.csv", *MORE.get(command, [])]
    assert main([command, *words, "--validate", "c.csv"]) == 2
    assert logs == [Path("robot.urdf"), Path("a.csv"), Path("b.csv"), "validation"]
    capsys.readouterr()


def options_of(command):
    (commands,) = tool_parser()._subparsers._group_actions
    return {
        o
        for action in commands.choices[command]._actions
        for o in action.option_strings
    }


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_has_every_option_that_is_declared(command):
    declared = {each.option for each in declarations().values()}
    assert declared <= options_of(command)


@pytest.mark.slow
def test_the_walk_knows_every_command_that_reads_a_problem():
    (commands,) = tool_parser()._subparsers._group_actions
    others = {"lint", "repair", "reproduce", "compress", "fleet", "completion", "demo"}
    others |= {"servo", "help"}
    assert set(commands.choices) == {*COMMANDS, *ROBOT, *others}
    for command in others - {"completion"}:  # none of what is stated is theirs
        declared = {each.option for each in declarations().values()}
        same = {"--validate"} if command == "servo" else set()  # logs, to judge by
        assert declared & options_of(command) == same


def test_refusals_beside_a_problem_file_end_with_a_command(capsys):
    assert main(["identify", "problems/kuka_kr300", "--keep", "coupling"]) == 2
    error = capsys.readouterr().err
    again = r"To select again: consistent-id select \S+problem.toml --keep coupling$"
    assert re.search(again, error.strip())
    assert main(["check", "problems/kuka_kr300", "--torque-gain", "x"]) == 2
    assert "--torque-gain x: expected numbers" in capsys.readouterr().err


@pytest.mark.parametrize("select", [True, False])
def test_the_command_in_a_report_states_what_was_stated(select):
    source = ["a robot.urdf", "log.csv"]
    names, words = stated({d.part for d in declarations().values()})
    if select:
        words.remove("--no-select")
        names = tuple(n for n in names if n != "select")
    options = tool_parser().parse_args(["report", *source, "--seed", "3", *words])
    line = shlex.split(command_of(options))
    again = tool_parser().parse_args(line[1:])
    assert line[0] == "consistent-id" and all(getattr(again, n) for n in names)
    assert vars(again) == vars(options)
