"""``consistent-id completion SHELL``: a script for the shell, written by shtab.

The script contains all names, so completion does not start Python.
"""

import argparse
from typing import Any

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.options import Option, add_command

_MORE = """Print a script that completes commands, options, choices and files:

  bash   eval "$(consistent-id completion bash)"     in ~/.bashrc
  zsh    eval "$(consistent-id completion zsh)"      in ~/.zshrc, after compinit
  fish   consistent-id completion fish | source      in ~/.config/fish/config.fish"""
_EXAMPLES = """
consistent-id completion bash > ~/.local/share/bash-completion/completions/consistent-id
"""


def add_completion(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_completion,
        Option(
            "shell",
            "shell for which the script is printed",
            choices=("bash", "zsh", "fish"),
        ),
        more=_MORE,
        examples=_EXAMPLES,
        reads=False,
    )


def run_completion(options: argparse.Namespace) -> int:
    """Print a shell's script; return the exit code."""
    import shtab

    parser: Any = options.tool_parser()
    (commands,) = parser._subparsers._group_actions
    for command in commands.choices.values():
        for action in command._actions:
            if action.nargs != 0 and not action.choices:
                action.complete = shtab.FILE
    script = shtab.complete(parser, options.shell).rstrip()
    name = "consistent_id completion 1"
    record = {"format": name, "shell": options.shell, "script": script}
    return show(options, Answer(0, script, record, whole=True))
