"""Tab completion, asked of the shells themselves."""

import shutil
import subprocess

import pytest

from consistent_id.cli import main
from consistent_id.cli.tool import tool_parser


@pytest.fixture
def script(tmp_path, capsys):
    def written(shell):
        assert main(["completion", shell]) == 0
        file = tmp_path / f"completion.{shell}"
        file.write_text(capsys.readouterr().out)
        return file

    return written


def asked(shell, code):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    done = subprocess.run(
        [shell, "-c", code], check=True, capture_output=True, text=True
    )
    assert done.stderr == ""
    return done.stdout.split("==\n")


CASES = {
    "e": {"excite", "export"},
    "export --format ": {"urdf", "mjcf", "json", "pin", "numpy", "casadi", "c"},
    "identify --unc": {"--uncertainty"},
    "completion ": {"bash", "zsh", "fish"},
}


@pytest.mark.slow
def test_bash_completes_commands_options_and_choices(script):
    words = "\n".join(
        f'ask {" ".join(words.split(" ")[:-1])} "{words.split(" ")[-1]}"; echo =='
        for words in CASES
    )
    answers = asked(
        "bash",
        f"source {script('bash')}\n"
        'ask() { COMP_WORDS=(consistent-id "$@"); COMP_CWORD=$#; _shtab_consistent_id; '
        'echo "${COMPREPLY[@]}"; }\n' + words,
    )
    for expected, answer in zip(CASES.values(), answers[:-1], strict=True):
        assert expected <= set(answer.split())


def test_bash_completes_files_where_nothing_else_is_expected(script, tmp_path):
    (tmp_path / "recording.csv").touch()
    source = f"cd {tmp_path}; source {script('bash')}"
    for words in ("check", "identify robot.urdf", "excite problem --output"):
        count = len(words.split())
        code = (
            f"{source}; COMP_WORDS=(consistent-id {words} rec); COMP_CWORD={count + 1};"
            ' _shtab_consistent_id; echo "${COMPREPLY[@]}"'
        )
        assert asked("bash", code) == ["recording.csv\n"]


def test_fish_completes_commands_options_and_choices(script):
    file = script("fish")
    questions = [f"complete -C 'consistent-id {w}'; echo ==" for w in CASES]
    answers = asked("fish", f"source {file}; " + "; ".join(questions))
    for expected, answer in zip(CASES.values(), answers[:-1], strict=True):
        assert expected == {line.split("\t")[0] for line in answer.splitlines()}


def test_zsh_registers_the_script_as_the_pages_say(script):
    setup = f'autoload -Uz compinit; compinit -D; eval "$(cat {script("zsh")})"'
    registered = asked("zsh", f"{setup}; echo $_comps[consistent-id]")
    assert registered == ["_shtab_consistent_id\n"]


def test_every_command_and_option_is_completed(script):
    text = script("zsh").read_text()
    (commands,) = tool_parser()._subparsers._group_actions
    for name, command in commands.choices.items():
        options = text.split(f"_shtab_consistent_id_{name}_options=(")[1]
        options = options.split("\n)")[0]
        for action in command._actions:
            assert all(flag in options for flag in action.option_strings)
