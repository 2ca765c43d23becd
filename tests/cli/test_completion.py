"""Tab completion, asked of the shells themselves."""

import shutil
import subprocess

import pytest

from consistent_id.cli import main


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


def test_bash_completes_commands_options_and_choices(script):
    words = "\n".join(
        f'ask {" ".join(words.split(" ")[:-1])} "{words.split(" ")[-1]}"; echo =='
        for words in CASES
    )
    answers = asked(
        "bash",
        f"source {script('bash')}\n"
        'ask() { COMP_WORDS=(consistent-id "$@"); COMP_CWORD=$#; _consistent_id; '
        'echo "${COMPREPLY[@]}"; }\n' + words,
    )
    for expected, answer in zip(CASES.values(), answers[:-1], strict=True):
        assert expected <= set(answer.split())
    # Where nothing is offered, bash completes files.
    assert asked("bash", f"source {script('bash')}; complete -p consistent-id") == [
        "complete -o bashdefault -o default -F _consistent_id consistent-id\n"
    ]


def test_fish_completes_commands_options_and_choices(script):
    file = script("fish")
    questions = [f"complete -C 'consistent-id {w}'; echo ==" for w in CASES]
    answers = asked("fish", f"source {file}; " + "; ".join(questions))
    for expected, answer in zip(CASES.values(), answers[:-1], strict=True):
        assert expected == {line.split("\t")[0] for line in answer.splitlines()}


def test_zsh_understands_its_script(script):
    asked("zsh", f"autoload -Uz compinit; compinit -D; source {script('zsh')}")


def test_every_command_is_completed(script):
    text = script("zsh").read_text()
    for command in ("init", "check", "repair"):
        assert f"        {command}) _arguments" in text
